"""Which kind of file a body is, by how it begins."""

_KINDS = {
    b"PK\x03\x04": "zip",
    b"\x28\xb5\x2f\xfd": "zstd",
    b"\xfd7zXZ\0": "xz",
    b"BZh91AY&SY": "bzip2",
    b"\x89HDF\r\n\x1a\n": "HDF5",
    b"\x93NUMPY": "NumPy",
    b"# .PCD": "PCD",
    b"VERSION ": "PCD",
    b"FIELDS ": "PCD",
    b"ply\n": "PLY",
    b"ply\r\n": "PLY",
    b"x,y,z": "CSV",
    b"X,Y,Z": "CSV",
    b"LASF": "LAS",
    b"MATLAB 5.0 MAT-file": "MATLAB",
    b"\xd4\xc3\xb2\xa1": "pcap",
    b"\xa1\xb2\xc3\xd4": "pcap",
    b"\x4d\x3c\xb2\xa1": "pcap",
    b"\xa1\xb2\x3c\x4d": "pcap",
    b"#ROSBAG": "ROS bag",
    b"\x89MCAP0\r\n": "MCAP",
    b"SQLite format 3\0": "SQLite",
}
_TAR, _TAR_AT = b"ustar", 257
_GZIP, _GZIP_FLAGS = b"\x1f\x8b\x08", 0x1F
FORM = "multipart form"
_FORM, _FORM_HEAD_BYTES = b"content-disposition:", 1024  # behind its boundary, of 72 bytes at most


def kind_of(body: bytes) -> str | None:
    r"""Return which kind of file the body is by how it begins, `None` if it may be records.

    As float32 none of these beginnings are coordinates that a lidar measures.

    Examples:
        >>> kind_of(b"PK\x03\x04" + bytes(28)), kind_of(bytes(32))
        ('zip', None)
    """
    if body[_TAR_AT : _TAR_AT + len(_TAR)] == _TAR:
        return "tar"
    if body.startswith(_GZIP) and len(body) > len(_GZIP) and body[len(_GZIP)] <= _GZIP_FLAGS:
        return "gzip"
    if body.startswith(b"--") and _FORM in body[:_FORM_HEAD_BYTES].lower():
        return FORM
    return next((kind for begin, kind in _KINDS.items() if body.startswith(begin)), None)
