"""Captures of Velodyne's and Ouster's packets: as scans, and as drives."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.errors import InvalidScan
from storage.formats.budget import BUDGET
from storage.formats.drives.layouts import open_drive
from storage.formats.errors import EmptyBody, MalformedScan, ScanTooLarge, TruncatedScan
from storage.formats.scans.ouster import OusterFormat
from storage.formats.scans.registry import FORMAT_NAMES, read_scan, read_scan_file
from storage.formats.scans.velodyne import Turns, VelodyneFormat
from tests.support.captures import hdl32, ouster, ouster_body, ouster_metadata, pcap, udp


def velodyne(payloads: list[bytes], **options: Any) -> bytes:
    return pcap([frame for payload in payloads for frame in udp(payload, 2368)], **options)


def at_clock(payloads: list[bytes], lost_after: int = 0, lost_us: int = 0) -> list[bytes]:
    """Set the sensor's clock: 1 ms a packet, over the end of an hour, with time lost once."""
    timed = []
    for number, payload in enumerate(payloads):
        clock_us = (3_599_990_000 + 1000 * number) % 3_600_000_000
        if number >= lost_after:
            clock_us = (clock_us + lost_us) % 3_600_000_000
        timed.append(payload[:-6] + struct.pack("<I", clock_us) + payload[-2:])
    return timed


class TestVelodyne:
    def test_a_sphere_is_a_sphere_seen_from_below_to_above(self) -> None:
        points = VelodyneFormat().read(velodyne(hdl32(turns=1.2)))
        np.testing.assert_allclose(np.linalg.norm(points, axis=1), 10.0, rtol=1e-6)
        elevation = np.degrees(np.arcsin(points[:, 2] / 10.0))
        assert elevation.min() == pytest.approx(-30.67, abs=0.01)
        assert elevation.max() == pytest.approx(10.67, abs=0.01)

    def test_a_scan_is_one_revolution_from_where_the_capture_begins(self) -> None:
        points = VelodyneFormat().read(velodyne(hdl32(turns=1.2, first_deg=300.0)))
        assert len(points) == 180 * 32
        # 300 degrees clockwise from ahead is 60 degrees to the left.
        first = np.degrees(np.arctan2(points[0, 1], points[0, 0]))
        assert first == pytest.approx(60.0, abs=1e-3)

    def test_later_firings_of_a_block_have_larger_azimuths(self) -> None:
        points = VelodyneFormat().read(velodyne(hdl32(turns=1.2)))
        azimuth = -np.degrees(np.arctan2(points[:32, 1], points[:32, 0]))
        np.testing.assert_allclose(azimuth, np.arange(32) * 2.0 * 1.152 / 46.08, atol=1e-4)

    @pytest.mark.parametrize("order", ["<", ">"])
    def test_no_return_is_zero_and_byte_orders_are_both_read(self, order: str) -> None:
        scan = velodyne(hdl32(turns=1.2, range_m=0.0), order=order)
        assert not VelodyneFormat().read(scan).any()

    def test_a_capture_is_a_drive_of_its_full_revolutions(self, tmp_path: Path) -> None:
        (tmp_path / "monday.pcap").write_bytes(velodyne(hdl32(turns=3.5)))
        drive = open_drive(tmp_path / "monday.pcap")
        assert (drive.name, len(drive)) == ("monday", 3)
        assert np.diff(drive.timestamp_s) == pytest.approx([0.015, 0.015])
        for index in range(3):
            scan = drive.scan(index)
            assert len(scan) == 180 * 32
            assert scan.timestamp_s == drive.timestamp_s[index]

    @pytest.mark.parametrize("lost_us", [8_000, 10_000_000, 3_500_000_000])
    def test_a_revolution_of_before_and_after_an_interruption_is_none(self, lost_us: int) -> None:
        turns = Turns(velodyne(at_clock(hdl32(turns=3.2), 7, lost_us)))  # 15 packets a turn
        assert len(turns) == 2
        whole = Turns(velodyne(hdl32(turns=3.2)))
        assert turns.time_s[0] == pytest.approx(whole.time_s[0] + 0.007)

    @pytest.mark.parametrize("lost_us", [0, 3_000])
    def test_a_few_lost_packets_are_a_gap_in_a_revolution(self, lost_us: int) -> None:
        assert len(Turns(velodyne(at_clock(hdl32(turns=3.2), 7, lost_us)))) == 3

    def test_a_capture_of_interruptions_only_is_rejected(self) -> None:
        halves = at_clock(hdl32(turns=0.9), 7, 10**7)
        with pytest.raises(TruncatedScan, match=r"after 168\.0 of 360 degrees"):
            Turns(velodyne(halves + halves))

    @pytest.mark.parametrize(
        ("body", "error"),
        [
            (velodyne(hdl32(turns=0.9)), TruncatedScan),
            (velodyne(hdl32(turns=0.99))[:-7], TruncatedScan),
            (velodyne(hdl32(turns=1.2))[:30], TruncatedScan),
            (pcap([]), MalformedScan),
            (pcap([])[:10], TruncatedScan),
            (b"\x0a\x0d\x0d\x0a" + bytes(40), MalformedScan),
            (velodyne([payload[:-1] + b"\x99" for payload in hdl32(turns=1.2)]), MalformedScan),
            (velodyne([b"\0\0" + payload[2:] for payload in hdl32(turns=1.2)]), MalformedScan),
            (pcap([])[:20] + b"\x63\0\0\0", MalformedScan),
            (pcap([]) + b"\xff" * 16, MalformedScan),
        ],
    )
    def test_what_is_no_full_revolution_is_rejected(
        self, body: bytes, error: type[InvalidScan]
    ) -> None:
        with pytest.raises(error):
            VelodyneFormat().read(body)

    @pytest.mark.parametrize("cut_bytes", [1, 7, 1206, 1206 + 42 + 8])
    def test_a_scan_may_be_of_a_capture_that_ends_within_a_packet_and_a_drive_not(
        self, cut_bytes: int
    ) -> None:
        body = velodyne(hdl32(turns=1.2))
        cut = body[:-cut_bytes]
        np.testing.assert_array_equal(VelodyneFormat().read(cut), VelodyneFormat().read(body))
        with pytest.raises(TruncatedScan, match="the capture ends"):
            Turns(cut)

    def test_a_capture_of_another_sensor_is_rejected_with_the_packets_that_it_has(self) -> None:
        message = r"no UDP packets of 1206 bytes, wanted .*; it has some of 500 bytes; of an Ouster"
        with pytest.raises(MalformedScan, match=message):
            VelodyneFormat().read(velodyne([bytes(500)] * 3))
        with pytest.raises(MalformedScan, match=r"wanted those of .*VLP-16; it has none$"):
            VelodyneFormat().read(velodyne([]))

    @pytest.mark.parametrize(
        ("port", "source", "other"),
        [
            (2369, bytes([192, 168, 1, 201]), "192.168.1.201 to port 2369"),
            (2368, bytes(4), "0.0.0.0"),
        ],
    )
    def test_packets_of_two_sensors_are_rejected_and_both_named(
        self, port: int, source: bytes, other: str
    ) -> None:
        payloads = hdl32(turns=1.2)
        one = [udp(payload, 2368, source=bytes([192, 168, 1, 201])) for payload in payloads]
        two = [udp(payload, port, source=source) for payload in payloads]
        mixed = pcap([frame for pair in zip(one, two, strict=True) for (frame,) in pair])
        message = f"of two sensors, 192.168.1.201 to port 2368 and {other}.*wanted one"
        with pytest.raises(MalformedScan, match=message):
            VelodyneFormat().read(mixed)

    def test_more_packets_than_a_scan_needs_are_rejected(self) -> None:
        with pytest.raises(ScanTooLarge, match="more than 3 packets"):
            Turns(velodyne(hdl32(turns=1.2)), most_packets=3)


class TestOuster:
    def body(self, fragment_bytes: int | None = None, **changed: Any) -> bytes:
        frames = [
            frame
            for number, payload in enumerate(ouster())
            for frame in udp(payload, 7502, fragment_bytes=fragment_bytes, number=number)
        ]
        return ouster_body(ouster_metadata(**changed), frames)

    @pytest.mark.parametrize("fragment_bytes", [None, 1480])
    def test_a_sphere_is_a_sphere_in_pieces_too(self, fragment_bytes: int | None) -> None:
        points = OusterFormat().read(self.body(fragment_bytes))
        assert points.shape == (512 * 16, 3)
        np.testing.assert_allclose(np.linalg.norm(points, axis=1), 10.0, rtol=1e-6)
        # Column 0 is opposite to the lidar's x axis: behind the sensor.
        np.testing.assert_allclose(points[0, :2], [-10 * np.cos(np.radians(15)), 0.0], atol=1e-5)
        assert points[512 // 4 * 16, 1] > 9  # clockwise: from behind to the left

    def test_beams_begin_beside_the_origin(self) -> None:
        points = OusterFormat().read(self.body(lidar_origin_to_beam_origin_mm=100.0))
        level_m = np.hypot(points[:16, 0], points[:16, 1])
        elevation = np.radians(np.linspace(15, -15, 16))
        np.testing.assert_allclose(level_m, 9.9 * np.cos(elevation) + 0.1, rtol=1e-6)

    def test_a_capture_with_its_metadata_beside_it_is_read(self, tmp_path: Path) -> None:
        metadata, capture = self.body().split(b"\n", 1)
        (tmp_path / "a.pcap").write_bytes(capture)
        (tmp_path / "a.json").write_bytes(metadata)
        scan = read_scan_file(tmp_path / "a.pcap", min_returns=1)
        assert len(scan) == 512 * 16

    @pytest.mark.parametrize("fragment_bytes", [None, 1480])
    def test_packets_of_two_sensors_are_rejected(self, fragment_bytes: int | None) -> None:
        frames = [
            frame
            for number, payload in enumerate(ouster())
            for source in (b"\x0a\0\0\1", b"\x0a\0\0\2")
            for frame in udp(
                payload, 7502, fragment_bytes=fragment_bytes, number=number, source=source
            )
        ]
        message = r"of two sensors, 10\.0\.0\.1 to port 7502 and 10\.0\.0\.2 to port 7502"
        with pytest.raises(MalformedScan, match=message):
            OusterFormat().read(ouster_body(ouster_metadata(), frames))

    def test_packets_of_another_layout_are_rejected(self) -> None:
        layout = ouster_metadata()["data_format"] | {"pixels_per_column": 32}
        angles: dict[str, Any] = dict.fromkeys(
            ("beam_altitude_angles", "beam_azimuth_angles"), [0.0] * 32
        )
        with pytest.raises(MalformedScan, match="no UDP packets of 6400 bytes"):
            OusterFormat().read(self.body(data_format=layout, **angles))

    @pytest.mark.parametrize(
        "changed",
        [
            {"beam_altitude_angles": [1.0] * 15},
            {"beam_azimuth_angles": ["a"] * 16},
            {"lidar_to_sensor_transform": [1.0]},
            {"data_format": {}},
            {"data_format": 7},
            {"lidar_origin_to_beam_origin_mm": float("nan")},
            {"data_format": ouster_metadata()["data_format"] | {"columns_per_frame": 10**9}},
            {"data_format": ouster_metadata()["data_format"] | {"columns_per_frame": 512.5}},
            {"data_format": ouster_metadata()["data_format"] | {"udp_profile_lidar": "X"}},
            {"data_format": ouster_metadata()["data_format"] | {"column_window": [0, 512]}},
        ],
    )
    def test_metadata_that_make_no_sense_are_rejected(self, changed: dict[str, Any]) -> None:
        with pytest.raises(MalformedScan, match="metadata"):
            OusterFormat().read(self.body(**changed))

    @pytest.mark.parametrize(
        "name", ["pixels_per_column", "columns_per_frame", "columns_per_packet"]
    )
    def test_a_whole_number_of_metadata_may_have_a_decimal_point(self, name: str) -> None:
        layout = ouster_metadata()["data_format"]
        with_point = self.body(data_format=layout | {name: float(layout[name])})
        points = OusterFormat().read(with_point)
        np.testing.assert_array_equal(points, OusterFormat().read(self.body()))

    @pytest.mark.parametrize("body", [b"{", b"[" * 100_000, b"7", b"\xff" * 40, b"{}"])
    def test_invalid_metadata_are_rejected(self, body: bytes) -> None:
        with pytest.raises(MalformedScan):
            read_scan(body, media_type=OusterFormat().media_type, min_returns=1)

    @pytest.mark.parametrize("cut_bytes", [1, 1000])
    def test_a_capture_may_end_within_a_packet_after_a_whole_frame(self, cut_bytes: int) -> None:
        again = [*ouster(), ouster()[0]]
        frames = [frame for payload in again for frame in udp(payload, 7502)]
        cut = ouster_body(ouster_metadata(), frames)[:-cut_bytes]
        np.testing.assert_array_equal(OusterFormat().read(cut), OusterFormat().read(self.body()))
        with pytest.raises(TruncatedScan, match="496 of 512"):
            OusterFormat().read(self.body()[:-cut_bytes])
        with pytest.raises(TruncatedScan, match="the capture ends"):
            OusterFormat().read(ouster_body(ouster_metadata(), frames[:1])[:-cut_bytes])

    @pytest.mark.parametrize("blanks", [b"", b"\n", b" \r\n\t\n"])
    def test_a_pcapng_capture_behind_metadata_is_named_as_that(self, blanks: bytes) -> None:
        head = json.dumps(ouster_metadata()).encode() + blanks
        for capture in (b"\x0a\x0d\x0d\x0a" + bytes(40), b"\x0a\x0d\x0d\x0a"):
            with pytest.raises(MalformedScan, match=r"a pcapng capture, .*editcap -F pcap"):
                OusterFormat().read(head + capture)
        with pytest.raises(MalformedScan, match="begins with b'', which is no classic pcap"):
            OusterFormat().read(head)

    def test_a_frame_that_lacks_columns_is_no_scan(self) -> None:
        frames = [frame for payload in ouster(496) for frame in udp(payload, 7502)]
        with pytest.raises(TruncatedScan, match="496 of 512"):
            OusterFormat().read(ouster_body(ouster_metadata(), frames))

    @pytest.mark.parametrize("late", [1, 2, 20])
    def test_a_packet_that_arrives_after_the_next_frame_began_is_of_its_own_frame(
        self, late: int
    ) -> None:
        first, second = ouster(frame=65_535), ouster(frame=0, range_mm=20_000)
        payloads = [*first[:-1], *second[:late], first[-1], *second[late:]]
        frames = [frame for payload in payloads for frame in udp(payload, 7502)]
        points = OusterFormat().read(ouster_body(ouster_metadata(), frames))
        np.testing.assert_array_equal(points, OusterFormat().read(self.body()))

    def test_a_frame_after_one_that_lacks_a_packet_has_nothing_of_it(self) -> None:
        first, second = ouster(frame=1), ouster(frame=2, range_mm=20_000)
        third = ouster(frame=3, range_mm=30_000)
        frames = [f for p in [*first[1:], *second[:-1], *third] for f in udp(p, 7502)]
        points = OusterFormat().read(ouster_body(ouster_metadata(), frames))
        np.testing.assert_allclose(np.linalg.norm(points, axis=1), 30.0, rtol=1e-6)

    def test_newer_metadata_have_sections(self) -> None:
        old = ouster_metadata()
        beams = ("beam_altitude_angles", "beam_azimuth_angles", "lidar_origin_to_beam_origin_mm")
        new = {
            "beam_intrinsics": {key: old[key] for key in beams},
            "lidar_intrinsics": {"lidar_to_sensor_transform": old["lidar_to_sensor_transform"]},
            "lidar_data_format": old["data_format"],
        }
        frames = [frame for payload in ouster() for frame in udp(payload, 7502)]
        body = ouster_body(new, frames)
        assert json.loads(body.split(b"\n", 1)[0]) == new
        np.testing.assert_array_equal(OusterFormat().read(body), OusterFormat().read(self.body()))


def test_an_ousters_metadata_beside_its_capture_are_read_also_where_its_format_is_given(
    tmp_path: Path,
) -> None:
    capture = tmp_path / "a.pcap"
    capture.write_bytes(pcap([frame for payload in ouster() for frame in udp(payload, 7502)]))
    capture.with_suffix(".json").write_text(json.dumps(ouster_metadata()))
    given = read_scan_file(capture, media_type=FORMAT_NAMES["ouster"], min_returns=1)
    found = read_scan_file(capture, min_returns=1)
    np.testing.assert_array_equal(given.points_m, found.points_m)
    with pytest.raises(InvalidScan):
        read_scan_file(capture, media_type=FORMAT_NAMES["velodyne"], min_returns=1)


@pytest.mark.parametrize("name", ["data_format", "beam_altitude_angles"])
def test_a_field_that_an_ousters_metadata_lack_is_named_as_that(name: str) -> None:
    metadata = ouster_metadata()
    del metadata[name]
    with pytest.raises(MalformedScan, match=f"^the metadata has no field '{name}'$"):
        OusterFormat().read(ouster_body(metadata, []))


def test_a_capture_without_a_byte_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "a.pcap").touch()
    with pytest.raises(EmptyBody, match=r"a\.pcap is empty"):
        open_drive(tmp_path / "a.pcap")


def test_a_scan_of_a_sensor_that_rotates_too_slowly_is_rejected() -> None:
    frames = [f for p in hdl32(turns=0.01) for f in udp(p, 2368)]
    body = pcap(frames)[:24] + pcap(frames)[24:] * (BUDGET.scan_packets + 1)
    with pytest.raises(ScanTooLarge, match="more than 200000 packets"):
        read_scan(body, media_type=FORMAT_NAMES["velodyne"], min_returns=1)
