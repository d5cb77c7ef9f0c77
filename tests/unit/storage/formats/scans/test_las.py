"""LAS and LAZ: scale, offset, and headers that lie."""

import struct
import subprocess
from io import BytesIO
from typing import Any

import laspy
import numpy as np
import pytest

from core.errors import InvalidScan
from storage.formats.errors import MalformedScan, ScanTooLarge, TruncatedScan
from storage.formats.scans.las import LasFormat

POINTS = np.random.default_rng(0).normal(scale=20.0, size=(300, 3)).astype(np.float32)


def las(*, compress: bool, version: str = "1.2", point_format: int = 0) -> bytes:
    header = laspy.LasHeader(point_format=point_format, version=version)
    header.scales, header.offsets = np.full(3, 1e-3), np.array([100.0, -100.0, 5.0])
    data = laspy.LasData(header)
    data.x, data.y, data.z = POINTS.T.astype(np.float64)
    file = BytesIO()
    data.write(file, do_compress=compress)
    return file.getvalue()


def patched(body: bytes, at: int, layout: str, value: int) -> bytes:
    changed = bytearray(body)
    struct.pack_into(layout, changed, at, value)
    return bytes(changed)


class TestLas:
    @pytest.mark.parametrize("compress", [False, True], ids=["las", "laz"])
    @pytest.mark.parametrize(("version", "point_format"), [("1.2", 3), ("1.4", 6)])
    def test_scale_and_offset_are_applied(
        self, compress: bool, version: str, point_format: int
    ) -> None:
        body = las(compress=compress, version=version, point_format=point_format)
        np.testing.assert_allclose(LasFormat().read(body), POINTS, rtol=0, atol=6e-4)

    def test_the_process_that_unpacks_has_no_keys_of_the_service(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        popen, given = subprocess.Popen, {}

        def noted(command: list[str], **options: Any) -> Any:
            given.update(options["env"])
            return popen(command, **options)

        monkeypatch.setattr(subprocess, "Popen", noted)
        monkeypatch.setenv("TENSORMAP_ADMIN_KEY", "correct horse battery staple")
        monkeypatch.setenv("PGPASSWORD", "secret")
        assert len(LasFormat().read(las(compress=True))) == len(POINTS)
        assert not {"TENSORMAP_ADMIN_KEY", "PGPASSWORD"} & given.keys()
        assert given["OPENBLAS_NUM_THREADS"] == "1"  # of 24 threads it could not import NumPy

    @pytest.mark.parametrize("stop", ["INT", "TERM"])
    def test_a_signal_that_stops_the_service_damages_no_scan(
        self, stop: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        popen = subprocess.Popen

        def stopped(command: list[str], **options: Any) -> Any:
            """Start a process that gets the signal at once, as all of a terminal do."""
            return popen(["sh", "-c", f'kill -{stop} $$; exec "$@"', "sh", *command], **options)

        monkeypatch.setattr(subprocess, "Popen", stopped)
        assert len(LasFormat().read(las(compress=True))) == len(POINTS)

    @pytest.mark.parametrize(
        ("body", "error"),
        [
            (las(compress=False)[:-1], TruncatedScan),
            (las(compress=False)[:100], TruncatedScan),
            (patched(las(compress=False), 107, "<I", 301), TruncatedScan),
            (patched(las(compress=False), 107, "<I", 2**32 - 1), ScanTooLarge),
            (patched(las(compress=True), 107, "<I", 2**32 - 1), ScanTooLarge),
            (patched(las(compress=False), 105, "<H", 0), MalformedScan),
            (patched(las(compress=False), 100, "<I", 2**32 - 1), MalformedScan),
            (patched(las(compress=False), 96, "<I", 2**32 - 1), TruncatedScan),
            (patched(las(compress=False), 94, "<H", 0), MalformedScan),
            (patched(las(compress=False), 25, "<B", 9), MalformedScan),
            (patched(las(compress=False), 104, "<B", 60), MalformedScan),
            (patched(las(compress=False), 131, "<Q", 0x7FF8 << 48), MalformedScan),
            (b"LASX" + las(compress=False)[4:], MalformedScan),
        ],
    )
    def test_a_wrong_header_is_rejected(self, body: bytes, error: type[InvalidScan]) -> None:
        with pytest.raises(error):
            LasFormat().read(body)

    def test_compressed_points_that_claim_gigabytes_end_only_the_process_that_reads_them(
        self,
    ) -> None:
        whole = las(compress=True, version="1.4", point_format=6)
        points_at = struct.unpack_from("<I", whole, 96)[0]
        # The sizes of the layers follow the first point.
        sizes_at = points_at + 8 + 30 + 4
        lying = whole[:sizes_at] + b"\xff" * 36 + whole[sizes_at + 36 :]
        for body in (lying, whole[: points_at + 20]):
            with pytest.raises(MalformedScan, match="cannot be unpacked"):
                LasFormat().read(body)
