"""Drives that are evaluated, and what a build notes of them or refuses them for."""

from pathlib import Path

from app.builds.axis_notes import axis_notes
from app.builds.digested_drive import DigestedDrive
from app.builds.drive_notes import equal_scan_notes, motion_notes, time_notes
from app.builds.mounting_notes import mounting_notes
from app.builds.parameters import Align
from app.builds.pose_checks import check_recorded
from app.cli.console import progress_bar, say_note
from app.cli.options import open_recorded
from core.scans.drive import Drive
from core.scans.mounting import Mounting, stated_height_m, vehicle_drive


class NotedDrives:
    """Opens drives for an evaluation, checks each as a build does, and keeps the notes.

    Nothing is refused: recall is high also of scans that are in the map's frame, upside down or of
    another drive than the poses, as queries are wrong in the way that the map is. The notes are
    printed at once, before the long work, and belong beside the figures. Those on equal scans come
    after it, of the scans that were read.

    Args:
        sensor_height_m: The map's sensor height.
        accumulate: How many consecutive scans become one.

    Attributes:
        notes: All of them, in the order in which they came.
    """

    def __init__(self, sensor_height_m: float, accumulate: int = 1) -> None:
        self._height_m, self._accumulate = sensor_height_m, accumulate
        self._read: list[DigestedDrive] = []
        self.notes: list[str] = []

    def open(self, path: Path, mounting: Mounting | None) -> Drive:
        """Return a drive as the service would build a map of it, checked.

        A drive without poses, or whose poses cannot be checked, is opened too.
        """
        recorded = DigestedDrive(open_recorded(path))
        self._read.append(recorded)
        height_m = stated_height_m(mounting, self._height_m)
        mapped = vehicle_drive(recorded, mounting, self._height_m, self._accumulate)
        with progress_bar() as progress:
            of_poses = check_recorded(recorded, height_m, Align.OFF, progress)
        self.note(*of_poses)
        self.note(*mounting_notes([(recorded, mounting)], self._height_m))
        self.note(*axis_notes([mapped], self._height_m))
        times = recorded.name, recorded.scan_index, recorded.timestamp_s
        self.note(*time_notes(*times), *motion_notes(*times, recorded.poses))
        return mapped

    def note_equal_scans(self) -> None:
        """Note scans that repeat, in one drive or in two, of those that were read.

        A query that is the scan of the map itself is found whatever the map is.
        """
        self.note(*equal_scan_notes([drive.read for drive in self._read]))

    def note(self, *notes: str) -> None:
        """Keep and print notes."""
        self.notes += notes
        for note in notes:
            say_note(note)
