"""`tensormap upload`: a recorded drive into a running service."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import ValidationError

from app.builds.parameters import BuildParameters
from app.cli.console import say, transfer_progress
from app.cli.options import FormatOption
from app.upload_client.build import build_map
from app.upload_client.drive_requests import DriveRequests
from app.upload_client.errors import Rejected, UploadFailed
from app.upload_client.sources import open_source
from app.upload_client.transport import Transport
from app.upload_client.upload import Uploaded, upload_drive

_MOST_SHOWN = 10
_HINTS = {
    "map-not-found": "; --create creates it",
    "key-needed": "; --key-file names the file with one",
    "key-refused": "; is it the right --key-file?",
}


def _parameters(text: str) -> dict[str, Any]:
    """Read the parameters of a build from JSON.

    Raises:
        typer.BadParameter: If they are none.
    """
    try:
        return BuildParameters.model_validate_json(text).model_dump(mode="json", exclude_unset=True)
    except ValidationError as error:
        first = error.errors()[0]
        where = "/".join(map(str, first["loc"]))
        raise typer.BadParameter(f"{where or 'it'}: {first['msg']}") from None


def upload(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SOURCE",
            help="A drive: a folder in any layout, a Velodyne .pcap, or a ROS bag.",
        ),
    ],
    url: Annotated[
        str, typer.Argument(metavar="URL", help="Of the service, as http://127.0.0.1:8000.")
    ],
    map_slug: Annotated[str, typer.Option("--map", help="Its map.")],
    drive_slug: Annotated[str, typer.Option("--drive", help="The drive's name in the map.")],
    key_file: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A file with the key to send.")
    ] = None,
    format_name: FormatOption = None,
    create: Annotated[bool, typer.Option("--create", help="Create the map if it is new.")] = False,
    build: Annotated[
        bool, typer.Option("--build", help="Then build the map, and wait for the end.")
    ] = False,
    parameters: Annotated[
        dict[str, Any] | None,
        typer.Option(
            parser=_parameters,
            metavar="JSON",
            help='Of the build, as in the API: \'{"segments": 5, "make_live": true}\'.',
        ),
    ] = None,
) -> None:
    """Upload a recorded drive to a service, continue an interrupted upload, and build the map."""
    if parameters is not None and not build:
        raise typer.BadParameter("--parameters are those of --build, which is missing")
    key = None if key_file is None else key_file.read_text(encoding="utf-8").strip()
    opened = open_source(source, format_name)
    with Transport(url, key) as transport:
        requests = DriveRequests(transport, map_slug, drive_slug)
        try:
            if create and requests.create_map():
                say(f"map {map_slug} is new")
            with transfer_progress() as progress:
                done = upload_drive(requests, opened, progress)
            _show_upload(drive_slug, done, requests.drive())
            if build:
                with transfer_progress() as progress:
                    job = build_map(requests, parameters or {}, progress)
                _show_build(job, requests.revision(job["revision"]))
        except Rejected as error:
            raise UploadFailed(f"{error}{_HINTS.get(error.problem, '')}") from error


def _show_upload(drive: str, done: Uploaded, shown: Mapping[str, Any]) -> None:
    say(
        f"{drive}: {done.stored} of {done.scans} scans stored ({done.sent_bytes / 1e6:.1f} MB),"
        f" {done.before} were there before, {done.skipped_scans} skipped;"
        f" {shown['scans_with_pose']} of {shown['scans']} have a pose"
    )
    for one in done.skipped[:_MOST_SHOWN]:
        say(f"  skipped scan {one.index}: {one.reason}")
    if done.skipped_scans > _MOST_SHOWN:
        say(f"  and {done.skipped_scans - _MOST_SHOWN} more")


def _show_build(job: Mapping[str, Any], revision: Mapping[str, Any] | None) -> None:
    line = f"revision {job['revision']}"
    if revision is not None:
        live = "live" if revision["live"] else "not live"
        line += f": {revision['scans']} scans in {revision['segments']} segments, {live}"
    say(line)
    gate = job["gate"]
    if gate is not None and gate["recall"] is not None:
        say(
            f"self-recall {gate['recall']:.3f} on {gate['asked']} scans that it shares with the"
            f" revision that was live, whose is {gate['recall_of_live']:.3f}"
        )
    for note in job["notes"]:
        say(f"  note: {note}")
