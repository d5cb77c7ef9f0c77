"""`tensormap build` and `inspect`: maps as files, without a service."""

import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError
from rich.table import Table

from app.builds.parameters import Align, BuildParameters
from app.cli import options
from app.cli.console import progress_bar, say, say_note, show
from app.cli.output_files import require_new_file, written_new
from app.revisions.topology_schemas import TopologyOut
from core.encodings.basis import Basis
from core.encodings.registry import encoding_with
from core.errors import InvalidParameters
from core.mapping.pipeline import Build
from core.parameters import Segmentation
from core.scans.mounting import stated_height_m, vehicle_drive
from core.scans.sensor import HDL_64E
from core.text import count_of
from storage.files.map_file import read_map, write_map
from storage.formats.drives.layouts import open_drive

_FACTS = ("revision", "basis", "encoding", "sensor", "reducer", "ranks", "drives")


def build(
    drives: options.DrivesArgument,
    output_file: Annotated[
        Path, typer.Option("-o", "--output", metavar="MAP.h5", help="The map file to write.")
    ],
    encoding: options.EncodingOption = None,
    ranks_text: options.RanksOption = None,
    segmentation: options.SegmentationOption = Segmentation.FIXED,
    views: options.ViewsOption = None,
    verification_images: options.VerificationOption = None,
    segment_length: options.SegmentLengthOption = None,
    segments: options.SegmentsOption = None,
    reducer: options.ReducerOption = None,
    image: options.ImageOption = None,
    distance: options.DistanceOption = None,
    lateral_renderings: options.LateralRenderingsOption = None,
    sensor: options.SensorOption = HDL_64E.name,
    sensor_height_m: options.SensorHeightOption = None,
    mounting: options.MountingOption = None,
    accumulate: options.AccumulateOption = 1,
    keep_basis: Annotated[
        Path | None,
        typer.Option(
            metavar="MAP.h5",
            help="Keep this harmonic map's basis: signatures made with it stay good, and the two"
            " can be merged.",
            rich_help_panel="Map",
        ),
    ] = None,
    align: options.AlignOption = Align.CHECK,
    odometry: options.OdometryOption = True,
    force: options.ForceOption = False,
) -> None:
    """Build a map of one or more recorded drives."""
    # Here: `inspect` does not need them.
    from app.builds.digested_drive import DigestedDrive
    from app.builds.drive_build import build_drives
    from app.builds.drive_notes import drive_notes
    from app.builds.mounting_notes import mounting_notes
    from app.builds.odometry import pose_recorded
    from app.builds.pose_checks import check_recorded
    from core.odometry.posed_drive import PosedDrive

    require_new_file(output_file, force)
    try:
        parameters = BuildParameters(
            encoding=encoding or encoding_with(reducer),
            ranks=options.ranks(ranks_text),
            segmentation=segmentation,
            views=views,
            verification_images=verification_images,
            segment_length=segment_length,
            segments=segments,
            reducer=reducer,
            sensor=sensor,
            sensor_height_m=options.given_height_m(sensor_height_m, mounting),
            align=align,
            odometry=odometry,
            image=image,
            distance=distance,
            lateral_renderings_m=(
                None if lateral_renderings is None else list(options.numbers(lateral_renderings))
            ),
        )
    except ValidationError as error:
        raise options.invalid(error) from None
    kept = None if keep_basis is None else _basis_of(keep_basis, parameters)
    height_m = parameters.map_parameters().sensor_height_m
    stated_m = stated_height_m(mounting, height_m)  # of the drives as their sensors recorded them
    recorded = [open_drive(drive, min_returns=options.MIN_RETURNS) for drive in drives]
    twice = {drive.name for drive in recorded if [d.name for d in recorded].count(drive.name) > 1}
    if twice:
        raise InvalidParameters(f"two of the drives are called {min(twice)!r}: rename a folder")
    notes: list[str] = []
    with progress_bar() as progress:
        for drive in recorded:
            notes += check_recorded(drive, stated_m, align, progress)
        notes += mounting_notes([(drive, mounting) for drive in recorded], height_m)
        if odometry:
            posed = [pose_recorded(drive, stated_m, progress) for drive in recorded]
            recorded = [drive for drive, _ in posed]
            notes += [note for _, of_drive in posed for note in of_drive]
        read = [DigestedDrive(drive) for drive in recorded]
        mapped = [vehicle_drive(drive, mounting, height_m, accumulate) for drive in read]
        frameless = [drive.name for drive in recorded if isinstance(drive, PosedDrive)]
        built = build_drives(mapped, parameters, progress, kept=kept, frameless=frameless)
    notes += drive_notes(built.tensor_map, [drive.read for drive in read])
    with written_new(output_file, force) as part:
        write_map(part, built.tensor_map)
    _show_built(output_file, built, (*parameters.assumptions, *notes, *built.notes))


def _show_built(output_file: Path, built: Build, notes: Sequence[str]) -> None:
    """Print what was left out, what to know about the drives, and the map's size."""
    tensor_map, compression = built.tensor_map, built.compression
    for name, scans in built.skipped.items():
        of_drive = f" of {name}" if len(built.skipped) > 1 else ""
        for skipped in scans:
            say_note(f"left out scan {skipped.scan}{of_drive}: {skipped.reason}")
    for note in notes:
        say_note(note)
    verification = options.of_verification(compression.verification_bytes)
    say(
        f"{output_file}: {count_of(len(tensor_map), 'scan')},"
        f" {count_of(tensor_map.model.segments, 'segment')},"
        f" {options.ratios(compression)} in numbers, {output_file.stat().st_size} bytes"
        f"{verification}, revision {tensor_map.revision}"
    )


def _basis_of(map_file: Path, parameters: BuildParameters) -> Basis:
    """Return the basis of a map whose signatures are made as these parameters say."""
    kept = read_map(map_file)
    if not kept.parameters.encoder.shares_basis:
        raise InvalidParameters(
            f"{map_file} has bases of its own for each segment, it has no basis to keep"
        )
    basis = kept.basis()
    if not basis.serves(parameters.map_parameters()):
        raise InvalidParameters(
            f"{map_file} makes signatures otherwise: {kept.parameters.as_attributes()}"
        )
    return basis


def inspect(
    map_file: options.MapArgument,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Show the contents of a map; its digest is checked."""
    tensor_map = read_map(map_file)
    facts = {
        "revision": tensor_map.revision,
        "basis": tensor_map.basis_digest,
        **tensor_map.attributes(),
        "scans": len(tensor_map),
        "segments": tensor_map.model.segments,
        "segmentation": tensor_map.parameters.segmentation.value,
        "views": tensor_map.parameters.views.value,
        "elements": tensor_map.elements,
        "size_bytes": map_file.stat().st_size,
        "verification_bytes": tensor_map.verification_bytes,
        "arrays": {
            name: {"shape": list(array.shape), "dtype": str(array.dtype)}
            for name, array in tensor_map.arrays().items()
        },
        "nodes": len(tensor_map.topology.node_scan),
        "edges": [edge.model_dump() for edge in TopologyOut.from_core(tensor_map).edges],
    }
    if as_json:
        sys.stdout.write(f"{json.dumps(facts, indent=2)}\n")
        return
    for name in (*_FACTS, "views", "scans", "segmentation"):
        say(f"{name:>12}  {facts[name]}")
    for drive, placement in tensor_map.placements.items():
        where = "; it lies beside the other drives" * (drive in tensor_map.drives_aside)
        say(f"{'placed':>12}  {drive}: {placement}{where}")
    size = f"{facts['size_bytes']} bytes{options.of_verification(tensor_map.verification_bytes)}"
    say(f"{'size':>12}  {size}")
    nodes, edges = facts["nodes"], facts["edges"]
    say(f"{'graph':>12}  {count_of(nodes, 'node')}, {count_of(len(edges), 'edge')}")
    # Both lengths are from node to node: a segment's last node is the next one's first scan.
    table = Table("edge", "nodes", "segment", "scan steps", "length m", "relative error")
    for edge in edges:
        first, last = edge["nodes"]
        for segment in edge["segments"]:
            ends = (last, first) if segment["reversed"] else (first, last)
            length_m = tensor_map.trajectory.path_m(*tensor_map.segment_ends[segment["segment"]])
            table.add_row(
                str(edge["edge"]),
                f"{ends[0]} - {ends[1]}",
                str(segment["segment"]),
                str(segment["scans"]),
                "-" if math.isnan(length_m) else f"{length_m:.1f}",
                f"{segment['relative_error']:.3f}",
            )
    show(table)
