"""Captures as Velodyne's and Ouster's sensors send them, made here."""

import json
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np


def udp(
    payload: bytes,
    port: int,
    *,
    fragment_bytes: int | None = None,
    number: int = 0,
    source: bytes = bytes(4),
) -> Any:
    """Return the Ethernet frames of one datagram, in pieces if it does not fit."""
    content = struct.pack("!HHHH", 1000, port, 8 + len(payload), 0) + payload
    step = fragment_bytes or len(content)
    frames = []
    for start in range(0, len(content), step):
        part = content[start : start + step]
        more = 0x2000 if start + step < len(content) else 0
        head = struct.pack(
            "!BBHHHBBH4s4s",
            0x45,
            0,
            20 + len(part),
            number,
            more | start // 8,
            9,
            17,
            0,
            source,
            b"",
        )
        frames.append(bytes(12) + b"\x08\x00" + head + part)
    return frames


def pcap(frames: Sequence[bytes], *, order: str = "<", link: int = 1) -> bytes:
    """Return a classic capture of frames a millisecond apart, by default Ethernet's."""
    body = struct.pack(f"{order}IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, link)
    for number, frame in enumerate(frames):
        head = struct.pack(f"{order}IIII", 100, number * 1000, len(frame), len(frame))
        body += head + frame
    return body


def hdl32(*, turns: float, first_deg: float = 0.0, range_m: float = 10.0) -> list[bytes]:
    """Return the payloads of an HDL-32E that sees a sphere around it, with 180 columns a turn."""
    count = int(turns * 180) + 1
    azimuths = (first_deg + np.arange(count) * 2.0) % 360
    blocks = [
        struct.pack("<HH", 0xEEFF, round(azimuth * 100) % 36000)
        + struct.pack("<HB", round(range_m / 0.002), 9) * 32
        for azimuth in azimuths
    ]
    blocks += [blocks[-1]] * (-len(blocks) % 12)
    tail = struct.pack("<IBB", 0, 0x37, 0x21)
    return [b"".join(blocks[at : at + 12]) + tail for at in range(0, len(blocks), 12)]


def vlp16(*, turns: float, view_deg: tuple[int, int], first_deg: int = 0) -> list[bytes]:
    """Return the payloads of a VLP-16 that fires within an angle, 360 times a turn of 0.1 s.

    Packets are sent when they are full: one may have blocks of the end and of the next begin.

    Args:
        turns: How far it rotates.
        view_deg: Where it begins and ends to fire; from 270 to 90 it does ahead.
        first_deg: Where it is first.
    """
    begin, end = view_deg
    width = (end - begin) % 360 or 360
    fired = [at for at in range(round(turns * 360)) if (first_deg + at - begin) % 360 < width]
    packets = []
    for first in range(0, len(fired) - 11, 12):
        packet = b"".join(
            struct.pack("<HH", 0xEEFF, (first_deg + at) % 360 * 100)
            + struct.pack("<HB", 5000, 9) * 32
            for at in fired[first : first + 12]
        )
        packets.append(packet + struct.pack("<IBB", fired[first] * 100_000 // 360, 0x37, 0x22))
    return packets


def ouster_metadata(**changed: Any) -> dict[str, Any]:
    """Return the metadata of a sensor of 16 beams and 512 columns."""
    return {
        "beam_altitude_angles": np.linspace(15, -15, 16).tolist(),
        "beam_azimuth_angles": [0.0] * 16,
        "lidar_origin_to_beam_origin_mm": 0.0,
        "lidar_to_sensor_transform": [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1],
        "data_format": {
            "pixels_per_column": 16,
            "columns_per_frame": 512,
            "columns_per_packet": 16,
            "column_window": [0, 511],
            "udp_profile_lidar": "RNG19_RFL8_SIG16_NIR16",
        },
    } | changed


def ouster(columns: int = 512, *, frame: int = 7, range_mm: int = 10_000) -> list[bytes]:
    """Return the payloads of that sensor inside a sphere, as one frame."""
    pixel = struct.pack("<IHHHH", range_mm, 0, 0, 0, 0)
    packets = []
    for first in range(0, columns, 16):
        packet = struct.pack("<HH28x", 1, frame)
        for column in range(first, first + 16):
            packet += struct.pack("<QHH", 0, column, 1) + pixel * 16
        packets.append(packet + bytes(32))
    return packets


def ouster_body(metadata: dict[str, Any], frames: Sequence[bytes]) -> bytes:
    """Return metadata and capture in one body."""
    return json.dumps(metadata).encode() + b"\n" + pcap(frames)
