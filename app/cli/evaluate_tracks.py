"""What `tensormap evaluate --track` shows."""

from rich.box import SIMPLE_HEAD
from rich.table import Table

from app.cli.console import output
from core.evaluation.result import Evaluation
from core.evaluation.tracks import TrackResult

__all__ = ["show_tracks"]


def show_tracks(result: Evaluation) -> None:
    """Show the figures of tracks, if there are any."""
    if not result.tracks:
        return
    tolerances = list(result.tracks[0].recall_at_1)
    table = Table(box=SIMPLE_HEAD, padding=0, title="tracked", title_justify="left")
    for heading in (
        "yaw deg",
        "left m",
        "noise m",
        "seen",
        "told",
        "first",
        "segments",
        "errors",
        "moving",
        *(f"R@1 {metres:g} m" for metres in tolerances),
        "error m",
        "flicker",
        "recovery",
        "ms",
    ):
        table.add_column(heading, justify="right")
    for row in result.tracks:
        table.add_row(
            f"{row.condition.yaw_deg:g}",
            f"{row.condition.lateral_m:g}",
            f"{row.condition.noise_m:g}",
            str(row.observations),
            str(row.localized),
            "-" if row.first_fix is None else str(row.first_fix),
            str(row.segments_told),
            str(len(row.errors)),
            "-" if row.errors_moving is None else str(row.errors_moving),
            *(_figure(row.recall_at_1[metres], ".3f") for metres in tolerances),
            _figure(row.position_error_m_median, ".2f"),
            "-" if row.flicker is None else str(row.flicker),
            _recovery(row),
            _figure(row.ms_per_observation, ".1f"),
        )
    output().print(table)


def _recovery(row: TrackResult) -> str:
    """Return the longest, and how many kidnappings were not recovered from."""
    if not row.recovery:
        return "-"
    lost = sum(scans is None for scans in row.recovery)
    longest = max((scans for scans in row.recovery if scans is not None), default=None)
    return f"{'-' if longest is None else longest}" + (f", {lost} lost" if lost else "")


def _figure(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
