"""`tensormap merge`: several map files into one, exactly; or one without some of its drives."""

from pathlib import Path
from typing import Annotated

import typer

from app.builds.parameters import PoseCheck
from app.cli.console import progress_bar, say
from app.cli.options import PosesOption, require_folder
from core.errors import UnknownDrive
from core.frames.agreement import check_frames, require_one_frame
from core.mapping.merge import merge_maps, without_drives
from storage.files.files import publish
from storage.files.map_file import read_map, write_map


def merge(
    map_files: Annotated[list[Path], typer.Argument(help="Map files.", metavar="MAP.h5...")],
    output_file: Annotated[
        Path, typer.Option("-o", "--output", metavar="MAP.h5", help="The map file to write.")
    ],
    without: Annotated[
        list[str] | None,
        typer.Option("--without", metavar="DRIVE", help="Leave this drive out; repeatable."),
    ] = None,
    poses: PosesOption = PoseCheck.CHECKED,
) -> None:
    """Merge maps of one encoding and basis, drive after drive, without changing their numbers."""
    require_folder(output_file)
    maps = [read_map(path) for path in map_files]
    left_out = set(without or ())
    unknown = left_out.difference(*(part.trajectory.drives for part in maps))
    if unknown:
        raise UnknownDrive(f"none of the maps has a drive {min(unknown)!r}")
    # Maps without a remaining drive are left out; if that is true of all, the last one raises.
    kept = [part for part in maps if set(part.trajectory.drives) - left_out] or maps[-1:]
    merged = merge_maps(
        [without_drives(part, left_out & set(part.trajectory.drives)) for part in kept]
    )
    if poses == PoseCheck.CHECKED and len(kept) > 1:
        with progress_bar() as progress:
            checks = check_frames(merged, progress)
        require_one_frame(checks)
        for check in checks:
            if check.note is not None:
                say(check.note)
    with publish(output_file) as part:
        write_map(part, merged)
    say(
        f"{output_file}: {', '.join(merged.trajectory.drives)}: {len(merged)} scans,"
        f" {merged.model.segments} segments, basis {merged.basis_digest[:16]},"
        f" revision {merged.revision}"
    )
