"""Files of a capture are one sequence of bytes, of which any part can be read."""

import pytest
from tensormap_client import CaptureFiles, InvalidArgument

METADATA = b"rosbag2_bagfile_information: {}\n"


def test_parts_go_over_the_ends_of_files(tmp_path):
    contents = {"b_0.db3": b"abcdefg", "b_1.db3": b"hi", "metadata.yaml": METADATA}
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
    capture = CaptureFiles.of(tmp_path)
    assert capture is not None
    assert [file.name for file in capture.files] == ["metadata.yaml", "b_0.db3", "b_1.db3"]
    whole = METADATA + b"abcdefghi"
    for size in (1, 3, 5, 20):
        parts = [capture.part(at, size) for at in range(0, len(whole), size)]
        assert b"".join(parts) == whole
        assert {len(part) for part in parts[:-1]} <= {size}


def test_a_topic_follows_a_bag_and_other_paths_are_no_captures(tmp_path):
    bag = tmp_path / "monday.bag"
    bag.write_bytes(b"bag")
    named = CaptureFiles.of(tmp_path / "monday.bag#/points")
    assert named == CaptureFiles((bag,), (3,), "/points")
    assert CaptureFiles.of(f"{tmp_path}/monday.bag#/points") == named
    (tmp_path / "run#3").mkdir()
    in_run = bag.rename(tmp_path / "run#3" / bag.name)
    assert CaptureFiles.of(f"{in_run}#/points") == CaptureFiles((in_run,), (3,), "/points")
    assert CaptureFiles.of(in_run) == CaptureFiles((in_run,), (3,))
    assert CaptureFiles.of(tmp_path) is None
    assert CaptureFiles.of(tmp_path / "absent.bag") is None
    (tmp_path / "metadata.yaml").write_bytes(METADATA)
    with pytest.raises(InvalidArgument, match=r"no \.db3 or \.mcap$"):
        CaptureFiles.of(tmp_path)
    (tmp_path / "bag_0.db3.zstd").touch()
    with pytest.raises(InvalidArgument, match=r"decompress bag_0\.db3\.zstd first \(zstd -d\)"):
        CaptureFiles.of(tmp_path)


@pytest.mark.parametrize("content", [b"", b"sensor: HDL-64E\n", b"\xff\0"])
def test_a_folder_with_metadata_that_are_not_of_ros_is_no_capture(tmp_path, content):
    (tmp_path / "metadata.yaml").write_bytes(content)
    assert CaptureFiles.of(tmp_path) is None


def test_a_bag_whose_metadata_may_not_be_read_is_still_taken_for_one(tmp_path, monkeypatch):
    (tmp_path / "metadata.yaml").write_bytes(METADATA)
    (tmp_path / "b_0.db3").write_bytes(b"b")

    def denied(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr("pathlib.Path.open", denied)
    assert CaptureFiles.of(tmp_path) is not None  # who sends it says why not
