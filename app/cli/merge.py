"""`tensormap merge`: several map files into one, exactly; or one without some of its drives."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from app.builds.parameters import Align
from app.cli.console import progress_bar, say, say_note
from app.cli.options import AlignOption, ForceOption
from app.cli.output_files import require_new_file, written_new
from core.errors import InvalidParameters, UnknownDrive
from core.frames.agreement import check_frames, require_one_frame
from core.frames.alignment import aligned_map
from core.mapping.merge import merge_maps, without_drives
from core.mapping.tensormap import TensorMap
from core.text import count_of
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
    align: AlignOption = Align.CHECK,
    computed: Annotated[
        list[str] | None,
        typer.Option(
            metavar="DRIVE",
            help="The poses of this drive were computed from its scans, which a map file of an"
            " earlier release does not name: it is aligned whatever --align says; repeatable.",
        ),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Merge maps of one encoding and basis, drive after drive, without changing their signatures.

    Poses change only where drives are aligned.
    """
    require_new_file(output_file, force)
    maps = [read_map(path) for path in map_files]
    left_out = set(without or ())
    frameless = set(computed or ())
    names = {name for part in maps for name in part.trajectory.drives}
    unknown = (left_out | frameless) - names
    if unknown:
        raise UnknownDrive(f"none of the maps has a drive {min(unknown)!r}")
    for name in sorted(names - left_out):
        _require_in_one(name, map_files, maps)
    # Maps without a remaining drive are left out; if that is true of all, the last one raises.
    kept = [part for part in maps if set(part.trajectory.drives) - left_out] or maps[-1:]
    merged = merge_maps(
        [without_drives(part, left_out & set(part.trajectory.drives)) for part in kept]
    )
    merged = replace(merged, computed_poses=(*merged.computed_poses, *(frameless - left_out)))
    frameless.update(merged.computed_poses)
    if (frameless or align != Align.OFF) and len(kept) > 1:
        notes: tuple[str, ...] = ()
        with progress_bar() as progress:
            movable = names - left_out if align == Align.AUTO else frameless
            if movable:
                merged, notes = aligned_map(merged, progress, movable=movable, frameless=frameless)
            if align == Align.CHECK:
                notes += require_one_frame(check_frames(merged, progress, frameless=frameless))
        for note in notes:
            say_note(note)
    with written_new(output_file, force) as part:
        write_map(part, merged)
    say(
        f"{output_file}: {', '.join(merged.trajectory.drives)}: {count_of(len(merged), 'scan')},"
        f" {count_of(merged.model.segments, 'segment')},"
        f" basis {merged.basis_digest[:16]}, revision {merged.revision}"
    )


def _require_in_one(name: str, files: Sequence[Path], maps: Sequence[TensorMap]) -> None:
    """Reject a drive of several files with what leaves it out of one: `--without` is of all.

    Raises:
        InvalidParameters: If it is in several.
    """
    having = [at for at, one in enumerate(maps) if name in one.trajectory.drives]
    if len(having) < 2:
        return
    first, second = (files[at] for at in having[:2])
    advice = f"first write one without it: tensormap merge {second} --without {name} -o OTHER.h5"
    if len(maps[having[1]].trajectory.drives) == 1:
        advice = f"leave {second} out, which has no other drive"
    raise InvalidParameters(f"drive {name!r} is in {first} and in {second}: {advice}")
