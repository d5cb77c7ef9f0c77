"""`tensormap localize` and `signature`: scans as queries of a map's file."""

import json
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from pydantic import BaseModel
from rich.table import Table

from app.cli import options
from app.cli.console import figure, progress_bar, say, say_note, show
from app.cli.output_files import require_apart, require_file_or_stream, written
from app.localization.axis_notes import axis_notes
from app.localization.query_schemas import PriorsIn
from app.localization.schemas import LocalizationOut
from app.localization.signature_schemas import SignaturesIn
from core.encodings.signature import Packing, pack_signatures
from core.errors import InvalidParameters, InvalidScan
from core.localization.localizer import Localization, Localizer
from core.scans.drive import Drive, scan_index_of
from core.scans.mounting import Mounting
from core.scans.scan import Scan
from core.scans.tilt import Tilt
from core.text import count_of
from storage.files.map_file import read_map
from storage.formats.drives.layouts import is_capture, is_drive
from storage.formats.drives.topics import without_topic
from storage.formats.errors import UnknownFormat
from storage.formats.scans.registry import FORMAT_NAMES, media_type_of, read_scan_file

Q = TypeVar("Q")
A = TypeVar("A")
Noted = tuple[Localization, Sequence[str]]
"""An answer, and notes on its query."""

ScansArgument = Annotated[
    list[Path],
    typer.Argument(
        help="Scan files, or drives whose scans are all localized: folders, Velodyne .pcap files,"
        " ROS bags; 'monday.bag#/points' names the topic of one with several.",
        metavar="SCAN...",
    ),
]
ScanHeightOption = Annotated[
    float | None,
    typer.Option(
        min=0.01,
        max=99.99,
        help="Height of these scans' sensor above ground, if not the map's.",
    ),
]
_prior: Any = partial(typer.Option, rich_help_panel="Priors")


def localize(
    map_file: options.MapArgument,
    scans: ScansArgument,
    k: Annotated[int, typer.Option("-k", min=1, help="Number of nearest scans to return.")] = 1,
    sensor_height_m: ScanHeightOption = None,
    mounting: options.MountingOption = None,
    roll_deg: options.RollOption = None,
    pitch_deg: options.PitchOption = None,
    accumulate: options.AccumulateOption = 1,
    min_probability: Annotated[
        float | None,
        typer.Option(min=0, max=1, help="Lowest probability to accept. [the map's threshold]"),
    ] = None,
    x_m: Annotated[
        float | None, _prior(help="Approximate x of the vehicle in the map's frame.")
    ] = None,
    y_m: Annotated[float | None, _prior(help="Approximate y; goes with --x-m.")] = None,
    position_sigma_m: Annotated[float | None, _prior(help="Standard deviation of x and y.")] = None,
    heading_deg: Annotated[
        float | None, _prior(help="Approximate heading, counter-clockwise from the map's x.")
    ] = None,
    heading_sigma_deg: Annotated[
        float | None, _prior(help="Standard deviation of the heading.")
    ] = None,
    travelled_m: Annotated[
        float | None, _prior(help="Distance driven since the last localization.")
    ] = None,
    travelled_sigma_m: Annotated[
        float | None, _prior(help="Standard deviation of --travelled-m.")
    ] = None,
    since_drive: Annotated[
        str | None, _prior(help="Drive of the last localization's scan.")
    ] = None,
    since_scan: Annotated[
        int | None, _prior(help="Index of the last localization's scan in its drive.", min=0)
    ] = None,
    since_x_m: Annotated[
        float | None, _prior(help="Last fix: x in the map's frame, in place of a scan.")
    ] = None,
    since_y_m: Annotated[
        float | None, _prior(help="Last fix: y in the map's frame; goes with --since-x-m.")
    ] = None,
    segment: Annotated[
        list[int] | None, _prior(help="Segment that the vehicle is on; repeatable.", min=0)
    ] = None,
    format_name: options.FormatOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON answer a line.")] = False,
) -> None:
    """Localize scans in a map; unusable ones are reported, the others are answered.

    The priors and the tilt apply to all scans. A scan that is not localized is no error: its answer
    has the reason. In JSON `query` is the scan that an answer is of.
    """
    priors = PriorsIn.model_construct(  # typer has checked the types
        x_m=x_m,
        y_m=y_m,
        position_sigma_m=position_sigma_m,
        heading_deg=heading_deg,
        heading_sigma_deg=heading_sigma_deg,
        travelled_m=travelled_m,
        travelled_sigma_m=travelled_sigma_m,
        since_drive=since_drive,
        since_scan=since_scan,
        since_x_m=since_x_m,
        since_y_m=since_y_m,
        segment=segment,
    ).to_core()
    require_one_height(mounting, sensor_height_m)
    tilt = Tilt.of(roll_deg, pitch_deg)
    media_type = media_type_of(format_name)
    localizer = Localizer(read_map(map_file))
    height_m = localizer.map.parameters.sensor_height_m
    queries = list(queries_of(scans, media_type, mounting, height_m, accumulate))

    def localized(read: Callable[[], Scan]) -> Noted:
        scan = read() if tilt is None else tilt.level(read())
        found = localizer.localize_scan(scan, k, sensor_height_m, priors, min_probability)
        if found.localized:
            return found, []
        return found, axis_notes(scan, sensor_height_m or height_m, mounted=mounting is not None)

    def written_at_once(name: str, noted: Noted) -> None:
        found, notes = noted
        write_answer(name, LocalizationOut.from_core(found, found.revision, notes=notes))

    answers, unusable = answers_to(queries, localized, written_at_once if as_json else None)
    if answers:
        _show_answers([(name, found) for name, (found, _) in answers])
        say_notes([notes for _, (_, notes) in answers])
    report_unusable(unusable)


def require_one_height(mounting: Mounting | None, sensor_height_m: float | None) -> None:
    """Reject a height of these scans' sensor beside that of its mounting.

    Raises:
        InvalidParameters: If both are given.
    """
    if mounting is not None and sensor_height_m is not None:
        raise InvalidParameters("--mounting has a height too: leave --sensor-height-m out")


def answers_to(
    queries: Sequence[tuple[str, Q]],
    answer: Callable[[Q], A],
    write: Callable[[str, A], None] | None = None,
    stage: str = "localizing",
) -> tuple[list[tuple[str, A]], list[str]]:
    """Return the answers to queries by their names, and why scans cannot be used.

    Args:
        queries: The queries by their names.
        answer: What answers one.
        write: Called with each answer once it is known; none are returned then.
        stage: What is done, for the progress.
    """
    answers: list[tuple[str, A]] = []
    unusable: list[str] = []
    with progress_bar(beside_output=write is not None) as progress:
        progress.start(stage, len(queries))
        for name, query in queries:
            try:
                found = answer(query)
            except (InvalidScan, UnknownFormat) as error:
                reason = str(error)
                unusable.append(reason if name in reason else f"{name}: {reason}")
            except OSError as error:
                if error.filename is None:
                    raise
                unusable.append(f"{name}: {error.strerror}")
            else:
                if write is None:
                    answers.append((name, found))
                else:
                    write(name, found)
            progress.advance()
    return answers, unusable


def say_notes(of_each: Sequence[Sequence[str]]) -> None:
    """Write the notes on queries: each once, and of how many it is.

    Args:
        of_each: The notes on each query.
    """
    for note, times in Counter(note for notes in of_each for note in notes).items():
        say_note(f"{times} of {count_of(len(of_each), 'scan')}: {note}")


def report_unusable(reasons: Sequence[str]) -> None:
    """Write why scans cannot be used, and fail if there are any."""
    for reason in reasons:
        sys.stderr.write(f"tensormap: {reason}\n")
    if reasons:
        raise typer.Exit(1)


def queries_of(
    paths: Sequence[Path],
    media_type: str | None,
    mounting: Mounting | None,
    sensor_height_m: float,
    accumulate: int,
) -> Iterator[tuple[str, Callable[[], Scan]]]:
    """Yield the name of each scan file, and of each scan of each drive, and what reads it.

    Raises:
        InvalidParameters: If a format is given for a drive, or a file is to be accumulated.
    """
    drives = [_drive_of(path, media_type, mounting, sensor_height_m, accumulate) for path in paths]
    names = [
        _named(path) if drive is None else drive.name
        for path, drive in zip(paths, drives, strict=True)
    ]
    times = Counter(names)  # as 000000.bin of two folders, or two topics of a bag
    for path, drive, own_name in zip(paths, drives, names, strict=True):
        name = own_name if times[own_name] == 1 else str(path)
        if drive is not None:
            for position, index in enumerate(scan_index_of(drive).tolist()):
                yield f"{name} {index}", partial(drive.scan, position)
            continue
        if accumulate != 1:
            raise InvalidParameters(
                f"{path} has no poses: --accumulate wants the folder of a drive"
            )
        yield name, partial(_read, path, media_type, mounting, sensor_height_m)


def _named(path: Path) -> str:
    """Return the name of a file or folder, of a bag without its topic."""
    return without_topic(path).name


def _drive_of(
    path: Path,
    media_type: str | None,
    mounting: Mounting | None,
    sensor_height_m: float,
    accumulate: int,
) -> Drive | None:
    """Open the drive that a path is; `None` of a scan file.

    A capture that cannot be read, whose format is given or that has an Ouster's metadata beside it
    is a scan file.
    """
    if is_drive(path):
        if media_type is not None:
            raise InvalidParameters(
                f"--format is of scan files, {path} is a drive: give its files instead"
            )
        return options.open_mapped(path, mounting, sensor_height_m, accumulate)
    if media_type is not None or not is_capture(path):
        return None
    try:
        return options.open_mapped(path, mounting, sensor_height_m, accumulate)
    except InvalidScan:
        return None  # and read again as a scan, it is reported, and the others are answered


def write_answer(query: str, answer: BaseModel) -> None:
    """Write a line of JSON: the name of a query, and its answer; unusable scans have no line."""
    fields = answer.model_dump_json().removeprefix("{")
    sys.stdout.write(f'{{"query":{json.dumps(query)},{fields}\n')
    sys.stdout.flush()  # also into a pipe: the next answer may take long


def _read(
    path: Path, media_type: str | None, mounting: Mounting | None, sensor_height_m: float
) -> Scan:
    try:
        scan = read_scan_file(path, min_returns=options.MIN_RETURNS, media_type=media_type)
    except UnknownFormat:
        if path.suffix.lower() == ".npz":
            raise UnknownFormat(
                f"{path.name} may hold several arrays: save one as .npy, by numpy.save"
            ) from None
        raise UnknownFormat(
            f"{path.name}: its name does not say its format; wanted --format with one of"
            f" {', '.join(FORMAT_NAMES)}"
        ) from None
    return scan if mounting is None else mounting.mount(scan, sensor_height_m)


def _show_answers(answers: list[tuple[str, Localization]]) -> None:
    turns = any(found.best.lateral_m is not None for _, found in answers)
    table = Table("scan", "segment", "along", "map scan", "x m", "y m")
    for heading in (*(("turn deg", "left m") if turns else ()), "distance", "ratio", "probable"):
        table.add_column(heading)
    for name, found in answers:
        for rank, match in enumerate(found.matches):
            place = match.pose if match.estimated_pose is None else match.estimated_pose
            table.add_row(
                name,
                str(match.segment),
                f"{match.fraction:.3f}",
                f"{match.drive} {match.scan_index}",
                "-" if place is None else f"{place.x_m:.2f}",
                "-" if place is None else f"{place.y_m:.2f}",
                *(
                    (figure(match.relative_yaw_deg, ".1f"), figure(match.lateral_m, ".1f"))
                    if turns
                    else ()
                ),
                f"{match.distance:.4f}" if turns else f"{match.distance:.1f}",
                "" if rank else figure(found.ratio, ".2f"),  # of the best match
                "" if rank else _probable(found),
            )
    show(table, names=("scan", "map scan"))
    for name, found in answers:
        if not found.localized:
            say(f"{name} is not localized: {found.decision.reason}")


def _probable(found: Localization) -> str:
    return figure(found.decision.probability, ".2f") + ("" if found.localized else " no")


def signature(
    map_file: options.MapArgument,
    scan: Annotated[Path, typer.Argument(help="A scan file.", metavar="SCAN")],
    segments: Annotated[
        list[int] | None,
        typer.Option("--segment", min=0, help="Use this segment's bases only; repeatable."),
    ] = None,
    packed: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="File to write the packed signatures to, ready to post; it is replaced.",
        ),
    ] = None,
    packing: Annotated[
        Packing | None, typer.Option(help="How numbers are packed. [float16; harmonic: int8]")
    ] = None,
    ranks_text: Annotated[
        str | None,
        typer.Option(
            "--ranks",
            help="r1,r2 to send, if not the map's; for maps of any views.",
            callback=options.checked(options.ranks),
        ),
    ] = None,
    mounting: options.MountingOption = None,
    roll_deg: options.RollOption = None,
    pitch_deg: options.PitchOption = None,
    format_name: options.FormatOption = None,
) -> None:
    """Print a scan's signatures as JSON, ready to post."""
    if packed is not None:
        require_file_or_stream(packed)
        require_apart(packed, map_file, scan)
    tensor_map = read_map(map_file)
    if segments is not None and not tensor_map.parameters.encoder.per_segment:
        raise InvalidParameters(
            f"a {tensor_map.parameters.encoding} signature is one for all segments: leave --segment"
            " out"
        )
    basis, ranks = tensor_map.basis(segments), options.ranks(ranks_text)
    tilt = Tilt.of(roll_deg, pitch_deg)
    media_type = media_type_of(format_name)
    read = _read(scan, media_type, mounting, tensor_map.parameters.sensor_height_m)
    image = basis.image(read if tilt is None else tilt.level(read))
    if image.occupied_cells < tensor_map.least_cells:
        sys.stderr.write(
            f"tensormap: too few returns: {image.occupied_cells} cells of the image are occupied,"
            f" the map wants at least {tensor_map.least_cells}: do not send this\n"
        )
    signatures = basis.encode(image, ranks)
    if packed is not None:
        with written(packed) as part:
            part.write_bytes(pack_signatures(signatures, packing))
    body = SignaturesIn.from_core(signatures)
    sys.stdout.write(f"{body.model_dump_json()}\n")
