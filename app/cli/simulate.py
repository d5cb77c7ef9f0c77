"""`tensormap simulate`: a simulated drive."""

from pathlib import Path
from typing import Annotated

import typer

from app.cli.console import progress_bar, say
from app.cli.output_files import require_writable
from core.scans.sensor import SENSORS, sensor_named
from core.simulation import SimulatedDrive
from core.simulation.drive import TURN_RADIUS_M
from core.simulation.raycast import SimulatedSensor
from core.text import count_of
from storage.formats.drives.kitti_drive import write_kitti_drive


def _less_than_the_turn_radius(lateral_m: float) -> float:
    if not abs(lateral_m) < TURN_RADIUS_M:
        raise typer.BadParameter(
            f"{lateral_m:g} m, wanted less than {TURN_RADIUS_M:g} m either way"
        )
    return lateral_m


def simulate(
    folder: Annotated[
        Path, typer.Argument(metavar="OUT", help="Folder to write; empty or not there yet.")
    ],
    scans: Annotated[
        int, typer.Option(min=1, max=1_000_000, help="Number of scans, ten a second.")
    ] = 60,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the city and its route.")] = 0,
    traffic_seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of parked and moving cars. [the city's seed]")
    ] = None,
    lateral_m: Annotated[
        float,
        typer.Option(
            help="Lateral offset from the line, positive to the left, less than"
            f" {TURN_RADIUS_M:g} m either way.",
            callback=_less_than_the_turn_radius,
        ),
    ] = 0.0,
    reverse: Annotated[bool, typer.Option("--reverse", help="Drive the other way.")] = False,
    stops: Annotated[bool, typer.Option("--stops", help="Stop at junctions for a while.")] = False,
    sensor: Annotated[
        str | None,
        typer.Option(help=f"One of {', '.join(sorted(SENSORS))}. [an HDL-64E with 1,000 azimuths]"),
    ] = None,
) -> None:
    """Drive through a simulated city and write the scans in KITTI odometry layout.

    Two drives of one seed and as many scans follow one line in one world frame: vary the traffic,
    the lane or the direction for a second pass.
    """
    require_writable(folder)
    drive = SimulatedDrive(
        seed,
        scans,
        traffic_seed=traffic_seed,
        lateral_offset_m=lateral_m,
        reverse=reverse,
        stops=stops,
        sensor=None if sensor is None else SimulatedSensor.of(sensor_named(sensor)),
    )
    with progress_bar() as progress:
        write_kitti_drive(drive, folder, progress)
    say(f"{folder}: {count_of(scans, 'scan')} of {drive.name}")
