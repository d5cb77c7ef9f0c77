"""Notes of a build on drives whose ground is far from where the mounting has it."""

from collections.abc import Iterable, Iterator

from core.projection.ground_offset import GroundOffset, find_ground_offset
from core.scans.drive import Drive
from core.scans.mounting import Mounting, stated_height_m


def mounting_notes(
    drives: Iterable[tuple[Drive, Mounting | None]], sensor_height_m: float
) -> Iterator[str]:
    """Yield a note on each drive whose ground is tilted, or higher or lower than stated.

    Args:
        drives: As their sensors recorded them, with the mountings of these.
        sensor_height_m: The map's sensor height, which a drive without a mounting has.
    """
    for drive, mounting in drives:
        found = find_ground_offset(drive, mounting, sensor_height_m)
        if found is not None:
            yield (
                f"drive {drive.name}: {_text(found, mounting, sensor_height_m)},"
                f" in {found.scans} of {found.of_scans} scans: correct {_wrong(found, mounting)}"
                " and build again, and query likewise"
            )


def _text(found: GroundOffset, mounting: Mounting | None, sensor_height_m: float) -> str:
    texts = []
    if found.tilt_deg is not None:
        texts.append(
            f"the ground is tilted by {found.tilt_deg:.0f} degrees from where the mounting has it"
        )
    if found.height_m is not None:
        stated_m = stated_height_m(mounting, sensor_height_m)
        texts.append(f"the sensor is {found.height_m:.1f} m above the ground, not {stated_m:g} m")
    return " and ".join(texts)


def _wrong(found: GroundOffset, mounting: Mounting | None) -> str:
    if mounting is None:
        return "sensor_height_m"
    angles = [] if found.tilt_deg is None else ["roll_deg", "pitch_deg"]
    heights = [] if found.height_m is None else ["z_m"]
    return f"{', '.join([*angles, *heights])} of its mounting"
