"""Records without a header: those of NCLT and nuScenes, and what is none."""

import gzip
import io
import tarfile
import zipfile

import numpy as np
import pytest

from storage.formats.errors import MalformedScan, TruncatedScan, WrongDtype
from storage.formats.scans.records import NcltFormat, NuscenesFormat
from storage.formats.scans.registry import SCAN_FORMATS, read_scan

POINTS = np.random.default_rng(0).normal(scale=20.0, size=(300, 3)).astype(np.float32)


class TestRecords:
    def test_nclt_points_are_rotated_to_z_up_and_moved_to_the_lidar(self) -> None:
        # The vehicle's origin, and a point 1 m ahead of it, to its right and below it.
        raw = np.array([[20000, 20000, 20000], [20200, 20200, 20200]], "<u2")
        body = b"".join(row.tobytes() + b"\x07\x05" for row in raw)
        np.testing.assert_allclose(
            NcltFormat().read(body), [[-0.002, -0.004, -0.957], [0.998, -1.004, -1.957]], atol=1e-6
        )

    @pytest.mark.parametrize("dtype", ["<f4", "<f8"])
    def test_floats_are_not_taken_for_nclt(self, dtype: str) -> None:
        body = np.pad(POINTS, ((0, 0), (0, 1))).astype(dtype).tobytes()
        with pytest.raises(WrongDtype, match="laser"):
            NcltFormat().read(body)

    def test_kitti_is_not_taken_for_nuscenes(self) -> None:
        body = np.pad(POINTS, ((0, 0), (0, 1)), constant_values=0.3).astype("<f4").tobytes()
        assert len(body) % 20 == 0
        with pytest.raises(WrongDtype, match="ring"):
            NuscenesFormat().read(body)

    @pytest.mark.parametrize("known", [NuscenesFormat(), NcltFormat()])
    def test_a_part_of_a_record_is_rejected(self, known: NuscenesFormat | NcltFormat) -> None:
        with pytest.raises(TruncatedScan):
            known.read(bytes(39))


_PLAIN = [
    *["kitti", "nuscenes", "nclt"],
    *["helipr-ouster", "helipr-velodyne", "helipr-avia", "helipr-aeva"],
]
_MAGICS = [magic for known in SCAN_FORMATS for magic in known.magics]
_BAGS = [b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"SQLite format 3\0"]


@pytest.mark.parametrize("media_type", _PLAIN)
@pytest.mark.parametrize("kind", ["tar", "zip", "gzip"])
def test_an_archive_of_scans_is_no_scan_of_records(media_type, kind):
    # Stored without compression, its numbers are those of the scan.
    records = np.tile(np.array([9.0, 5.0, -1.0, 0.5], "<f4"), 8000).tobytes()
    packed = io.BytesIO()
    if kind == "tar":
        with tarfile.open(fileobj=packed, mode="w") as archive:
            member = tarfile.TarInfo("000000.bin")
            member.size = len(records)
            archive.addfile(member, io.BytesIO(records))
    elif kind == "zip":
        with zipfile.ZipFile(packed, "w") as stored:
            stored.writestr("000000.bin", records)
    else:
        packed.write(gzip.compress(records, 0))
    body = packed.getvalue() + bytes(-len(packed.getvalue()) % 9360)  # whole records of all kinds
    with pytest.raises(
        MalformedScan, match=f"the body is a file of kind {kind}, wanted"
    ) as refused:
        read_scan(body, media_type=f"application/vnd.tensormap.{media_type}", min_returns=1)
    for mend in ("decompress it first", "Content-Encoding: gzip"):  # of a file, and of a body
        assert (mend in str(refused.value)) is (kind == "gzip")


@pytest.mark.parametrize("media_type", _PLAIN)
@pytest.mark.parametrize("magic", [*_MAGICS, *_BAGS])
def test_a_file_that_says_its_format_is_no_scan_of_records(media_type, magic):
    body = magic + bytes(9360 - len(magic))  # whole records of all kinds, most of them no-returns
    with pytest.raises(MalformedScan, match="the body is a file of kind "):
        read_scan(body, media_type=f"application/vnd.tensormap.{media_type}", min_returns=1)


@pytest.mark.parametrize("media_type", _PLAIN)
@pytest.mark.parametrize(
    "boundary", ["-" * 24 + "8fbdf0a1c3e6ab19", "-" * 4 + "WebKitFormBoundary9", "3a"]
)
@pytest.mark.parametrize(
    "header",
    [
        "Content-Disposition: form-data",
        "Content-Disposition: attachment",  # curl's with a Content-Type given
        "content-disposition: form-data",  # Dart's
    ],
)
def test_a_form_with_a_file_in_it_is_no_scan_of_records(media_type, boundary, header):
    """What `curl -F`, a browser's form or `requests.post(files=...)` send has the scan in it."""
    head = f'--{boundary}\r\n{header}; name="file"; filename="7.bin"\r\n\r\n'
    records = np.tile(np.array([9.0, 5.0, -1.0, 0.5], "<f4"), 8000).tobytes()
    body = head.encode() + records + f"\r\n--{boundary}--\r\n".encode()
    body += bytes(-len(body) % 9360)  # whole records of all kinds
    with pytest.raises(MalformedScan, match="the body is a file of kind multipart form") as refused:
        read_scan(body, media_type=f"application/vnd.tensormap.{media_type}", min_returns=1)
    assert "curl --data-binary or -T" in str(refused.value)


def test_a_return_that_begins_as_gzip_does_is_one():
    """The fourth byte of a float is its exponent, of gzip its flags."""
    body = b"\x1f\x8b\x08\x41" + np.ones(15, "<f4").tobytes()
    assert len(read_scan(body, media_type="application/vnd.tensormap.kitti", min_returns=1)) == 4
