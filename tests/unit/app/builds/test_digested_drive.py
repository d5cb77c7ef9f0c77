"""Equal scans are noted of the scans that were read, however few of a drive these are."""

import numpy as np

from app.builds.digested_drive import DigestedDrive
from app.builds.drive_notes import equal_scan_notes
from core.scans.drive import MemoryDrive
from core.scans.scan import Scan

SCANS = [Scan(np.full((3, 3), 1.0 + at)) for at in range(60)]


def read(name: str, scans: list[Scan], every: int):
    drive = DigestedDrive(MemoryDrive(name, scans))
    for at in range(0, len(drive), every):
        drive.scan(at)
    return drive.read


def test_a_drive_is_found_in_another_one_by_each_eighth_of_its_scans():
    (note,) = equal_scan_notes([read("monday", SCANS, 1), read("tuesday", SCANS, 8)])
    assert note.startswith("8 of 8 scans of drive tuesday are those of drive monday: ")


def test_a_frozen_sensor_is_found_by_each_second_of_its_scans():
    (note,) = equal_scan_notes([read("monday", [*SCANS[:20], *[SCANS[20]] * 40], 2)])
    assert note.startswith("19 of 30 scans of drive monday are equal to the scan before them, ")
    assert "are scans 20 to 58: " in note


def test_drives_of_which_nothing_was_read_have_no_notes():
    assert not [*equal_scan_notes([read("monday", SCANS, 99), read("tuesday", SCANS[1:], 99)])]
    unread = DigestedDrive(MemoryDrive("monday", SCANS)).read
    assert not [*equal_scan_notes([unread])]
