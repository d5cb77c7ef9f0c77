"""Ouster's sensors: a capture of their packets, `.pcap`, and the metadata of the sensor.

Both are in one body: the metadata, a JSON object, directly followed by the capture. On disk they
are two files, `NAME.json` beside `NAME.pcap`. Packets and the conversion of ranges to points follow
the sensor's software manual, firmware 2.x and 3.x, and 1.x for the profile LEGACY.
"""

import itertools
import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray, frozen
from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan, TruncatedScan
from storage.formats.scans.coordinates import record_of
from storage.formats.scans.pcap import (
    PCAPNG_MAGIC,
    Datagram,
    datagrams_before_cut,
    require_one_sensor,
)
from storage.formats.scans.scan_format import ScanFormat

_MAX_METADATA_BYTES = 2**20
_BLANKS = frozenset(" \r\n\t")
_BATCH_PACKETS = 256
_ROWS, _COLUMNS, _PER_PACKET = {16, 32, 64, 128}, {512, 1024, 2048, 4096}, {8, 16}


@dataclass(frozen=True)
class _Profile:
    """Layout of a packet, in bytes, and the bits of a pixel's first range."""

    head: int
    column_head: int
    pixel: int
    column_foot: int
    foot: int
    range_type: str
    range_mask: int
    step_mm: int


_PROFILES = {
    "LEGACY": _Profile(0, 16, 12, 4, 0, "<u4", 0xFFFFF, 1),
    "RNG19_RFL8_SIG16_NIR16": _Profile(32, 12, 12, 0, 32, "<u4", 0x7FFFF, 1),
    "RNG19_RFL8_SIG16_NIR16_DUAL": _Profile(32, 12, 16, 0, 32, "<u4", 0x7FFFF, 1),
    "RNG15_RFL8_NIR8": _Profile(32, 12, 4, 0, 32, "<u2", 0x7FFF, 8),
}


class OusterFormat(ScanFormat):
    """Metadata and capture in one body; the first whole frame is the scan, its first returns.

    The points are rotated into the sensor's frame, x forward, but keep the lidar's own origin,
    where the beams intersect, up to 80 mm above the sensor's. A packet that the network delivers
    late, after the first ones of the next frame, belongs to its own frame.
    """

    name = "Ouster capture"
    media_type = "application/vnd.tensormap.ouster"

    def read(self, body: bytes) -> Float32Array:
        """Return `(n, 3)` metres, zero for no-returns.

        Raises:
            MalformedScan: If metadata or capture cannot be parsed, or do not belong together.
            TruncatedScan: If the capture holds no whole frame among the first packets; it may end
                within one.
        """
        sensor, start = _read_sensor(body)
        current, before = _Frame(sensor), _Frame(sensor)
        most = 0
        needed = int(np.count_nonzero(sensor.window))
        for number, columns, range_m in _runs(sensor, body, start):
            if number == before.number:
                frame = before
            else:
                if number != current.number:
                    current, before = before, current
                    current.begin(number)
                frame = current
            frame.ranges_m[columns] = range_m
            frame.seen[columns] = True
            count = int(np.count_nonzero(frame.seen))
            most = max(most, count)
            if count >= needed and frame.seen[sensor.window].all():
                frame.ranges_m[~frame.seen] = 0.0  # of an earlier frame
                return sensor.points_m(frame.ranges_m)
        raise TruncatedScan(f"no frame is whole: the fullest has {most} of {needed} columns")


@dataclass(frozen=True, eq=False)
class _Sensor:
    """The metadata.

    Attributes:
        rows: Number of beams.
        columns: Number of directions in a revolution.
        per_packet: Number of columns in a packet.
        window: `(columns,)`, which of them the sensor sends.
        profile: Layout of the packets.
        elevation: `(rows,)` radians.
        azimuth: `(rows,)` radians, each beam's own, clockwise.
        origin_m: Distance from the lidar's origin to where a beam begins.
        rotation: `(3, 3)`, lidar to sensor.
    """

    rows: int
    columns: int
    per_packet: int
    window: np.ndarray
    profile: _Profile
    elevation: FloatArray
    azimuth: FloatArray
    origin_m: float
    rotation: FloatArray

    @property
    def column_bytes(self) -> int:
        profile = self.profile
        return profile.column_head + self.rows * profile.pixel + profile.column_foot

    @property
    def packet_bytes(self) -> int:
        return self.profile.head + self.per_packet * self.column_bytes + self.profile.foot

    @property
    def packet_layout(self) -> np.dtype[np.void]:
        """Where numbers, states and ranges of columns are in a packet."""
        profile = self.profile
        pixel = np.dtype(
            {"names": ["range"], "formats": [profile.range_type], "itemsize": profile.pixel}
        )
        fields: dict[str, tuple[Any, int]] = {
            "number": ("<u2", 8),
            "pixels": ((pixel, self.rows), profile.column_head),
        }
        if profile.head:
            fields["status"] = ("<u2", 10)
        else:
            fields |= {"frame": ("<u2", 10), "status": ("<u4", self.column_bytes - 4)}
        columns = ((record_of(fields, self.column_bytes), self.per_packet), profile.head)
        frame = {"frame": ("<u2", 2)} if profile.head else {}
        return record_of({"columns": columns, **frame}, self.packet_bytes)

    def points_m(self, ranges_m: FloatArray) -> Float32Array:
        """Convert `(columns, rows)` ranges to `(n, 3)` points."""
        encoder = 2.0 * np.pi * (1.0 - np.arange(self.columns) / self.columns)[:, None]
        beam_m = ranges_m - self.origin_m
        level_m = beam_m * np.cos(self.elevation)
        points_m = np.stack(
            [
                level_m * np.cos(encoder - self.azimuth) + self.origin_m * np.cos(encoder),
                level_m * np.sin(encoder - self.azimuth) + self.origin_m * np.sin(encoder),
                beam_m * np.sin(self.elevation),
            ],
            axis=-1,
        )
        points_m[ranges_m <= 0] = 0.0
        return (points_m.reshape(-1, 3) @ self.rotation.T).astype(np.float32)


class _Frame:
    """The columns of a frame that have arrived; used again for a later frame.

    Attributes:
        number: The frame's, `None` before the first one.
        ranges_m: `(columns, rows)`; those that have not arrived are of an earlier frame.
        seen: `(columns,)` which have arrived.
    """

    def __init__(self, sensor: _Sensor) -> None:
        self.number: int | None = None
        self.ranges_m = np.zeros((sensor.columns, sensor.rows))
        self.seen = np.zeros(sensor.columns, dtype=bool)

    def begin(self, number: int) -> None:
        """Take up a frame of which nothing has arrived."""
        self.number = number
        self.seen[:] = False


def _runs(sensor: _Sensor, body: bytes, start: int) -> Iterator[tuple[int, IntArray, FloatArray]]:
    """Yield runs of ascending columns of one frame: its number, their numbers, ranges in metres."""
    packets = _packets(body, start, sensor.packet_bytes)
    layout, profile = sensor.packet_layout, sensor.profile
    batch = b""
    for batch in _batches(itertools.islice(packets, BUDGET.frame_packets)):
        records = np.frombuffer(batch, layout)
        columns = records["columns"].reshape(-1)
        if profile.head:
            frame = np.repeat(records["frame"], sensor.per_packet)
            valid = columns["status"] & 1 == 1
        else:
            frame, valid = columns["frame"], columns["status"] == 0xFFFFFFFF
        valid = valid & (columns["number"] < sensor.columns)
        frame, number = frame[valid], columns["number"][valid].astype(np.int64)
        steps = columns["pixels"]["range"][valid] & profile.range_mask
        range_m = steps.astype(np.float64) * (profile.step_mm / 1000.0)
        breaks = np.flatnonzero((np.diff(frame) != 0) | (np.diff(number) < 0)) + 1
        ends = [0, *breaks.tolist(), len(number)]
        for first, end in itertools.pairwise(ends if len(number) else []):
            yield int(frame[first]), number[first:end], range_m[first:end]
    if not batch:
        raise MalformedScan(
            f"the capture has no UDP packets of {sensor.packet_bytes} bytes, as in the metadata"
        )


def _packets(body: bytes, start: int, size_bytes: int) -> Iterator[bytes]:
    """Yield the sensor's packets."""
    first: Datagram | None = None
    for datagram in datagrams_before_cut(body, start):
        if len(datagram.payload) == size_bytes:
            first = first or datagram
            require_one_sensor(first, datagram)
            yield datagram.payload


def _batches(payloads: Iterator[bytes]) -> Iterator[bytes]:
    """Join payloads in batches."""
    while batch := b"".join(itertools.islice(payloads, _BATCH_PACKETS)):
        yield batch


def _read_sensor(body: bytes) -> tuple[_Sensor, int]:
    """Return the sensor, and where the capture begins."""
    text = body[:_MAX_METADATA_BYTES].decode("latin-1")
    blank = len(text) - len(text.lstrip())
    try:
        metadata, end = json.JSONDecoder().raw_decode(text[blank:])
    except (ValueError, RecursionError) as error:
        raise MalformedScan(
            f"the body does not begin with the sensor's metadata, a JSON object: {str(error)[:80]}"
        ) from error
    start = blank + end
    # A pcapng begins with line ends: kept, it is named as what it is.
    while text[start : start + 1] in _BLANKS and body[start : start + 4] != PCAPNG_MAGIC:
        start += 1
    try:
        return _sensor(_flat(metadata)), start
    except KeyError as error:
        raise MalformedScan(f"the metadata has no field {error}") from error
    except (AttributeError, OverflowError, TypeError, ValueError) as error:
        raise MalformedScan(f"the metadata cannot be used: {str(error)[:120]}") from error


def _flat(metadata: dict[str, Any]) -> dict[str, Any]:
    """Return newer metadata without its sections, as older metadata is."""
    flat = dict(metadata)
    for section in ("beam_intrinsics", "lidar_intrinsics", "lidar_data_format"):
        flat.update(metadata.get(section, {}))
    flat["data_format"] = metadata.get("lidar_data_format") or metadata["data_format"]
    return flat


def _sensor(metadata: dict[str, Any]) -> _Sensor:
    layout = metadata["data_format"]
    rows, columns = layout["pixels_per_column"], layout["columns_per_frame"]
    per_packet = layout["columns_per_packet"]
    if rows not in _ROWS or columns not in _COLUMNS or per_packet not in _PER_PACKET:
        raise ValueError(f"{rows} rows, {columns} columns, {per_packet} columns a packet")
    # JSON does not tell 16 from 16.0.
    rows, columns, per_packet = int(rows), int(columns), int(per_packet)
    name = layout.get("udp_profile_lidar", "LEGACY")
    if name not in _PROFILES:
        raise ValueError(f"packets are {str(name)[:60]!r}, wanted {', '.join(_PROFILES)}")
    first, last = (int(side) for side in layout.get("column_window", [0, columns - 1]))
    if not (0 <= first < columns and 0 <= last < columns):
        raise ValueError(f"the column window is {first}..{last}")
    order = np.arange(columns)
    inside = (order >= first) & (order <= last)
    window = inside if first <= last else (order >= first) | (order <= last)
    transform = np.array(metadata["lidar_to_sensor_transform"], dtype=np.float64).reshape(4, 4)
    sensor = _Sensor(
        rows,
        columns,
        per_packet,
        window,
        _PROFILES[name],
        frozen(np.radians(np.array(metadata["beam_altitude_angles"], np.float64)), np.float64),
        frozen(np.radians(np.array(metadata["beam_azimuth_angles"], np.float64)), np.float64),
        float(metadata["lidar_origin_to_beam_origin_mm"]) / 1000.0,
        frozen(transform[:3, :3], np.float64),
    )
    angles = np.concatenate(
        [sensor.elevation, sensor.azimuth, [sensor.origin_m], transform.ravel()]
    )
    if sensor.elevation.shape != (rows,) or sensor.azimuth.shape != (rows,):
        raise ValueError(f"wanted {rows} beam angles")
    if not np.isfinite(angles).all():
        raise ValueError("an angle is no number")
    return sensor
