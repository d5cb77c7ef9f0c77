"""The limits of the readers of scans and captures, each with its reason.

The limits bound work, not clocks: within them the worst body that a search found takes less than
5 s of one core and 500 MB (docs/decisions/0027-budgets-of-readers.md, `make torture`).
"""

from dataclasses import dataclass

from storage.formats.errors import MalformedScan, ScanTooLarge


@dataclass(frozen=True)
class Budget:
    """Limits of the readers.

    Attributes:
        returns: Returns of a scan: as many as KITTI's records fill the largest body of the default
            settings; the largest spinning sensors give 16 times less (128 x 2048).
        decoded_bytes: Bytes of all the points of a PCD, LAS or LAZ file.
        text_returns: Returns of a scan as text, blank lines included; the worst numbers take 0.6 us
            each.
        text_bytes: Bytes of the lines of a scan as text; 67 bytes for each of its returns.
        unpacked_bytes: Bytes of compressed points inside a format (PCD, MAT), unpacked: every
            return of a scan with 32 bytes, which is four doubles.
        packed_points_bytes: Bytes of the points of a LAZ file, which is unpacked in a process of
            its own that needs a copy of it.
        laz_cpu_s: CPU time to unpack a LAZ file.
        elements: Elements of a MAT-file, and fields of its struct.
        frame_packets: Packets that are kept to find one revolution or frame in a capture: 10 s of
            the fastest sensor.
        scan_packets: Packets of the sensor in the capture of one scan; some three minutes.
        stray_packets: Packets that a capture may have whatever its length.
        packet_bytes: Minimum mean length of a capture's packets; a capture of a sensor has 500 or
            more, and the time to read a packet does not depend on its length.
        vlan_tags: VLAN tags of a packet; two are in use (IEEE 802.1ad).
        fragments: Fragments of a datagram; it has more only where packets are under 280 bytes.
    """

    returns: int = 2**22
    decoded_bytes: int = 256 * 2**20
    text_returns: int = 2_000_000
    text_bytes: int = 128 * 2**20
    unpacked_bytes: int = 128 * 2**20
    packed_points_bytes: int = 64 * 2**20
    laz_cpu_s: int = 5
    elements: int = 1000
    frame_packets: int = 20_000
    scan_packets: int = 200_000
    stray_packets: int = 10_000
    packet_bytes: int = 256
    vlan_tags: int = 4
    fragments: int = 256

    def require_returns(self, returns: int) -> None:
        """Reject a scan of more returns than allowed.

        Raises:
            ScanTooLarge: If there are more.
        """
        if returns > self.returns:
            raise ScanTooLarge(f"the scan has {returns:.10g} returns, at most {self.returns}")

    def require_packets(self, packets: int, capture_bytes: int) -> None:
        """Reject a capture that consists of too many, too short packets.

        Raises:
            MalformedScan: If there are more than allowed in so many bytes.
        """
        most = self.stray_packets + capture_bytes // self.packet_bytes
        if packets > most:
            raise MalformedScan(
                f"the capture has more than {most} packets in {capture_bytes} bytes: beyond the"
                f" first {self.stray_packets} they must average {self.packet_bytes} bytes"
            )


BUDGET = Budget()
