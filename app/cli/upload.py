"""`tensormap upload`: a recorded drive into a running service."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import ValidationError
from tensormap_client import (
    CaptureFiles,
    ClientError,
    Mapper,
    NothingUsable,
    Rejected,
    Source,
    Unreachable,
    Uploaded,
)
from tensormap_client.problems import KeyNeeded, KeyRefused, ScopeMissing, StorageFull
from tensormap_client.progress import HASHING
from tensormap_client.uploaded import SkippedScan
from tensormap_client.urls import service_url, shown

from app.builds.parameters import BuildParameters
from app.cli.console import BarProgress, LineProgress, progress_bar, say
from app.cli.errors import CommandFailed
from app.cli.options import FormatOption
from app.cli.service_options import KeyFile, ServiceUrl, read_key
from app.cli.upload_sources import DriveSource, open_source
from app.http.field_problems import wanted_and_got, with_names
from core.text import count_of, verb_of
from storage.names import checked_slug

_MOST_SHOWN = 10
_INTERRUPTED = 130  # as shells have it: 128 and SIGINT
_HINTS = {
    "map-not-found": "; --create creates it",
    "key-needed": "; --key-file names the file with one",
    "key-refused": "; is it the right --key-file?",
}


def _parameters(text: str) -> dict[str, Any]:
    """Read the parameters of a build from JSON.

    Raises:
        typer.BadParameter: If the text is not a build's parameters.
    """
    try:
        return BuildParameters.model_validate_json(text).model_dump(mode="json", exclude_unset=True)
    except ValidationError as error:
        first = with_names(error.errors()[0], BuildParameters)
        where = "/".join(map(str, first["loc"]))
        raise typer.BadParameter(f"{where} {wanted_and_got(first)}".lstrip()) from None


def upload(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SOURCE",
            help="A drive: a folder in any layout, a Velodyne .pcap, or a ROS bag;"
            " 'monday.bag#/points' names the topic of one with several.",
        ),
    ],
    url: ServiceUrl,
    map_slug: Annotated[str, typer.Option("--map", help="The drive's map.")],
    drive_slug: Annotated[str, typer.Option("--drive", help="The drive's name in the map.")],
    key_file: KeyFile = None,
    format_name: FormatOption = None,
    create: Annotated[bool, typer.Option("--create", help="Create the map if it is new.")] = False,
    build: Annotated[
        bool, typer.Option("--build", help="Build the map after the upload, and wait for the end.")
    ] = False,
    parameters: Annotated[
        dict[str, Any] | None,
        typer.Option(
            parser=_parameters,
            metavar="JSON",
            help='Parameters of the build, as in the API: \'{"segments": 5, "make_live": true}\'.',
        ),
    ] = None,
) -> None:
    """Upload a recorded drive to a service, continue an interrupted upload, and build the map."""
    if parameters is not None and not build:
        raise typer.BadParameter("--parameters are those of --build, which is missing")
    key = read_key(key_file)
    try:
        opened = open_source(source, format_name)
        if create:
            checked_slug(drive_slug)  # or a mistyped name would leave a map without drives
        with Mapper(url, key, map_slug) as mapper:
            if create and mapper.create_map():
                say(f"map {map_slug} is new")
            with progress_bar(of_transfer=True) as progress, _interrupted(lambda: _rest(progress)):
                done = mapper.upload(opened, drive_slug, progress)
            _show_upload(opened, drive_slug, done, mapper.drive(drive_slug))
            if build:
                base = shown(service_url(url))
                job = mapper.start_build(parameters)
                name = f"/v1/jobs/{job['job']}"
                rest = f"build {name} continues on the service; DELETE {base}{name} cancels it"
                with progress_bar(of_transfer=True) as progress, _interrupted(lambda: rest):
                    job = mapper.finish_build(job, progress)
                _show_build(job, _revision(mapper, job["revision"]), f"{base}/v1/maps/{map_slug}")
    except NothingUsable as error:
        _show_skipped(opened, error.skipped[:_MOST_SHOWN], 0)  # the error has their number
        raise CommandFailed(str(error)) from error
    except ClientError as error:
        raise CommandFailed(f"{error}{_hint(error)}") from error


@contextmanager
def _interrupted(rest: Callable[[], str]) -> Iterator[None]:
    """Name what remains after Ctrl-C, and end as one does; also after an error that may pass.

    Args:
        rest: Returns what remains, empty if nothing was done.
    """
    try:
        yield
    except KeyboardInterrupt:
        sys.stderr.write(f"tensormap: {rest() or 'nothing was done'}\n")
        raise typer.Exit(_INTERRUPTED) from None
    except ClientError as error:
        if not _may_pass(error) or not (remains := rest()):
            raise
        raise CommandFailed(f"{error}{_hint(error)}; {remains}") from error


def _may_pass(error: ClientError) -> bool:
    """Return whether the same command may succeed after an error: later, or with other rights."""
    if isinstance(error, Rejected):
        return error.is_passing or isinstance(error, StorageFull | KeyNeeded | KeyRefused)
    return isinstance(error, Unreachable)


def _hint(error: ClientError) -> str:
    return _HINTS.get(error.problem, "") if isinstance(error, Rejected) else ""


def _rest(progress: BarProgress | LineProgress) -> str:
    position = progress.position
    if not position or position.startswith(HASHING):  # which begins anew
        return ""
    return f"{position} done; the same command continues"


def _revision(mapper: Mapper, revision: str) -> Mapping[str, Any] | None:
    """Return a revision; `None` if the key may not read it."""
    try:
        return mapper.revision(revision)
    except ScopeMissing:
        return None


def _show_upload(
    source: Source | CaptureFiles, drive: str, done: Uploaded, shown: Mapping[str, Any]
) -> None:
    posed = shown["scans_with_pose"]
    say(
        f"{drive}: {done.stored} of {done.scans} scans stored ({done.sent_bytes / 1e6:.1f} MB),"
        f" {done.before} were there before, {done.skipped_scans} skipped;"
        f" {posed} of {shown['scans']} {verb_of(posed, 'has', 'have')} a pose"
    )
    _show_skipped(source, done.skipped, done.skipped_scans)
    for note in done.notes:
        say(f"  note: {note}")


def _show_skipped(
    source: Source | CaptureFiles, skipped: Sequence[SkippedScan], scans: int
) -> None:
    for one in skipped[:_MOST_SHOWN]:
        file = f", {source.file_name(one.index)}" if isinstance(source, DriveSource) else ""
        say(f"  skipped scan {one.index}{file}: {one.reason}")
    if len(skipped) > _MOST_SHOWN:
        say(f"  and {scans - _MOST_SHOWN} more")


def _show_build(job: Mapping[str, Any], revision: Mapping[str, Any] | None, map_url: str) -> None:
    line = f"revision {job['revision']}"
    if revision is not None:
        live = "live" if revision["live"] else f"not live: PUT {map_url}/live makes it so"
        line += f": {count_of(revision['scans'], 'scan')} in"
        line += f" {count_of(revision['segments'], 'segment')}, {live}"
    say(line)
    gate = job["gate"]
    if gate is not None and gate["recall"] is not None:
        say(
            f"self-recall {gate['recall']:.3f} on {count_of(gate['asked'], 'scan')} that it"
            f" shares with the revision that was live, whose is {gate['recall_of_live']:.3f}"
        )
    for note in job["notes"]:
        say(f"  note: {note}")
