"""Captures of network traffic, classic `.pcap`: the UDP datagrams in them."""

import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from storage.formats.errors import MalformedScan, TruncatedScan

__all__ = ["PCAP_MAGICS", "Buffer", "Datagram", "datagrams"]

Buffer = bytes | mmap.mmap
"""A capture in memory, or a file that is mapped there."""

_ORDERS = {
    b"\xd4\xc3\xb2\xa1": ("<", 1e-6),
    b"\xa1\xb2\xc3\xd4": (">", 1e-6),
    b"\x4d\x3c\xb2\xa1": ("<", 1e-9),
    b"\xa1\xb2\x3c\x4d": (">", 1e-9),
}
PCAP_MAGICS = tuple(_ORDERS)
_PCAPNG = b"\x0a\x0d\x0d\x0a"
_ETHERNET, _RAW_IP, _LINUX_COOKED = 1, 101, 113
_LINK_BYTES = {_ETHERNET: 14, _RAW_IP: 0, _LINUX_COOKED: 16}
_IPV4, _VLAN = b"\x08\x00", b"\x81\x00"
_UDP = 17
_LARGEST_PACKET_BYTES = 2**18
_MOST_PARTIAL = 64  # datagrams in pieces at a time


@dataclass(frozen=True)
class Datagram:
    """One UDP datagram.

    Attributes:
        time_s: When it was captured, seconds since 1970.
        port: Its destination.
        payload: What it carries.
    """

    time_s: float
    port: int
    payload: bytes


def datagrams(body: Buffer) -> Iterator[Datagram]:
    """Give the UDP datagrams of a capture; those that came in pieces are put together.

    Raises:
        MalformedScan: If it is no classic pcap of Ethernet or IP packets.
        TruncatedScan: If the capture ends within a packet.
    """
    if body[:4] == _PCAPNG:
        raise MalformedScan("this is a pcapng capture, wanted classic pcap (editcap -F pcap)")
    if body[:4] not in _ORDERS:
        raise MalformedScan(f"the body begins with {body[:4]!r}, which is no classic pcap")
    order, tick_s = _ORDERS[body[:4]]
    if len(body) < 24:
        raise TruncatedScan(f"a capture begins with 24 bytes, {len(body)} came")
    link = struct.unpack_from(f"{order}I", body, 20)[0] & 0xFFFF
    if link not in _LINK_BYTES:
        raise MalformedScan(f"the packets are of link type {link}, wanted {sorted(_LINK_BYTES)}")
    pieces = _Pieces()
    at = 24
    while at < len(body):
        if at + 16 > len(body):
            raise TruncatedScan(f"the capture ends within the head of a packet, at byte {at}")
        seconds, ticks, size, _ = struct.unpack_from(f"{order}IIII", body, at)
        if size > _LARGEST_PACKET_BYTES:
            raise MalformedScan(f"the packet at byte {at} claims {size} bytes")
        if at + 16 + size > len(body):
            raise TruncatedScan(f"the packet at byte {at} claims {size} bytes, the capture ends")
        packet = body[at + 16 : at + 16 + size]
        at += 16 + size
        whole = pieces.add(_ip_packet(packet, link))
        if whole is not None and len(whole) >= 8:
            port, length = struct.unpack_from("!HH", whole, 2)
            if 8 <= length <= len(whole):
                yield Datagram(seconds + ticks * tick_s, port, whole[8:length])


def _ip_packet(packet: bytes, link: int) -> bytes:
    """Return the IPv4 packet inside, empty if there is none."""
    start = _LINK_BYTES[link]
    if link != _RAW_IP:
        kind = packet[start - 2 : start]
        while kind == _VLAN:
            start += 4
            kind = packet[start - 2 : start]
        if kind != _IPV4:
            return b""
    return packet[start:]


class _Pieces:
    """Puts fragments of IPv4 packets together; what is never completed is forgotten."""

    def __init__(self) -> None:
        self._partial: dict[bytes, dict[int, tuple[bytes, bool]]] = {}

    def add(self, packet: bytes) -> bytes | None:
        """Take a packet; return a UDP datagram with its head if that completes one."""
        if len(packet) < 20 or packet[0] >> 4 != 4 or packet[9] != _UDP:
            return None
        head_bytes = (packet[0] & 0x0F) * 4
        total, flags = struct.unpack_from("!H2xH", packet, 2)
        if head_bytes < 20 or not head_bytes <= total <= len(packet):
            return None
        content = packet[head_bytes:total]
        offset, more = (flags & 0x1FFF) * 8, bool(flags & 0x2000)
        if not offset and not more:
            return content
        key = packet[4:6] + packet[12:20]
        parts = self._partial.setdefault(key, {})
        parts[offset] = (content, more)
        if len(self._partial) > _MOST_PARTIAL:
            del self._partial[next(iter(self._partial))]
        joined, expected = [], 0
        while expected in parts:
            content, more = parts[expected]
            joined.append(content)
            if not more:
                self._partial.pop(key, None)
                return b"".join(joined)
            if not content:
                return None
            expected += len(content)
        return None
