"""A note on a scan that is not localized and does not have z up."""

# `tensormap localize` prints it: import no database and no HTTP here, 0.6 s of each start.
from core.projection.up_axis import find_other_up_axis_of_scan
from core.scans.scan import Scan

_MOSTLY = {
    "-y": " (of a camera's right, down, forward x, y, z become z, -x, -y)",
    "-z": " (of forward, right, down x, y, z become x, -y, -z)",
}
_MOUNTED = {"-y": " (of a camera's axes and yaw -90)"}


def axis_notes(scan: Scan, *sensor_heights_m: float, mounted: bool) -> list[str]:
    """Return a note if the ground is on another side of the sensor than below it, else none.

    It takes as long as a query, or twice that: for scans that are not localized, whatever their
    place is.

    Args:
        scan: The query as the map searched it: in the vehicle's frame.
        sensor_heights_m: Height of its origin above the ground, or those of the maps searched.
        mounted: Whether it was turned by a mounting.
    """
    found = find_other_up_axis_of_scan(scan.points_m, *sensor_heights_m)
    if found is None:
        return []
    name, angle_deg = found.angle_deg
    seems = f"the ground seems not to be below the sensor: {found.axis} of the scan points up"
    wanted = "; wanted are x forward, y left, z up: "
    if mounted:
        return [
            f"{seems} as it is mounted{wanted}correct `mounting`, or leave it out if the scan is"
            " in the vehicle's axes already"
        ]
    angle = f"{name.removesuffix('_deg')} {angle_deg:g}{_MOUNTED.get(found.axis, '')}"
    return [
        f"{seems}{wanted}turn the scan{_MOSTLY.get(found.axis, '')}, or, if the sensor is built in"
        f" like that, give its `mounting`, with {angle}"
    ]
