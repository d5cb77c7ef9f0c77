"""Notes of a build on drives whose scans do not have z up."""

from collections.abc import Collection, Iterable, Iterator

from core.projection.up_axis import find_other_up_axis
from core.scans.drive import Drive


def axis_notes(
    drives: Iterable[Drive], sensor_height_m: float, computed: Collection[str] = ()
) -> Iterator[str]:
    """Yield a note on each drive in which another axis than z is up.

    Args:
        drives: The drives as a map is built of them, mounted.
        sensor_height_m: The map's sensor height.
        computed: Names of those whose poses are odometry, which is of the sensor as it was taken to
            be.
    """
    for drive in drives:
        found = find_other_up_axis(drive, sensor_height_m)
        if found is None:
            continue
        name, angle_deg = found.angle_deg
        mend = (
            f"turn the scans, or turn the drive's mounting by {name} {angle_deg:g} and build again,"
            " and mount queries likewise"
        )
        if drive.name in computed:
            mend = "turn the scans and upload them as another drive: its odometry is wrong, too"
        yield (
            f"drive {drive.name}: the ground is not below the sensor, {found.axis} points up in"
            f" {found.scans} of {found.of_scans} scans; wanted are x forward, y left, z up:"
            f" {mend}"
        )
