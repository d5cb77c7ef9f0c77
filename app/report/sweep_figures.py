"""The parameter sweep (paper, fig. 4): accuracy, relative error and storage by r1, r2 and k."""

from collections.abc import Callable, Sequence

from matplotlib.ticker import FixedLocator, NullLocator, ScalarFormatter

from app.report.drawing import ERROR, MARKERS, MUTED, SERIES, Drawing
from app.report.figure import Figure, Panel, Table, percent, shown
from core.evaluation.study import EncodingStudy
from core.evaluation.sweep import Sweep, SweepPoint

_PAPER_RANKS = (5, 10, 15, 25)  # what fig. 4 holds fixed
_AXES = ("r1", "r2")
_Quantity = Callable[[SweepPoint], float]


def accuracy_figure(study: EncodingStudy) -> Figure:
    """Segment accuracy against one rank, the other fixed, for each k (fig. 4, a-h)."""
    swept = study.sweep
    panels = [
        _against(
            swept, varied, fixed, lambda p: 100 * p.segment_accuracy, "scans on their segment, %",
            f"{study.parameters.encoding}-accuracy-{_AXES[varied]}-{fixed}", at_most=100.0,
        )
        for varied in (0, 1)
        for fixed in _fixed_ranks(swept, 1 - varied)
    ]  # fmt: skip
    return Figure(
        key=f"{study.parameters.encoding}-sweep",
        title="Segment accuracy for every {r1, r2, k}",
        caption=(
            f"Share of the {swept.judged} judged scans that were put on their segment, as driven."
            " Each panel holds one rank fixed and varies the other; each line is a segment length"
            " k in scans. Few long segments are easier to tell apart than many short ones, so"
            " this does not compare how well places are found; the figure before does."
        ),
        panels=tuple(panels),
        tables=(_sweep_table(swept),),
    )


def size_figure(study: EncodingStudy) -> Figure:
    """Relative error and storage against each rank, the other as in the map that is shown."""
    swept, ranks = study.sweep, study.parameters.ranks
    panels = []
    for varied in (0, 1):
        fixed = _nearest(_tried(swept, 1 - varied), ranks[1 - varied])
        key = f"{study.parameters.encoding}-{_AXES[varied]}"
        panels.append(
            _against(
                swept, varied, fixed, lambda p: 100 * p.relative_error, "relative error, %",
                f"{key}-error",
            )
        )  # fmt: skip
        panels.append(
            _against(
                swept, varied, fixed, lambda p: p.bytes_per_scan, "map bytes per scan",
                f"{key}-bytes",
            )
        )  # fmt: skip
    shared = (
        ""
        if study.parameters.distance is None
        else " This encoding shares one basis over the map, so k changes neither."
    )
    return Figure(
        key=f"{study.parameters.encoding}-size",
        title="Relative error and storage for every {r1, r2, k}",
        caption=(
            "Relative error is |X - X^| / |X| over all mapped images. Storage is the map's numbers"
            f" at 4 bytes, divided by its {swept.map_scans} scans.{shared} The numbers are in the"
            " table of the figure before."
        ),
        panels=tuple(panels),
    )


def trade_off_figure(study: EncodingStudy) -> Figure:
    """Accuracy against storage: what the advisor decides on."""
    swept, advice = study.sweep, study.advice
    key = f"{study.parameters.encoding}-trade-off"
    with Drawing.on(key, height_in=3.4) as drawing:
        axes = drawing.axes
        lengths = _lengths(swept)
        # A harmonic map's basis is shared: k moves no point, and one series says it all.
        series = {f"k = {k}": [k] for k in lengths}
        if study.parameters.distance is not None:
            series = {"any k": lengths[-1:]}
        for i, (label, of_length) in enumerate(series.items()):
            points = [p for p in swept.points if p.segment_length in of_length]
            axes.plot(
                [p.bytes_per_scan for p in points],
                [100 * p.mean_accuracy for p in points],
                linestyle="none",
                marker=MARKERS[i % len(MARKERS)],
                color=SERIES[i % len(SERIES)],
                alpha=0.55,
                label=label,
            )
        if advice.best is not None and advice.standard_error is not None:
            axes.axhline(
                100 * (advice.best.mean_accuracy - advice.standard_error),
                color=MUTED, linestyle="--", linewidth=1.0, label="1 std. error below best",
            )  # fmt: skip
        if advice.max_bytes_per_scan is not None:
            axes.axvline(advice.max_bytes_per_scan, color=MUTED, linewidth=1.0, label="budget")
        if advice.recommended is not None:
            axes.plot(
                [advice.recommended.bytes_per_scan], [100 * advice.recommended.mean_accuracy],
                linestyle="none", marker="*", markersize=14, markerfacecolor="none",
                markeredgecolor=ERROR, markeredgewidth=1.6, label="recommended",
            )  # fmt: skip
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.set_xlabel("map bytes per scan (log)")
        axes.set_ylabel("right answers, %")
        drawing.legend(columns=3)
    alt = (
        f"{len(swept.points)} candidates between"
        f" {min(p.bytes_per_scan for p in swept.points):.0f} and"
        f" {max(p.bytes_per_scan for p in swept.points):.0f} bytes per scan,"
        f" {percent(min(p.mean_accuracy for p in swept.points))} to"
        f" {percent(max(p.mean_accuracy for p in swept.points))} right."
    )
    return Figure(
        key=key,
        title="Right answers against storage",
        caption=(
            f"Every candidate. An answer is right if {swept.criterion}; it is the mean over scans"
            " asked as driven and 1 m to the left of that. The star is the recommendation: the"
            " smallest candidate above the dashed line that larger ranks confirm."
        ),
        panels=(Panel("Accuracy and storage", alt, drawing.svg),),
    )


def _against(
    swept: Sweep,
    varied: int,
    fixed: int,
    quantity: _Quantity,
    label: str,
    key: str,
    at_most: float | None = None,
) -> Panel:
    """Draw a quantity; one that is never more than `at_most`, on one scale in all panels."""
    name, other = _AXES[varied], _AXES[1 - varied]
    with Drawing.on(key) as drawing:
        axes = drawing.axes
        told = []
        for i, length in enumerate(_lengths(swept)):
            points = [
                p
                for p in swept.points
                if p.segment_length == length and p.ranks[1 - varied] == fixed
            ]
            values = [quantity(p) for p in points]
            axes.plot(
                [p.ranks[varied] for p in points], values, label=f"k = {length}",
                marker=MARKERS[i % len(MARKERS)], color=SERIES[i % len(SERIES)],
            )  # fmt: skip
            told.append(f"{values[0]:.0f} to {values[-1]:.0f} (k = {length})")
        tried = _tried(swept, varied)
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(FixedLocator(tried))
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.xaxis.set_minor_locator(NullLocator())
        if at_most is not None:
            low = min(map(quantity, swept.points))
            margin = 0.04 * (at_most - low) or 1.0
            axes.set_ylim(low - margin, at_most + margin)
        axes.set_xlabel(f"{name} (log)")
        axes.set_ylabel(label)
        drawing.legend()
    alt = f"From {name} = {tried[0]} to {tried[-1]}: {', '.join(told)}."
    return Panel(f"{label[0].upper()}{label[1:]}, {other} = {fixed}", alt, drawing.svg)


def _lengths(swept: Sweep) -> list[int]:
    return sorted({p.segment_length for p in swept.points})


def _tried(swept: Sweep, axis: int) -> list[int]:
    return sorted({p.ranks[axis] for p in swept.points})


def _nearest(values: Sequence[int], wanted: int) -> int:
    return min(values, key=lambda value: abs(value - wanted))


def _fixed_ranks(swept: Sweep, axis: int) -> list[int]:
    """Return the tried ranks nearest to those that the paper holds fixed, rising."""
    tried = _tried(swept, axis)
    return sorted({_nearest(tried, rank) for rank in _PAPER_RANKS})


def _sweep_table(swept: Sweep) -> Table:
    named = [_asked(condition) for condition in swept.conditions]
    return Table(
        "Every candidate",
        (
            "r1", "r2", "k", "segments", "bytes per scan", "relative error", "on segment",
            *(f"right, {name}" for name in named),
        ),
        tuple(
            shown(
                (
                    *p.ranks, p.segment_length, p.segments, round(p.bytes_per_scan),
                    p.relative_error, percent(p.segment_accuracy), *map(percent, p.accuracy),
                )
            )
            for p in swept.points
        ),
    )  # fmt: skip


def _asked(condition: dict[str, float]) -> str:
    said = [
        f"{value:g} m left" for name, value in condition.items() if name == "lateral_m" and value
    ]
    return ", ".join(said) or "as driven"
