"""Scans as HeLiPR has them: records of four sensors without a header.

Like KITTI's they have no magic, so none is ever guessed: the Content-Type decides.
"""

from typing import ClassVar

import numpy as np

from core.arrays import Float32Array
from storage.formats.scans.coordinates import require_records
from storage.formats.scans.kitti import require_plausible
from storage.formats.scans.scan_format import ScanFormat


class HeliprFormat(ScanFormat):
    """Records of float32 x y z and what one sensor measures besides.

    Attributes:
        besides: The other fields, in the order of the file.
    """

    besides: ClassVar[tuple[tuple[str, str], ...]]

    def read(self, body: bytes) -> Float32Array:
        """Return `(n, 3)` metres.

        Raises:
            TruncatedScan: If the length is not a whole number of records.
            WrongDtype: If the values cannot be metres.

        Examples:
            >>> body = np.array([10, 0, -1], "<f4").tobytes() + bytes(7)
            >>> AviaFormat().read(body)
            array([[10.,  0., -1.]], dtype=float32)
        """
        record = np.dtype([("xyz", "<f4", 3), *self.besides])
        fields = " ".join(f"{name}:{kind[1:]}" for name, kind in self.besides)
        layout = f"float32 x y z {fields}, {record.itemsize} bytes a return, in metres"
        require_records(body, record.itemsize, layout)
        returns_m = np.frombuffer(body, dtype=record)["xyz"].astype(np.float32)
        require_plausible(returns_m, layout)
        return returns_m


class HeliprOusterFormat(HeliprFormat):
    """Scans of the OS2-128."""

    name = "HeLiPR Ouster"
    media_type = "application/vnd.tensormap.helipr-ouster"
    besides = (
        ("intensity", "<f4"), ("t", "<u4"), ("reflectivity", "<u2"), ("ring", "<u2"),
        ("ambient", "<u2"),
    )  # fmt: skip


class HeliprVelodyneFormat(HeliprFormat):
    """Scans of the VLP-16."""

    name = "HeLiPR Velodyne"
    media_type = "application/vnd.tensormap.helipr-velodyne"
    besides = (("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4"))


class AviaFormat(HeliprFormat):
    """Scans of the Livox Avia."""

    name = "HeLiPR Avia"
    media_type = "application/vnd.tensormap.helipr-avia"
    besides = (("reflectivity", "|u1"), ("tag", "|u1"), ("line", "|u1"), ("offset_time", "<u4"))


class AevaEarlyFormat(HeliprFormat):
    """Scans of the Aeva Aeries II, in the sequences up to 13 August 2023."""

    name = "HeLiPR Aeva, early"
    media_type = "application/vnd.tensormap.helipr-aeva-early"
    besides = (
        ("reflectivity", "<f4"), ("velocity", "<f4"), ("time_offset_ns", "<i4"),
        ("line_index", "|u1"),
    )  # fmt: skip


class AevaFormat(HeliprFormat):
    """Scans of the Aeva Aeries II in later sequences."""

    name = "HeLiPR Aeva"
    media_type = "application/vnd.tensormap.helipr-aeva"
    besides = (*AevaEarlyFormat.besides, ("intensity", "<f4"))


HELIPR_FORMATS: dict[str, type[HeliprFormat]] = {
    "Avia": AviaFormat,
    "Aeva": AevaFormat,
    "Ouster": HeliprOusterFormat,
    "Velodyne": HeliprVelodyneFormat,
}
"""The formats by the name of the sensor's folder."""
