"""`tensormap demo`: a demonstration of the whole service."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from app.cli.console import figure, progress_bar, say, show
from app.cli.errors import CommandFailed
from app.cli.options import MIN_RETURNS, ratios
from app.demo.outcome import MAX_SCANS, RECALL_M, Fixes, Outcome
from core.encodings.registry import DEFAULT_ENCODING, encoding_named, encoding_names
from core.scans.drive import Drive
from core.simulation import SimulatedDrive
from core.text import count_of
from storage.formats.drives.layouts import open_drive

if TYPE_CHECKING:
    from app.demo.server import RunningServer

_BAR = 0.9  # of recall@1 within 3 m
_MAP = "demo"


def demo(
    drive: Annotated[
        Path | None,
        typer.Option(metavar="DRIVE", help="Recorded drive to use; without it, a simulated city."),
    ] = None,
    once: Annotated[
        bool, typer.Option("--once", help="Stop the service and exit; non-zero below recall 0.9.")
    ] = False,
    port: Annotated[int, typer.Option(min=1, max=65535, help="First port to try.")] = 8000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the simulated city.")] = 0,
    encoding: Annotated[
        str, typer.Option(metavar="|".join(encoding_names()), help="Encoding of the map.")
    ] = DEFAULT_ENCODING,
) -> None:
    """Record a drive, post it, build the map, localize held-out scans, and print a table."""
    from tensormap_client import ClientError, Mapper  # here, as few commands need a client
    from tensormap_client.problems import StorageFull

    from app.demo.client import DemoClient
    from app.demo.run import hold_out, run_demo
    from app.demo.server import running_server

    encoding_named(encoding)  # an unknown one is refused before anything is started
    recorded: Drive
    if drive is None:
        recorded = SimulatedDrive(seed=seed, scans=MAX_SCANS)
    else:
        recorded = open_drive(drive, min_returns=MIN_RETURNS)
    held_out = hold_out(recorded)
    with TemporaryDirectory(prefix="tensormap-demo-") as folder, ExitStack() as service:
        try:
            with progress_bar(of_transfer=True) as progress:
                progress.start("starting", 1)
                server = service.enter_context(running_server(Path(folder), port))
                url = server.url
                with Mapper(url, None, _MAP) as mapper, DemoClient(url, _MAP) as client:
                    outcome = run_demo(mapper, client, recorded, held_out, progress, encoding)
        except ClientError as error:
            where = f"; it is the disk of {folder}: TMPDIR names a folder on another one"
            hint = where if isinstance(error, StorageFull) else ""
            raise CommandFailed(f"{error}{hint}") from error
        _show(recorded.name, outcome)
        comment = _comment(outcome.fixes, simulated=drive is None)
        if comment:
            say(comment)
        if not once:
            say(f"\nThe service runs at {url} (documentation: {url}/docs).")
            say("Ctrl-C stops it and removes the demonstration's data.")
            _wait(server)
            return
    recalls = [fixes.recall_at_1 for fixes in outcome.fixes if fixes.recall_at_1 is not None]
    if recalls and min(recalls) < _BAR:
        say(f"recall@1 within {RECALL_M:g} m is {min(recalls):.3f}, wanted {_BAR:g}")
        raise typer.Exit(1)


def _wait(server: "RunningServer") -> None:
    """Wait for Ctrl-C; other signals end the command, and so does a service that ends."""
    try:
        server.wait()
    except KeyboardInterrupt:
        say("stopped")


def _show(name: str, outcome: Outcome) -> None:
    compression = outcome.compression
    say(
        f"\n{name}: {count_of(outcome.mapped_scans, 'scan')} mapped in"
        f" {count_of(outcome.segments, 'segment')},"
        f" {outcome.posted_bytes / 1e6:.0f} MB posted; {ratios(compression)}"
        f" ({compression.elements} elements)"
    )
    table = Table(title="Held-out scans, localized over HTTP")
    table.add_column("request", no_wrap=True)
    for heading in (
        "fixes",
        "segment accuracy",
        f"recall@1 {RECALL_M:g} m",
        "position error m",
        "bytes",
        "ms",
    ):
        table.add_column(heading, justify="right")
    for fixes in outcome.fixes:
        table.add_row(
            fixes.request,
            str(fixes.queries),
            f"{fixes.segment_accuracy:.3f}",
            figure(fixes.recall_at_1, ".3f"),
            figure(fixes.position_error_m, ".2f"),
            f"{fixes.bytes_per_fix:,.0f}",
            f"{fixes.ms_per_fix:.1f}",
        )
    show(table)
    if all(fixes.recall_at_1 is None for fixes in outcome.fixes):
        say("the drive has no poses of its own: metres cannot be checked, segments can")


def _comment(fixes: Sequence[Fixes], *, simulated: bool) -> str:
    """Return why a signature gives a better position than its scan; empty where none does.

    A signature is compared with what the map has on its line, and is at its best exactly there. A
    scan's position comes from verification images, and its error is the same beside the line.
    """
    scan, *signatures = [each.position_error_m for each in fixes]
    if not simulated or scan is None:
        return ""
    if not any(error is not None and error < scan for error in signatures):
        return ""
    said = (
        "These scans were recorded exactly on the mapped line, where signatures give their best"
        " positions; beside the line a full scan's are as good."
    )
    if fixes[0].segment_accuracy < 1.0:
        said += " Wrong segments are usually of scans at the end of one, matched just beyond."
    return said
