"""Files of a capture are one sequence of bytes, of which any part can be read."""

import pytest
from tensormap_client import CaptureFiles, InvalidArgument


def test_parts_go_over_the_ends_of_files(tmp_path):
    contents = {"b_0.db3": b"abcdefg", "b_1.db3": b"hi", "metadata.yaml": b"0123"}
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)
    capture = CaptureFiles.of(tmp_path)
    assert capture is not None
    assert [file.name for file in capture.files] == ["metadata.yaml", "b_0.db3", "b_1.db3"]
    whole = b"0123abcdefghi"
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
    assert CaptureFiles.of(tmp_path) is None
    assert CaptureFiles.of(tmp_path / "absent.bag") is None
    (tmp_path / "metadata.yaml").touch()
    with pytest.raises(InvalidArgument, match=r"no \.db3 or \.mcap$"):
        CaptureFiles.of(tmp_path)
    (tmp_path / "bag_0.db3.zstd").touch()
    with pytest.raises(InvalidArgument, match=r"decompress bag_0\.db3\.zstd first \(zstd -d\)"):
        CaptureFiles.of(tmp_path)
