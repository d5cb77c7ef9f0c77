"""`tensormap where`: in which of several maps, and where in it, scans were recorded."""

from functools import cache
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from app.cli import options
from app.cli.console import figure, show
from app.cli.queries import (
    ScanHeightOption,
    ScansArgument,
    answers_to,
    queries_of,
    report_unusable,
    require_one_height,
    say_notes,
    write_answer,
)
from app.localization.all_maps_answer import AllMapsAnswer
from app.localization.all_maps_schemas import AllMapsAnswerOut
from app.localization.axis_notes import axis_notes
from core.errors import InvalidParameters
from core.localization.all_maps import AllMapsLocalization, SearchedMap, localize_in_maps
from core.localization.localizer import Localizer
from core.projection.imager import Image, Imager
from core.scans.scan import Scan
from core.scans.tilt import Tilt
from storage.files.map_file import read_map
from storage.formats.scans.registry import media_type_of


def where(
    scans: ScansArgument,
    maps: Annotated[
        list[Path],
        typer.Option("--map", metavar="MAP.h5", help="Map to search; repeatable."),
    ],
    k: Annotated[int, typer.Option("-k", min=1, help="Number of nearest scans to return.")] = 1,
    sensor_height_m: ScanHeightOption = None,
    mounting: options.MountingOption = None,
    roll_deg: options.RollOption = None,
    pitch_deg: options.PitchOption = None,
    accumulate: options.AccumulateOption = 1,
    min_probability: Annotated[
        float | None,
        typer.Option(min=0, max=1, help="Lowest probability to accept. [the best map's threshold]"),
    ] = None,
    format_name: options.FormatOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON answer a line.")] = False,
) -> None:
    """Localize scans among several maps; the answer names the map.

    The tilt applies to all scans. In JSON `query` is the scan that an answer is of.
    """
    names = [path.stem for path in maps]
    if twice := {name for name in names if names.count(name) > 1}:
        raise InvalidParameters(f"two of the maps are called {min(twice)!r}: rename a file")
    require_one_height(mounting, sensor_height_m)
    tilt = Tilt.of(roll_deg, pitch_deg)
    media_type = media_type_of(format_name)
    localizers = {name: Localizer(read_map(path)) for name, path in zip(names, maps, strict=True)}
    of_maps_m = {one.map.parameters.sensor_height_m for one in localizers.values()}
    # Only a mounted scan depends on the height that its map assumes.
    heights_m = {0.0} if mounting is None else of_maps_m
    ground_below_m = of_maps_m if mounting is None else {max(of_maps_m)}
    if sensor_height_m is not None:
        ground_below_m = {sensor_height_m}
    queries = {
        height_m: list(queries_of(scans, media_type, mounting, height_m, accumulate))
        for height_m in heights_m
    }
    numbers = [(name, number) for number, (name, _) in enumerate(next(iter(queries.values())))]

    def localized(number: int) -> AllMapsAnswer:
        @cache
        def scan_for(height_m: float) -> Scan:
            scan = queries[height_m][number][1]()
            return scan if tilt is None else tilt.level(scan)

        @cache
        def image_by(imager: Imager) -> Image:
            scan = scan_for(0.0 if mounting is None else imager.sensor_height_m)
            return imager.image(scan, sensor_height_m)

        searched = []
        for slug, localizer in localizers.items():
            image = image_by(localizer.map.parameters.imager)
            search = localizer.search_image(image)
            searched.append(SearchedMap(slug, localizer.map, search, image.occupied_cells))
        found = localize_in_maps(searched, k, min_probability=min_probability)
        notes: list[str] = []
        if not found.decision.localized:
            scan = scan_for(max(heights_m))
            notes = axis_notes(scan, *ground_below_m, mounted=mounting is not None)
        return AllMapsAnswer(found, len(maps), (), tuple(notes))

    def written_at_once(name: str, answer: AllMapsAnswer) -> None:
        write_answer(name, AllMapsAnswerOut.from_core(answer))

    answers, unusable = answers_to(numbers, localized, written_at_once if as_json else None)
    if answers:
        _show([(name, answer.found) for name, answer in answers])
        say_notes([answer.notes for _, answer in answers])
    report_unusable(unusable)


def _show(answers: list[tuple[str, AllMapsLocalization]]) -> None:
    table = Table("scan", "map", "map scan", "x m", "y m", "distance", "ratio", "probable")
    for name, found in answers:
        for rank, one in enumerate(found.matches):
            match = one.match
            place = match.estimated_pose or match.pose
            table.add_row(
                name,
                one.name,
                f"{match.drive} {match.scan_index}",
                "-" if place is None else f"{place.x_m:.2f}",
                "-" if place is None else f"{place.y_m:.2f}",
                f"{match.distance:.4f}",
                "" if rank else figure(found.ratio, ".2f"),  # of the best match
                "" if rank else _probable(found),
            )
    show(table, names=("scan", "map", "map scan"))


def _probable(found: AllMapsLocalization) -> str:
    refused = "" if found.decision.localized else f" no: {found.decision.reason}"
    return figure(found.decision.probability, ".2f") + refused
