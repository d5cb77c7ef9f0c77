"""What reading one scan or capture may cost: every limit of the readers, with its reason.

The limits bound work, not clocks: within them the worst body that a search found takes less than
5 s of one core and 500 MB (docs/decisions/0027-budgets-of-readers.md, `make torture`).
"""

from dataclasses import dataclass

from storage.formats.errors import MalformedScan, ScanTooLarge


@dataclass(frozen=True)
class Budget:
    """Limits of the readers.

    Attributes:
        returns: Of a scan. As many as KITTI's records fill the largest body of the default
            settings; the largest spinning sensors give 16 times less (128 x 2048).
        text_returns: Of a scan as text, blank lines included; the worst numbers take 0.6 us each.
        text_bytes: Of the lines of a scan as text; 67 bytes for each of its returns.
        unpacked_bytes: What packed points inside a format (PCD, MAT) unpack to: every return of a
            scan with 32 bytes, which is four doubles.
        packed_points_bytes: Of a LAZ file, which is unpacked in a process of its own that needs
            a copy of it.
        laz_cpu_s: What unpacking a LAZ file may cost.
        elements: Of a MAT-file, and fields of its struct.
        frame_packets: How many packets are kept to find one turn or frame in a capture: 10 s of
            the fastest sensor.
        scan_packets: Packets of the sensor in the capture of one scan; some three minutes.
        stray_packets: Packets that a capture may have whatever its length.
        packet_bytes: What packets of a capture have on average, at least; a capture of a sensor
            has 500 or more, and reading a packet takes as long however short it is.
        vlan_tags: Of a packet; two are in use (IEEE 802.1ad).
        fragments: Of a datagram; more come only where packets are under 280 bytes.
    """

    returns: int = 2**22
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
        """Refuse a scan of more returns than may be.

        Raises:
            ScanTooLarge: If there are more.
        """
        if returns > self.returns:
            raise ScanTooLarge(
                f"the scan has {returns:.10g} returns, at most {self.returns} may be"
            )

    def require_text(self, text: memoryview) -> None:
        """Refuse text that has more bytes than may be.

        Raises:
            ScanTooLarge: If it has more.
        """
        if len(text) > self.text_bytes:
            raise ScanTooLarge(
                f"the lines of the scan have {len(text)} bytes, at most {self.text_bytes} may be"
            )

    def require_packets(self, packets: int, capture_bytes: int) -> None:
        """Refuse a capture that consists of too many, too short packets.

        Raises:
            MalformedScan: If there are more than may be in so many bytes.
        """
        most = self.stray_packets + capture_bytes // self.packet_bytes
        if packets > most:
            raise MalformedScan(
                f"the capture has more than {most} packets in {capture_bytes} bytes: beyond the"
                f" first {self.stray_packets} they must average {self.packet_bytes} bytes"
            )


BUDGET = Budget()
