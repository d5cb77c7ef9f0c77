"""Captures of network traffic, classic `.pcap`: the UDP datagrams in them."""

import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

from storage.formats.budget import BUDGET
from storage.formats.errors import MalformedScan, TruncatedScan

Buffer = bytes | mmap.mmap
"""A capture in memory, or a file that is mapped there."""

_ORDERS = {
    b"\xd4\xc3\xb2\xa1": ("<", 1e-6),
    b"\xa1\xb2\xc3\xd4": (">", 1e-6),
    b"\x4d\x3c\xb2\xa1": ("<", 1e-9),
    b"\xa1\xb2\x3c\x4d": (">", 1e-9),
}
PCAP_MAGICS = tuple(_ORDERS)
PCAPNG_MAGIC = b"\x0a\x0d\x0d\x0a"
_RAW_IP, _ETHERNET, _LINUX_COOKED, _LINUX_COOKED_2 = 101, 1, 113, 276
_HEADERS = {_ETHERNET: (14, 12), _LINUX_COOKED: (16, 14), _LINUX_COOKED_2: (20, 0)}
"""How many bytes a packet's header has, and where in it the protocol of what follows is."""
_IPV4, _VLANS = b"\x08\x00", (b"\x81\x00", b"\x88\xa8")
_UDP = 17
_LARGEST_PACKET_BYTES = 2**18
_MOST_PARTIAL = 64  # incomplete datagrams at a time
_COUNTED_PACKETS = 1024


@dataclass(frozen=True)
class Datagram:
    """One UDP datagram.

    Attributes:
        time_s: When it was captured, seconds since 1970.
        payload: What it carries.
        sender: The IPv4 address that it is from and the port that it is to: of each sensor another.
    """

    time_s: float
    payload: bytes
    sender: bytes


def require_one_sensor(first: Datagram, other: Datagram) -> None:
    """Reject packets of a second sensor, which would be scans of both.

    Raises:
        MalformedScan: If another sender sent them.
    """
    if other.sender != first.sender:
        senders = " and ".join(map(_shown, (first.sender, other.sender)))
        raise MalformedScan(
            f"the capture has packets of two sensors, {senders}: wanted one, as"
            " `tcpdump -r all.pcap -w one.pcap` with `src host ADDRESS` or `dst port PORT` leaves"
        )


def _shown(sender: bytes) -> str:
    return f"{'.'.join(map(str, sender[:4]))} to port {int.from_bytes(sender[4:], 'big')}"


def datagrams(body: Buffer, start: int = 0) -> Iterator[Datagram]:
    """Yield the UDP datagrams of a capture, fragmented ones reassembled, in linear time.

    Args:
        body: The capture, to its end.
        start: Where the capture begins.

    Raises:
        MalformedScan: If it is no classic pcap of Ethernet or IP packets, or has more packets
            than allowed.
        TruncatedScan: If the capture ends within a packet.
    """
    magic = body[start : start + 4]
    if magic == PCAPNG_MAGIC:
        raise MalformedScan("this is a pcapng capture, wanted classic pcap (editcap -F pcap)")
    if magic not in _ORDERS:
        raise MalformedScan(f"the body begins with {magic!r}, which is no classic pcap")
    order, tick_s = _ORDERS[magic]
    if len(body) < start + 24:
        raise TruncatedScan(f"a capture begins with 24 bytes, got {len(body) - start}")
    link = struct.unpack_from(f"{order}I", body, start + 20)[0] & 0xFFFF
    if link != _RAW_IP and link not in _HEADERS:
        wanted = sorted([_RAW_IP, *_HEADERS])
        raise MalformedScan(f"the packets are of link type {link}, wanted one of {wanted}")
    fragments = _Fragments()
    at = start + 24
    packets = 0
    while at < len(body):
        packets += 1
        if packets % _COUNTED_PACKETS == 0:
            BUDGET.require_packets(packets, len(body))
        if at + 16 > len(body):
            raise TruncatedScan(f"the capture ends within the header of a packet, at byte {at}")
        seconds, ticks, size, _ = struct.unpack_from(f"{order}IIII", body, at)
        if size > _LARGEST_PACKET_BYTES:
            raise MalformedScan(f"the packet at byte {at} claims {size} bytes")
        if at + 16 + size > len(body):
            raise TruncatedScan(f"the packet at byte {at} claims {size} bytes, the capture ends")
        packet = body[at + 16 : at + 16 + size]
        at += 16 + size
        packet = _ip_packet(packet, link)
        whole = fragments.add(packet)
        if whole is not None and len(whole) >= 8:
            (length,) = struct.unpack_from("!H", whole, 4)
            if 8 <= length <= len(whole):
                sender = packet[12:16] + whole[2:4]
                yield Datagram(seconds + ticks * tick_s, whole[8:length], sender)


def datagrams_before_cut(body: Buffer, start: int = 0) -> Iterator[Datagram]:
    """Yield the datagrams of a capture that may end within a packet, as where it was killed.

    Raises:
        MalformedScan: As `datagrams`.
        TruncatedScan: If the capture ends before its first datagram.
    """
    found = False
    try:
        for datagram in datagrams(body, start):
            found = True
            yield datagram
    except TruncatedScan:
        if not found:
            raise


def _ip_packet(packet: bytes, link: int) -> bytes:
    """Return the IPv4 packet inside, empty if there is none."""
    if link == _RAW_IP:
        return packet
    size, at = _HEADERS[link]
    for _ in range(BUDGET.vlan_tags):
        if packet[at : at + 2] not in _VLANS:
            break
        at, size = size + 2, size + 4  # a tag follows the header, and ends with the next protocol
    return packet[size:] if packet[at : at + 2] == _IPV4 else b""


@dataclass
class _Partial:
    """The received fragments of one datagram.

    Attributes:
        parts: The fragments by their offset.
        received_bytes: The fragments' total length.
        total_bytes: The datagram's length, `None` before its last fragment.
    """

    parts: dict[int, bytes] = field(default_factory=dict)
    received_bytes: int = 0
    total_bytes: int | None = None

    def add(self, offset: int, content: bytes, *, more: bool) -> None:
        """Add a fragment; it replaces an earlier one at the same offset."""
        self.received_bytes += len(content) - len(self.parts.get(offset, b""))
        self.parts[offset] = content
        if not more:
            self.total_bytes = offset + len(content)

    @property
    def is_over(self) -> bool:
        """Whether all bytes were received, or more fragments than allowed."""
        return len(self.parts) > BUDGET.fragments or (
            self.total_bytes is not None and self.received_bytes >= self.total_bytes
        )

    def joined(self) -> bytes | None:
        """Return the datagram, `None` if fragments overlap or are missing."""
        whole = []
        at = 0
        for offset, content in sorted(self.parts.items()):
            if offset != at:
                return None
            whole.append(content)
            at += len(content)
        return b"".join(whole) if at == self.total_bytes else None


class _Fragments:
    """Reassembles fragmented IPv4 packets; incomplete ones are dropped, the oldest first.

    A datagram is joined once, when all its bytes were received: to try that after every fragment
    would take time in the square of their number.
    """

    def __init__(self) -> None:
        self._partial: dict[bytes, _Partial] = {}

    def add(self, packet: bytes) -> bytes | None:
        """Add a packet; return the UDP datagram that it completes, with its header."""
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
        partial = self._partial.setdefault(key, _Partial())
        partial.add(offset, content, more=more)
        if partial.is_over:
            del self._partial[key]
            return partial.joined()
        if len(self._partial) > _MOST_PARTIAL:
            del self._partial[next(iter(self._partial))]
        return None
