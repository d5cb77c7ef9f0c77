"""Velodyne's HDL-32E and VLP-16, as captured from the network: `.pcap`.

A packet of 1206 bytes holds 12 blocks of 100: two bytes of flag, the azimuth in hundredths of a
degree clockwise from the sensor's front, and 32 returns of a distance in steps of 2 mm and an
intensity. The azimuth is that of the block's first firing; later ones are interpolated by the time
at which they fire. (HDL-32E manual 63-9113, VLP-16 manual 63-9243: sections on data packets.)
"""

import itertools
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from core.arrays import Float32Array, FloatArray, IntArray, frozen
from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan, ScanTooLarge, TruncatedScan
from storage.formats.scans.pcap import (
    PCAP_MAGICS,
    Buffer,
    Datagram,
    datagrams,
    datagrams_before_cut,
    require_one_sensor,
)
from storage.formats.scans.scan_format import ScanFormat

_PAYLOAD_BYTES = 1206
_BLOCK = np.dtype(
    [("flag", "<u2"), ("azimuth", "<u2"), ("returns", [("range", "<u2"), ("i", "u1")], 32)]
)
_PACKET = np.dtype([("blocks", _BLOCK, 12), ("clock_us", "<u4"), ("factory", "V2")])
_CLOCK_US = 3_600_000_000  # the sensor's clock begins anew every hour
_FLAG = 0xEEFF
_RANGE_STEP_M = 0.002
_REVOLUTION = 36_000  # in hundredths of a degree, as azimuths are
_DUAL_RETURN = 0x39


@dataclass(frozen=True, eq=False)
class _Model:
    """Geometry and timing of one sensor model.

    Attributes:
        name: The model's common name.
        elevation_deg: `(32,)`, of each return of a block.
        height_m: `(32,)`, of each laser above the sensor's centre.
        firing: `(32,)`, time of each firing, as a share of the time between blocks.
    """

    name: str
    elevation_deg: FloatArray
    height_m: FloatArray
    firing: FloatArray


_HDL32_DEG = np.stack(
    [np.linspace(-92 / 3, -32 / 3, 16), np.linspace(-28 / 3, 32 / 3, 16)], axis=1
).ravel()
_VLP16_DEG = np.stack([np.arange(-15.0, 0.0, 2.0), np.arange(1.0, 16.0, 2.0)], axis=1).ravel()
# The VLP-16's lasers have different heights: manual, vertical correction.
_VLP16_MM = np.array(
    [11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1, 5.1, -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2]
)
_MODELS = {
    0x21: _Model(
        "HDL-32E",
        frozen(_HDL32_DEG, np.float64),
        frozen(np.zeros(32), np.float64),
        frozen(np.arange(32) * 1.152 / 46.08, np.float64),
    ),
    0x22: _Model(
        "VLP-16",
        frozen(np.tile(_VLP16_DEG, 2), np.float64),
        frozen(np.tile(_VLP16_MM / 1000.0, 2), np.float64),
        frozen(np.arange(32) % 16 * 2.304 / 110.592 + np.arange(32) // 16 / 2.0, np.float64),
    ),
}


class VelodyneFormat(ScanFormat):
    """A capture; its first full revolution is the scan. Of dual returns the last is used."""

    name = "Velodyne capture"
    media_type = "application/vnd.tensormap.velodyne"
    suffixes = (".pcap",)
    magics = PCAP_MAGICS

    def read(self, body: bytes) -> Float32Array:
        """Return `(n, 3)` metres, x forward, y left, z up.

        Raises:
            MalformedScan: If it is no capture, or holds no packets of an HDL-32E or VLP-16, or of
                two.
            TruncatedScan: If it ends before the first full revolution.
            ScanTooLarge: If it has more packets than a scan can need.
        """
        first = Turns(
            body,
            most_packets=BUDGET.scan_packets,
            kept_packets=BUDGET.frame_packets,
            may_be_cut=True,
        )
        return first.returns_m(0)


class Turns:
    """The full revolutions of a capture; an incomplete one at its end is left out.

    So is one in which packets of half a revolution or more are missing: its halves would be of
    two places. Of a sensor that is set to fire within half a revolution or less, each whole sweep
    of that is one.

    Args:
        body: The capture.
        most_packets: Maximum number of packets of the sensor.
        kept_packets: Number of first packets that are used, all by default.
        may_be_cut: Whether it may end within a packet, which is left out.

    Attributes:
        time_s: `(K,)` capture time of the first packet of each, seconds since 1970.

    Raises:
        MalformedScan: If it is no capture, or holds no packets of an HDL-32E or VLP-16, or of two.
        TruncatedScan: If it ends within a packet, or before the first full revolution.
        ScanTooLarge: If it has more packets than allowed.
    """

    def __init__(
        self,
        body: Buffer,
        *,
        most_packets: int | None = None,
        kept_packets: int | None = None,
        may_be_cut: bool = False,
    ) -> None:
        received = datagrams_before_cut(body) if may_be_cut else datagrams(body)
        packets = _packets(received, most_packets, kept_packets)
        self._model, times_s, clock_us, self._blocks = _blocks(*packets)
        self._azimuth_deg = self._blocks["azimuth"] / 100.0
        step = _steps(self._blocks["azimuth"])
        step_deg = step / 100.0
        usual_deg = float(np.median(step_deg))
        packet_deg = usual_deg * (len(self._blocks) // len(clock_us))
        passed_deg = _passed_deg(clock_us, packet_deg)
        sweeps = _sweeps(self._blocks["azimuth"], passed_deg, packet_deg)
        self._turns = _revolutions(step, passed_deg) if sweeps is None else sweeps
        # A lost packet leaves a gap: the firings of the block before it are not spread over it.
        spread_deg = np.where(np.abs(step_deg) > 2.0 * usual_deg, usual_deg, step_deg)
        self._spread_deg = np.append(spread_deg, usual_deg)
        self.time_s: FloatArray = frozen(times_s[self._turns[:, 0]], np.float64)

    def __len__(self) -> int:
        return len(self.time_s)

    def returns_m(self, turn: int) -> Float32Array:
        """Return the `(n, 3)` metres of a revolution, zero for no-returns.

        Raises:
            ScanTooLarge: If the sensor rotated so slowly that it has too many returns.
        """
        blocks = slice(*self._turns[turn].tolist())
        BUDGET.require_returns((blocks.stop - blocks.start) * len(self._model.firing))
        fired = self._spread_deg[blocks, None] * self._model.firing
        return _returns(
            self._model,
            self._azimuth_deg[blocks, None] + fired,
            self._blocks["returns"]["range"][blocks] * _RANGE_STEP_M,
        )


def _passed_deg(clock_us: IntArray, packet_deg: float) -> FloatArray:
    """Return by how much the sensor turned from each packet to the next, `(n - 1,)`.

    The sensor's own clock gives that, also where its azimuth does not show revolutions that were
    lost; that of a capture also advances where packets waited.

    Args:
        clock_us: `(n,)` of each packet.
        packet_deg: By how much the sensor usually turns from one to the next.
    """
    step_us = np.diff(clock_us)
    step_us = np.abs((step_us + _CLOCK_US // 2) % _CLOCK_US - _CLOCK_US // 2)
    if not step_us.any():
        return np.zeros(len(step_us))
    return np.asarray(step_us * packet_deg / np.median(step_us[step_us > 0]))


def _steps(azimuth: IntArray) -> IntArray:
    """Return the steps between blocks, `(m - 1,)`, -180 (included) to 180 degrees in hundredths."""
    step: IntArray = np.asarray(np.diff(azimuth.astype(np.int64)), np.int64)
    return (step + 18_000) % _REVOLUTION - 18_000


def _revolutions(step: IntArray, passed_deg: FloatArray) -> IntArray:
    """Return the first block and the end of each full revolution, `(k, 2)`.

    Runs between packets between which the sensor turned unseen by half a revolution or more are
    searched one by one.

    Args:
        step: `(m - 1,)` from block to block, hundredths of a degree.
        passed_deg: `(n - 1,)` by how much the sensor turned from packet to packet, by its clock.

    Raises:
        TruncatedScan: If there is none.
    """
    blocks = len(step) + 1
    begins = (np.flatnonzero(passed_deg >= 180.0) + 1) * (blocks // (len(passed_deg) + 1))
    runs = list(itertools.pairwise([0, *begins.tolist(), blocks]))
    last = np.array([int(np.median(step))])  # a run's last block turns on by the usual step
    turned = [_turned(np.append(step[first : end - 1], last)) for first, end in runs]
    turns = [first + _full_turns(run) for (first, _), run in zip(runs, turned, strict=True)]
    if not sum(map(len, turns)):
        most = max(int(run[-1]) for run in turned)
        raise TruncatedScan(f"the capture ends after {most // 10 / 10:.1f} of 360 degrees")
    return np.concatenate(turns)


def _sweeps(azimuth: IntArray, passed_deg: FloatArray, packet_deg: float) -> IntArray | None:
    """Return the first block and the end of each whole sweep of a limited field of view, `(k, 2)`.

    A sensor that is set to fire within half a revolution or less turns unseen by the rest, in each
    one: by its clock that looks as if packets were missing, but no block of the capture is in the
    rest. A sweep is whole if blocks of the one before it and of the next are there, and at most a
    packet is missing at its own begin and end.

    Args:
        azimuth: `(m,)` of each block, hundredths of a degree.
        passed_deg: `(n - 1,)` by how much the sensor turned from packet to packet, by its clock.
        packet_deg: By how much it usually turns from one to the next.

    Returns:
        `None` if its field of view is wider, or was swept only once: part of a revolution.

    Raises:
        TruncatedScan: If there is none.
    """
    begin_deg, view_deg = _field_of_view(azimuth)
    if not 0.0 < packet_deg < view_deg <= 180.0 + packet_deg:
        return None
    seen_deg = (azimuth / 100.0 - begin_deg) % 360.0
    returned = np.diff(seen_deg) < -min(view_deg / 2.0, 3.0 * packet_deg)  # others are in disorder
    begins = np.flatnonzero(returned) + 1
    if not len(begins):
        return None
    first, end = begins[:-1], begins[1:]
    whole = (seen_deg[first] <= packet_deg) & (seen_deg[end - 1] >= view_deg - packet_deg)
    # Where whole revolutions are missing within a sweep, its two parts are of two.
    per_packet = len(azimuth) // (len(passed_deg) + 1)
    step_deg = (np.diff(azimuth / 100.0) + 10.0) % 360.0 - 10.0  # of blocks, also over the rest
    shown_deg = np.add.reduceat(step_deg, np.arange(0, len(step_deg), per_packet))
    is_lost = passed_deg - shown_deg[: len(passed_deg)] > 180.0
    behind = (np.flatnonzero(is_lost) + 1) * per_packet
    whole &= np.searchsorted(behind, first, side="right") == np.searchsorted(behind, end)
    if not whole.any():
        raise TruncatedScan(
            f"the capture has blocks from {begin_deg:.0f} to"
            f" {(begin_deg + view_deg) % 360.0:.0f} degrees only and no whole sweep of these: is"
            " the sensor's field of view limited, or are packets missing?"
        )
    return np.stack([first, end], axis=1)[whole]


def _field_of_view(azimuth: IntArray) -> tuple[float, float]:
    """Return where the widest angle without a block ends, and how wide the rest is, degrees."""
    found = np.flatnonzero(np.bincount(azimuth % _REVOLUTION))
    blind = np.diff(found, append=found[0] + _REVOLUTION)
    widest = int(blind.argmax())
    begin, view = int(found[(widest + 1) % len(found)]), _REVOLUTION - int(blind[widest])
    return begin / 100.0, view / 100.0


def _turned(step: IntArray) -> IntArray:
    """Return by how much the sensor has turned at each of `(n,)` blocks, and at the last's end.

    Whole hundredths of a degree: in a sum of degrees, 900 steps of 0.4 are less than 360.
    """
    turned = np.cumsum(np.concatenate([[0], step]))
    return np.asarray(np.maximum.accumulate(turned))


def _full_turns(turned: IntArray) -> IntArray:
    """Return the first block and the end of each full revolution, `(k, 2)`."""
    count = int(turned[-1]) // _REVOLUTION
    starts = np.searchsorted(turned, np.arange(count + 1) * _REVOLUTION)
    return np.stack([starts[:-1], starts[1:]], axis=1)


def _returns(model: _Model, azimuth_deg: FloatArray, range_m: FloatArray) -> Float32Array:
    azimuth, elevation = np.radians(azimuth_deg), np.radians(model.elevation_deg)
    level_m = range_m * np.cos(elevation)
    height_m = np.where(range_m > 0, range_m * np.sin(elevation) + model.height_m, 0.0)
    points_m = np.stack([level_m * np.cos(azimuth), -level_m * np.sin(azimuth), height_m], axis=-1)
    return points_m.reshape(-1, 3).astype(np.float32)


def _packets(
    received: Iterator[Datagram], most_packets: int | None, kept_packets: int | None
) -> tuple[bytearray, list[float]]:
    """Return the content of the packets that are kept, joined, and each one's time."""
    payloads = bytearray()
    times_s: list[float] = []
    packets = other_bytes = 0
    first: Datagram | None = None
    for datagram in received:
        if len(datagram.payload) != _PAYLOAD_BYTES:
            other_bytes = other_bytes or len(datagram.payload)
            continue
        first = first or datagram
        require_one_sensor(first, datagram)
        packets += 1
        if most_packets is not None and packets > most_packets:
            raise ScanTooLarge(f"the capture has more than {most_packets} packets")
        if kept_packets is None or packets <= kept_packets:
            payloads += datagram.payload
            times_s.append(datagram.time_s)
    if not packets:
        wanted = " or ".join(model.name for model in _MODELS.values())
        has = "none"
        if other_bytes:
            has = f"some of {other_bytes} bytes; of an Ouster, its metadata belong to the capture"
        raise MalformedScan(
            f"the capture has no UDP packets of {_PAYLOAD_BYTES} bytes, wanted those of {wanted};"
            f" it has {has}"
        )
    return payloads, times_s


def _blocks(
    payloads: bytearray, times_s: Sequence[float]
) -> tuple[_Model, FloatArray, IntArray, np.ndarray]:
    """Return the sensor model, each block's time, each packet's clock, and each block's content."""
    mode, product = struct.unpack_from("BB", payloads, _PAYLOAD_BYTES - 2)
    if product not in _MODELS:
        known = ", ".join(f"{model.name} (0x{code:02x})" for code, model in _MODELS.items())
        raise MalformedScan(f"the packets are of product 0x{product:02x}, wanted {known}")
    records = np.frombuffer(payloads, dtype=_PACKET)
    blocks = records["blocks"].reshape(-1)
    if not (blocks["flag"] == _FLAG).all():
        raise MalformedScan("a packet has blocks that do not begin with 0xffee")
    # Of two returns the first block of each pair has the last.
    step = 2 if mode == _DUAL_RETURN else 1
    clock_us = records["clock_us"].astype(np.int64)
    return _MODELS[product], np.repeat(times_s, 12)[::step], clock_us, blocks[::step]
