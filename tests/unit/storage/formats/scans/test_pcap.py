"""Captures: fragments, VLAN tags, and work that grows with the length."""

import struct

import pytest

from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan
from storage.formats.scans import pcap as captures
from tests.support.captures import hdl32, pcap, udp


def fragments(payload: bytes, step: int) -> list[bytes]:
    frames: list[bytes] = udp(payload, 2368, fragment_bytes=step, number=7)
    return frames


def test_fragments_are_joined_in_any_order_and_once(monkeypatch: pytest.MonkeyPatch) -> None:
    joined: list[int] = []
    join = captures._Partial.joined

    def counted(partial: captures._Partial) -> bytes | None:
        joined.append(len(partial.parts))
        return join(partial)

    monkeypatch.setattr(captures._Partial, "joined", counted)
    frames = fragments(bytes(range(200)) * 6, 64)
    for order in (frames, frames[::-1], [*frames[:4], frames[2], *frames[4:]]):
        (found,) = captures.datagrams(pcap(order))
        assert found.payload == bytes(range(200)) * 6
    assert joined == [len(frames)] * 3


def test_fragments_that_overlap_or_are_too_many_are_no_datagram() -> None:
    frames = fragments(bytes(1200), 64)
    overlapping = [*frames[:3], frames[0][:20] + frames[1][20:22] + frames[0][22:], *frames[3:]]
    assert len(list(captures.datagrams(pcap(frames)))) == 1
    assert not list(captures.datagrams(pcap(overlapping[:-2])))
    many = fragments(bytes(8 * (BUDGET.fragments + 8)), 8)
    assert not list(captures.datagrams(pcap(many[: BUDGET.fragments + 1])))


def test_a_capture_of_little_but_heads_of_packets_is_rejected() -> None:
    record = struct.pack("<IIII", 1, 0, 0, 0)
    with pytest.raises(MalformedScan, match="must average 256 bytes"):
        list(captures.datagrams(pcap([]) + record * 20_000))


def test_a_packet_has_at_most_a_few_vlan_tags() -> None:
    (frame,) = udp(hdl32(turns=0.01)[0], 2368)
    for tags, found in ((2, 1), (BUDGET.vlan_tags, 1), (BUDGET.vlan_tags + 1, 0), (10_000, 0)):
        tagged = frame[:12] + b"\x81\0\0\x05" * tags + frame[12:]
        assert len(list(captures.datagrams(pcap([tagged])))) == found


def test_the_outer_of_two_vlan_tags_is_a_providers() -> None:
    (frame,) = udp(hdl32(turns=0.01)[0], 2368)
    tagged = frame[:12] + b"\x88\xa8\0\x05\x81\0\0\x06" + frame[12:]  # IEEE 802.1ad
    assert len(list(captures.datagrams(pcap([tagged])))) == 1


@pytest.mark.parametrize(
    ("link", "header"),
    [
        (101, b""),
        (113, bytes(14) + b"\x08\0"),  # `tcpdump -i any` of years ago
        (113, bytes(14) + b"\x81\0" + b"\0\5\x08\0"),
        (276, b"\x08\0" + bytes(18)),  # and of today
        (276, b"\x81\0" + bytes(18) + b"\0\5\x08\0"),
    ],
)
def test_a_capture_of_any_interface_has_the_packets_of_one_of_ethernet(
    link: int, header: bytes
) -> None:
    payload = hdl32(turns=0.01)[0]
    (frame,) = udp(payload, 2368)
    (found,) = captures.datagrams(pcap([header + frame[14:]], link=link))
    assert found.payload == payload


def test_a_capture_of_another_link_names_those_that_are_read() -> None:
    with pytest.raises(MalformedScan, match=r"link type 105, wanted one of \[1, 101, 113, 276\]"):
        list(captures.datagrams(pcap([], link=105)))
