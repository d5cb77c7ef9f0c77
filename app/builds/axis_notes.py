"""Notes of a build on drives, or worlds of their poses, that do not have x forward and z up."""

from collections.abc import Collection, Iterable, Iterator

from core.projection.up_axis import find_other_up_axis
from core.scans.drive import Drive
from core.scans.forward_axis import find_other_forward_axis
from core.scans.world_up import find_other_world_up

_WORLDS = {
    "-y": " (as KITTI's cameras: x, y, z become z, -x, -y)",
    "-z": " (as north, east, down: x, y, z become y, x, -z; or do the quaternions begin with w?)",
}


def axis_notes(
    drives: Iterable[Drive], sensor_height_m: float, computed: Collection[str] = ()
) -> Iterator[str]:
    """Yield notes on each drive in which another axis than z is up, or than x forward.

    Args:
        drives: The drives as a map is built of them, mounted.
        sensor_height_m: The map's sensor height.
        computed: Names of those whose poses are odometry, which is of the sensor as it was taken to
            be.
    """
    for drive in drives:
        found = find_other_up_axis(drive, sensor_height_m)
        if found is None:
            yield from _world_notes(drive)
            yield from _forward_notes(drive)
            continue
        name, angle_deg = found.angle_deg
        mend = (
            f"turn the scans, or turn the drive's mounting by {name} {angle_deg:g} and build again,"
            " and mount queries likewise (a mounting has x_m, y_m and z_m, too)"
        )
        if drive.name in computed:
            mend = "turn the scans and upload them as another drive: its odometry is wrong, too"
        yield (
            f"drive {drive.name}: the ground is not below the sensor, {found.axis} points up in"
            f" {found.scans} of {found.of_scans} scans; wanted are x forward, y left, z up:"
            f" {mend}"
        )


def _world_notes(drive: Drive) -> Iterator[str]:
    found = find_other_world_up(drive.poses)
    if found is not None:
        yield (
            f"drive {drive.name}: {found.axis} of the world of its poses points up in"
            f" {found.share:.0%} of them; wanted is z: positions of answers are in other axes,"
            " their headings are wrong, and priors and an anchor do not fit; turn all poses by one"
            f" rotation that has z up{_WORLDS.get(found.axis, '')} and put them again, or set the"
            " mounting if it is the sensor that is not level"
        )


def _forward_notes(drive: Drive) -> Iterator[str]:
    found = find_other_forward_axis(drive.poses)
    if found is not None:
        backwards = ", unless the vehicle reversed all the way" if found.axis == "-x" else ""
        yield (
            f"drive {drive.name} moves along {found.axis} of its frame in {found.share:.0%} of its"
            " steps; wanted are x forward, y left, z up: headings are"
            f" {abs(found.yaw_deg):g} degrees off the direction of travel{backwards}; turn the"
            f" drive's mounting by yaw_deg {found.yaw_deg:g} and build again, and mount queries"
            " likewise (a mounting has x_m, y_m and z_m, too)"
        )
