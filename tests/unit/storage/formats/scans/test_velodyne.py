"""Captures of a Velodyne, of all around and of a limited field of view."""

import struct

import numpy as np
import pytest

from core.arrays import FloatArray
from storage.formats.errors import TruncatedScan
from storage.formats.scans.velodyne import Turns, VelodyneFormat
from tests.support.captures import pcap, udp, vlp16

VIEWS = [(0, 180), (90, 270), (270, 90), (315, 45), (10, 180), (0, 187), (355, 25)]
"""In degrees, clockwise from ahead."""


def capture(payloads: list[bytes]) -> bytes:
    return pcap([frame for payload in payloads for frame in udp(payload, 2368)])


def azimuths_deg(turns: Turns, turn: int) -> FloatArray:
    """Return the azimuths of the returns of a revolution, clockwise from ahead."""
    x, y, _ = turns.returns_m(turn).T
    return np.asarray(np.degrees(np.arctan2(-y, x)) % 360.0)


def of_900_blocks(count: int, *, first: int = 1_000, dual: bool = False) -> list[bytes]:
    """Return payloads of a VLP-16 at 10 Hz, whose steps are of 0.40 degrees: 900 a revolution.

    Args:
        count: Number of packets.
        first: Azimuth at which it begins, hundredths of a degree.
        dual: Whether each block is sent twice, the last return before the strongest.
    """
    blocks = np.arange(count * 12) // (2 if dual else 1)
    payloads = []
    for at in range(0, len(blocks), 12):
        packet = b"".join(
            struct.pack("<HH", 0xEEFF, (first + 40 * block) % 36_000)
            + struct.pack("<HB", 5000, 9) * 32
            for block in blocks[at : at + 12].tolist()
        )
        clock_us = int(blocks[at] * 110.592)
        payloads.append(packet + struct.pack("<IBB", clock_us, 0x39 if dual else 0x37, 0x22))
    return payloads


@pytest.mark.parametrize("dual", [False, True])
@pytest.mark.parametrize("first", [0, 1_000, 20_000, 35_999])
def test_a_revolution_has_each_direction_once(first: int, dual: bool) -> None:
    turns = Turns(capture(of_900_blocks(480 if dual else 240, first=first, dual=dual)))
    assert len(turns) == 3
    assert [len(turns.returns_m(turn)) for turn in range(3)] == [900 * 32] * 3


def test_a_capture_of_exactly_one_revolution_is_a_scan() -> None:
    scan = VelodyneFormat().read(capture(of_900_blocks(75)))
    assert len(scan) == 900 * 32
    with pytest.raises(TruncatedScan, match=r"the capture ends after 355\.2 of 360 degrees"):
        VelodyneFormat().read(capture(of_900_blocks(74)))


@pytest.mark.parametrize("view_deg", VIEWS)
@pytest.mark.parametrize("first_deg", [0, 100, 200, 300])
def test_each_sweep_of_a_limited_view_is_a_scan(view_deg: tuple[int, int], first_deg: int) -> None:
    turns = Turns(capture(vlp16(turns=6, view_deg=view_deg, first_deg=first_deg)))
    begin, width = view_deg[0], (view_deg[1] - view_deg[0]) % 360
    assert 4 <= len(turns) <= 5
    for turn in range(len(turns)):
        seen_deg = (azimuths_deg(turns, turn) - begin + 1e-3) % 360.0
        assert len(seen_deg) == width * 32
        assert (np.diff(seen_deg[::32]) > 0.9).all(), "one sweep, in its order"
        assert seen_deg.max() < width, "no return is spread over what the sensor does not see"


@pytest.mark.parametrize("view_deg", [(0, 360), (45, 315), (260, 100)])
def test_a_wider_view_has_revolutions_from_where_the_capture_begins(
    view_deg: tuple[int, int],
) -> None:
    turns = Turns(capture(vlp16(turns=4.1, view_deg=view_deg, first_deg=300)))
    assert len(turns) == 4
    width = (view_deg[1] - view_deg[0]) % 360 or 360
    assert [len(turns.returns_m(turn)) for turn in range(4)] == [width * 32] * 4


def test_the_first_whole_sweep_is_the_scan_of_a_capture() -> None:
    payloads = vlp16(turns=6, view_deg=(270, 90), first_deg=0)
    scan = VelodyneFormat().read(capture(payloads))
    np.testing.assert_array_equal(scan, Turns(capture(payloads)).returns_m(0))


@pytest.mark.parametrize(
    ("first", "end", "whole"),
    [
        (20, 22, 8),  # a gap in a sweep
        (15, 22, 7),  # a sweep's begin
        (22, 30, 7),  # its end, in a packet with the next begin
        (22, 37, 6),  # from within a sweep to within the next, at another azimuth
        (20, 35, 6),  # one revolution: the azimuth goes on
        (20, 65, 4),
        (15, 30, 7),  # a whole sweep: those beside it are whole
        (15, 60, 5),
    ],
)
def test_a_sweep_with_lost_packets_at_its_ends_or_of_two_revolutions_is_none(
    first: int, end: int, whole: int
) -> None:
    payloads = vlp16(turns=10, view_deg=(0, 180))  # 15 packets a sweep
    del payloads[first:end]
    assert len(Turns(capture(payloads))) == whole


def test_a_capture_without_a_whole_sweep_is_rejected_with_the_view() -> None:
    payloads = vlp16(turns=2, view_deg=(315, 45), first_deg=0)
    message = (
        "blocks from 315 to 44 degrees only and no whole sweep .*: is .* field of view limited"
    )
    with pytest.raises(TruncatedScan, match=message):
        Turns(capture(payloads[:11]))
    with pytest.raises(TruncatedScan, match=r"the capture ends after 84\.0 of 360 degrees"):
        Turns(capture(vlp16(turns=1, view_deg=(315, 45), first_deg=300)))
    with pytest.raises(TruncatedScan, match=r"the capture ends after 132\.0 of 360 degrees"):
        Turns(capture(vlp16(turns=1, view_deg=(0, 360))[:11]))
