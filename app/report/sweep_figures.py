"""The parameter sweep (paper, fig. 4): accuracy, relative error and storage by r1, r2 and k."""

from collections.abc import Callable, Sequence

from matplotlib.ticker import FixedLocator, NullLocator, ScalarFormatter

from app.report.drawing import ERROR, MUTED, Drawing, look_of
from app.report.figure import Figure, Panel, Table, percent, shown
from app.report.log_scale import make_logarithmic
from core.evaluation.study import EncodingStudy
from core.evaluation.sweep import Sweep, SweepPoint

_PAPER_RANKS = (5, 10, 15, 25)  # fixed in fig. 4
_AXES = ("r1", "r2")


def accuracy_figure(study: EncodingStudy) -> Figure:
    """Segment accuracy against one rank, the other fixed, for each k (fig. 4, a-h)."""
    swept = study.sweep
    panels = [
        _against(
            swept, varied, fixed, lambda p: 100 * p.segment_accuracy, "scans on their segment, %",
            f"{study.name}-accuracy-{_AXES[varied]}-{fixed}", at_most=100.0,
        )
        for varied in (0, 1)
        for fixed in sorted({_nearest(_tried(swept, 1 - varied), rank) for rank in _PAPER_RANKS})
    ]  # fmt: skip
    return Figure(
        key=f"{study.name}-sweep",
        title="Segment accuracy for every {r1, r2, k}",
        caption=(
            f"Share of the {swept.counted} counted queries matched on their segment, as driven."
            " Each panel fixes one rank and varies the other; each line is a segment length"
            " k in scans. Few long segments are easier to distinguish than many short ones, so"
            " this does not compare how well places are found; the figure before does."
        ),
        panels=tuple(panels),
        tables=(_sweep_table(swept),),
    )


def size_figure(study: EncodingStudy) -> Figure:
    """Relative error and storage against each rank, the other as in the map that is shown."""
    swept = study.sweep
    if not swept.sizes_differ:
        return _one_size(study)
    quantities: tuple[tuple[str, str, Callable[[SweepPoint], float]], ...] = (
        ("error", "relative error, %", lambda p: 100 * p.relative_error),
        ("bytes", "map bytes per scan", lambda p: p.bytes_per_scan),
    )
    panels = [
        _against(
            swept, varied, _nearest(_tried(swept, 1 - varied), study.parameters.ranks[1 - varied]),
            quantity, label, f"{study.name}-{_AXES[varied]}-{key}",
        )
        for varied in (0, 1)
        for key, label, quantity in quantities
    ]  # fmt: skip
    shared = ""
    if study.parameters.encoder.shares_basis:
        shared = " This encoding shares one basis over the map, so k changes neither."
    return Figure(
        key=f"{study.name}-size",
        title="Relative error and storage for every {r1, r2, k}",
        caption=(
            "Relative error is |X - X^| / |X| over all mapped images. Storage is the bytes of the"
            " map's bases, signatures and verification images, divided by its"
            f" {swept.map_scans} scans.{shared} The numbers are in the"
            " table of the figure before."
        ),
        panels=tuple(panels),
    )


def _one_size(study: EncodingStudy) -> Figure:
    """Say what {r1, r2, k} cost where each map is as large: what a vehicle sends."""
    swept = study.sweep
    first, sent = swept.points[0], [p.sent_bytes for p in swept.points]
    return Figure(
        key=f"{study.name}-size",
        title="Relative error and storage for every {r1, r2, k}",
        caption=(
            f"All maps that were tried have {first.bytes_per_scan:.0f} bytes per scan and a"
            f" relative error of {percent(first.relative_error)}: they keep the largest signatures,"
            " with which shorter ones are compared. r1 and r2 are what a vehicle sends,"
            f" {min(sent)} to {max(sent)} bytes a query."
        ),
        panels=(),
    )


def trade_off_figure(study: EncodingStudy) -> Figure:
    """Accuracy against storage, on which the advisor decides."""
    swept, advice = study.sweep, study.advice
    lengths = _lengths(swept)
    # With a shared basis k moves no point: one series has them all.
    series = {f"k = {k}": k for k in lengths}
    if study.parameters.encoder.shares_basis:
        series = {"any k": lengths[-1]}
    key = f"{study.name}-trade-off"
    by_size = swept.sizes_differ
    what = "storage" if by_size else "bytes sent"

    def cost(point: SweepPoint) -> float:
        return point.bytes_per_scan if by_size else point.sent_bytes

    unit = "map bytes per scan" if by_size else "bytes sent a query"
    labels = (f"{unit} (log)", "right answers, %")
    with Drawing.on(
        f"Accuracy and {what}", key, *labels, height_in=3.4, legend_columns=3
    ) as drawing:
        axes = drawing.axes
        for i, (label, length) in enumerate(series.items()):
            points = [p for p in swept.points if p.segment_length == length]
            marker, colour = look_of(i)
            axes.plot(
                [cost(p) for p in points], [100 * p.mean_accuracy for p in points],
                marker, color=colour, alpha=0.55, label=label,
            )  # fmt: skip
        if advice.best is not None and advice.standard_error is not None:
            axes.axhline(
                100 * (advice.best.mean_accuracy - advice.standard_error),
                color=MUTED, linestyle="--", linewidth=1.0, label="1 std. error below best",
            )  # fmt: skip
        if advice.max_bytes_per_scan is not None and by_size:
            axes.axvline(advice.max_bytes_per_scan, color=MUTED, linewidth=1.0, label="budget")
        if advice.recommended is not None:
            axes.plot(
                cost(advice.recommended), 100 * advice.recommended.mean_accuracy, "*",
                markersize=14, markerfacecolor="none", markeredgecolor=ERROR, markeredgewidth=1.6,
                label="recommended",
            )  # fmt: skip
        make_logarithmic(axes.xaxis)
        sizes = [cost(p) for p in swept.points]
        shares = [p.mean_accuracy for p in swept.points]
        drawing.alt = (
            f"{len(sizes)} candidates between {min(sizes):.0f} and {max(sizes):.0f} {unit},"
            f" {percent(min(shares))} to {percent(max(shares))} right."
        )
    least = "is the smallest" if by_size else "sends the least"
    star = ""
    if advice.recommended is not None:
        star = " The star is the recommendation: " + (
            f"of the candidates above the dashed line that larger ranks confirm, it {least}."
            if advice.confirmed
            else "the most accurate candidate, which no larger rank confirms."
        )
    return Figure(
        key=key,
        title=f"Right answers against {what}",
        caption=(
            f"Every candidate. An answer is right if {swept.criterion}; the share is the mean over"
            f" queries as driven and 1 m to the left of that.{star}"
        ),
        panels=(drawing.panel,),
    )


def _against(
    swept: Sweep,
    varied: int,
    fixed: int,
    quantity: Callable[[SweepPoint], float],
    label: str,
    key: str,
    at_most: float | None = None,
) -> Panel:
    """Draw a quantity; one that is never more than `at_most`, on one scale in all panels."""
    name, tried = _AXES[varied], _tried(swept, varied)
    title = f"{label[0].upper()}{label[1:]}, {_AXES[1 - varied]} = {fixed}"
    with Drawing.on(title, key, f"{name} (log)", label) as drawing:
        axes = drawing.axes
        ranges = []
        for i, length in enumerate(_lengths(swept)):
            points = [
                p
                for p in swept.points
                if p.segment_length == length and p.ranks[1 - varied] == fixed
            ]
            values = [quantity(p) for p in points]
            marker, colour = look_of(i)
            axes.plot(
                [p.ranks[varied] for p in points], values, label=f"k = {length}",
                marker=marker, color=colour,
            )  # fmt: skip
            ranges.append(f"{values[0]:.0f} to {values[-1]:.0f} (k = {length})")
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(FixedLocator(tried))
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.xaxis.set_minor_locator(NullLocator())
        if at_most is not None:
            low = min(map(quantity, swept.points))
            margin = 0.04 * (at_most - low) or 1.0
            axes.set_ylim(low - margin, at_most + margin)
        drawing.alt = f"From {name} = {tried[0]} to {tried[-1]}: {', '.join(ranges)}."
    return drawing.panel


def _lengths(swept: Sweep) -> list[int]:
    return sorted({p.segment_length for p in swept.points})


def _tried(swept: Sweep, axis: int) -> list[int]:
    return sorted({p.ranks[axis] for p in swept.points})


def _nearest(values: Sequence[int], to: int) -> int:
    return min(values, key=lambda value: abs(value - to))


def _sweep_table(swept: Sweep) -> Table:
    named = [
        f"{condition['lateral_m']:g} m left" if condition["lateral_m"] else "as driven"
        for condition in swept.conditions
    ]
    rows = (
        (
            *p.ranks, p.segment_length, p.segments, round(p.bytes_per_scan), p.sent_bytes,
            p.relative_error, percent(p.segment_accuracy), *map(percent, p.accuracy),
        )
        for p in swept.points
    )  # fmt: skip
    headings = (
        "r1", "r2", "k", "segments", "bytes per scan", "bytes sent",
        "relative error", "on segment",
        *(f"right, {name}" for name in named),
    )  # fmt: skip
    return Table("Every candidate", headings, tuple(map(shown, rows)))
