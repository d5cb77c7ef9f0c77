"""Recorded drives to upload."""

from tensormap_client import FolderSource


def test_files_have_the_format_that_is_named_or_that_of_their_suffix(tmp_path):
    (tmp_path / "0.bin").write_bytes(b"")
    assert FolderSource(tmp_path).scan_body(0).media_type == "application/vnd.tensormap.kitti"
    named = FolderSource(tmp_path, "helipr")
    assert named.scan_body(0).media_type == "application/vnd.tensormap.helipr"
