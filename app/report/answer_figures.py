"""Answers of one map (paper, fig. 5 and 6): segments, scans, errors, noise and displacement."""

import itertools
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator, MultipleLocator
from scipy.stats import binomtest

from app.report.drawing import ACCENT, ERROR, GOOD, INK, MARKERS, MUTED, SERIES, Drawing
from app.report.figure import Figure, Panel, Table, percent, shown
from app.report.log_scale import make_logarithmic
from core.arrays import BoolArray, FloatArray, IntArray
from core.evaluation.study import Answers, CurvePoint, EncodingStudy, Study
from core.text import count_of

_MOST_NUMBERED = 12  # segments, beyond which the matrix' cells are too small for numbers


def answers_figure(study: Study, encoding: EncodingStudy) -> Figure:
    """Scans held out, their segments and closest scans, and motion (fig. 5 a, b, d, e)."""
    answers = encoding.answers
    wrong = answers.wrong_segment
    panels = [_segments_panel(encoding), _scans_panel(encoding)]
    known = bool(np.isfinite(study.surrogate).any())
    if known:
        panels.append(_motion_panel(study, encoding))
    if np.isfinite(answers.distance_m).any():
        panels.append(_distance_panel(study, encoding))
    moving = int((wrong & ~answers.standing).sum())
    again = int((wrong & answers.other_pass).sum())
    elsewhere = f", {again} are of another pass through the same place" if again else ""
    without = "" if known else " The drive has no poses: there is no motion surrogate."
    columns = (
        answers.scan, answers.segment, answers.matched_segment, answers.matched_scan,
        answers.distance_m, answers.right, answers.standing, study.surrogate[answers.scan],
    )  # fmt: skip
    headings = (
        "scan", "segment", "found on", "closest scan", "metres apart", "right", "standing",
        "motion surrogate",
    )  # fmt: skip
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return Figure(
        key=f"{encoding.name}-answers",
        title="Scans held out, their segments and closest scans",
        caption=(
            f"{len(answers.scan)} scans were queried as driven; {int(wrong.sum())} matched on"
            f" a wrong segment, {moving} of them while the vehicle moved{elsewhere};"
            f" {int((~answers.right).sum())} answers are not right ({study.criterion}). The motion"
            " surrogate is the paper's: the norm of the change in 6-DOF pose since the scan before,"
            f" metres and radians together.{without}"
        ),
        panels=tuple(panels),
        tables=(Table("Every query", headings, tuple(map(shown, rows))),),
    )


def _segments_panel(encoding: EncodingStudy) -> Panel:
    scan, segment, found = (
        encoding.answers.scan,
        encoding.answers.segment,
        encoding.answers.matched_segment,
    )
    wrong = encoding.answers.wrong_segment
    key = f"{encoding.name}-segments"
    with Drawing.on("Segments", key, "scan", "segment") as drawing:
        axes = drawing.axes
        axes.step(scan, segment, where="mid", color=MUTED, label="true segment")
        axes.plot(scan[~wrong], found[~wrong], ".", color=ACCENT, label="found, right")
        axes.plot(scan[wrong], found[wrong], "x", color=ERROR, label="found, wrong")
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        drawing.alt = f"{int(wrong.sum())} of {len(wrong)} scans are off their segment's step."
    return drawing.panel


def _scans_panel(encoding: EncodingStudy) -> Panel:
    answers, right = encoding.answers, encoding.answers.right
    labels = ("query scan", "closest scan of the map")
    with Drawing.on("Closest scans", f"{encoding.name}-scans", *labels) as drawing:
        _mark_right(drawing.axes, answers, answers.matched_scan)
        again = int(answers.other_pass.sum())
        drawing.alt = (
            f"{int(right.sum())} of {len(right)} answers are right; {again} of them were recorded"
            " on another pass."
        )
    return drawing.panel


def _motion_panel(study: Study, encoding: EncodingStudy) -> Panel:
    wrong, standing = encoding.answers.wrong_segment, study.standing
    labels = ("scan", "change in pose a scan (m, rad)")
    with Drawing.on("Motion and errors", f"{encoding.name}-motion", *labels) as drawing:
        axes = drawing.axes
        axes.plot(study.surrogate, color=ACCENT, linewidth=1.0, label="motion surrogate")
        _shade(axes, standing)
        scan = encoding.answers.scan[wrong]
        axes.plot(scan, study.surrogate[scan], "x", color=ERROR, label="wrong segment")
        axes.set_ylim(bottom=0.0)
        drawing.alt = (
            f"Median {np.nanmedian(study.surrogate):.2f} a scan; the vehicle is stationary in"
            f" {int(standing.sum())} of {len(standing)} scans;"
            f" {int((wrong & encoding.answers.standing).sum())} of {int(wrong.sum())} errors are"
            " there."
        )
    return drawing.panel


def _distance_panel(study: Study, encoding: EncodingStudy) -> Panel:
    distance_m = encoding.answers.distance_m
    labels = ("scan", "m from query to closest (log)")
    with Drawing.on("How far off", f"{encoding.name}-distance", *labels) as drawing:
        axes = drawing.axes
        # Drawn from 1 cm: a stationary vehicle's closest scan was recorded at the same place.
        _mark_right(axes, encoding.answers, np.maximum(distance_m, 0.01))
        make_logarithmic(axes.yaxis)
        _shade(axes, study.standing)
        drawing.alt = (
            f"Median {np.nanmedian(distance_m):.2f} m, at most {np.nanmax(distance_m):.1f} m."
        )
    return drawing.panel


def _mark_right(axes: Axes, answers: Answers, y: IntArray | FloatArray) -> None:
    x, right = answers.scan, answers.right
    axes.plot(x[right], y[right], ".", color=ACCENT, label="right")
    axes.plot(x[~right], y[~right], "x", color=ERROR, label="not right")


def _shade(axes: Axes, standing: BoolArray) -> None:
    """Mark where the vehicle is stationary."""
    edges = np.flatnonzero(np.diff(standing.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
    for i, (start, end) in enumerate(edges):
        axes.axvspan(
            start - 0.5, end - 0.5, color=GOOD, alpha=0.18, linewidth=0,
            label="standing" if i == 0 else None,
        )  # fmt: skip


def relative_error_figure(encoding: EncodingStudy) -> Figure:
    """Relative error of each segment (fig. 5 c, f)."""
    errors = 100 * encoding.relative_error
    labels = ("segment", "relative error, %")
    with Drawing.on(
        "Relative error", f"{encoding.name}-errors", *labels, legend_columns=0
    ) as drawing:
        axes = drawing.axes
        axes.bar(np.arange(len(errors)), errors, color=ACCENT, alpha=0.75)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_ylim(bottom=0.0)
        axes.grid(axis="x", visible=False)
        drawing.alt = (
            f"From {errors.min():.1f} % to {errors.max():.1f} % over"
            f" {count_of(len(errors), 'segment')}."
        )
    spans = itertools.pairwise(encoding.segment_start.tolist())
    rows = (
        (i, start, end - 1, f"{error:.1f} %")
        for i, ((start, end), error) in enumerate(zip(spans, errors, strict=True))
    )
    return Figure(
        key=f"{encoding.name}-relative-error",
        title="Relative error of each segment",
        caption=(
            "|X - X^| / |X|: the part of a segment's images that the map leaves out. A large error"
            " is no fault by itself; places can differ in the part that is kept."
        ),
        panels=(drawing.panel,),
        tables=(
            Table(
                "Segments",
                ("segment", "first scan", "last scan", "relative error"),
                tuple(map(shown, rows)),
            ),
        ),
    )


def confusion_figure(encoding: EncodingStudy) -> Figure:
    """Confusion matrix of segments (fig. 5 g)."""
    segments = encoding.segments
    counts = encoding.answers.confusion(segments)
    total = np.maximum(counts.sum(axis=1, keepdims=True), 1)
    with Drawing.on(
        "Confusion",
        f"{encoding.name}-confusion",
        "segment that was found",
        "true segment",
        height_in=4.2,
        legend_columns=0,
        xlim=(-0.5, segments - 0.5),
        ylim=(segments - 0.5, -0.5),
        aspect="equal",
    ) as drawing:
        axes = drawing.axes
        for i, j in np.argwhere(counts):
            colour = to_rgba(ACCENT if i == j else ERROR, 0.15 + 0.45 * counts[i, j] / total[i, 0])
            cell = Rectangle((j - 0.5, i - 0.5), 1.0, 1.0, facecolor=colour, edgecolor="none")
            axes.add_patch(cell)
            if segments <= _MOST_NUMBERED:
                axes.text(j, i, str(counts[i, j]), ha="center", va="center", color=INK)
        axes.grid(visible=False)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        drawing.alt = f"{int(np.trace(counts))} of {counts.sum()} on the diagonal."
    return Figure(
        key=f"{encoding.name}-confusion",
        title="Confusion of segments",
        caption=(
            "How many of the scans held out of each segment (row) were found on which (column),"
            " stationary scans included. Stronger colour is a larger share of the row."
        ),
        panels=(drawing.panel,),
        tables=(_confusion_table(encoding),),
    )


def _confusion_table(encoding: EncodingStudy) -> Table:
    """Return the matrix, or of one that is too large for numbers only what is not 0."""
    title = "Where scans of each segment were found"
    if encoding.segments > _MOST_NUMBERED:
        headings: tuple[str, ...] = ("true segment", "found on", "scans")
        return Table(title, headings, tuple(map(shown, encoding.answers.confused())))
    headings = ("true segment", *(f"found on {j}" for j in range(encoding.segments)))
    counts = encoding.answers.confusion(encoding.segments)
    return Table(title, headings, tuple(shown((i, *row)) for i, row in enumerate(counts.tolist())))


def curves_figure(study: Study) -> Figure:
    """Accuracy against noise, translation and relative yaw, of all encodings (fig. 6)."""
    panels, tables = [], []
    for quantity, title, label, unit in (
        ("noise_m", "Gaussian noise", "sigma of noise on every coordinate, m", "m"),
        ("lateral_m", "Translation", "metres to the left (negative: right)", "m"),
        ("yaw_deg", "Relative yaw", "relative yaw, deg", "deg"),
    ):
        lines = [(encoding.name, encoding.curve(quantity)) for encoding in study.encodings]
        lines = [(name, points) for name, points in lines if len(points) > 1]
        if not lines:
            continue
        panels.append(_curves_panel(lines, quantity, title, label))
        rows = (
            (
                name,
                getattr(point.condition, quantity),
                point.counted,
                percent(point.right / max(point.counted, 1)),
                percent(point.on_segment / max(point.counted, 1)),
            )
            for name, points in lines
            for point in points
        )
        headings = ("encoding", unit, "counted", "right", "on their segment")
        tables.append(Table(title, headings, tuple(map(shown, rows))))
    maps = "; ".join(
        f"{encoding.name}: {encoding.parameters.ranks[0]} x {encoding.parameters.ranks[1]},"
        f" k = {encoding.segment_length}"
        for encoding in study.encodings
    )
    return Figure(
        key="disturbances",
        title="Accuracy against noise, translation and relative yaw",
        caption=(
            f"The maps that are shown below ({maps}), queried with disturbed scans. Right: "
            f"{study.criterion}. The bands are 95 % intervals (Wilson), as if queries were"
            " independent: consecutive scans are alike, so that the true bands are wider. As in the"
            " paper a translation moves the recorded returns; a vehicle that is truly beside the"
            " line also sees what was hidden: evaluate a second drive for that. Relative yaw is not"
            " in it."
        ),
        panels=tuple(panels),
        tables=tuple(tables),
    )


def _curves_panel(
    lines: Sequence[tuple[str, Sequence[CurvePoint]]], quantity: str, title: str, label: str
) -> Panel:
    key = f"curve-{quantity.replace('_', '-')}"
    with Drawing.on(title, key, label, "right answers, %") as drawing:
        axes = drawing.axes
        summaries = []
        for i, (name, points) in enumerate(lines):
            x = [float(getattr(p.condition, quantity)) for p in points]
            shares = [100 * p.right / max(p.counted, 1) for p in points]
            low, high = zip(*(_wilson(p.right, p.counted) for p in points), strict=True)
            axes.fill_between(x, low, high, color=SERIES[i], alpha=0.15, linewidth=0)
            axes.plot(x, shares, color=SERIES[i], marker=MARKERS[i], label=name)
            summaries.append(
                f"{name} {shares[x.index(min(x, key=abs))]:.0f} % undisturbed,"
                f" {min(shares):.0f} % at worst"
            )
        if quantity == "yaw_deg":
            axes.xaxis.set_major_locator(MultipleLocator(45))
        axes.set_ylim(-3.0, 103.0)
        drawing.alt = f"{'; '.join(summaries)}."
    return drawing.panel


def _wilson(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share, in percent."""
    if count == 0:
        return 0.0, 100.0
    low, high = binomtest(hits, count).proportion_ci(method="wilson")
    return 100 * float(low), 100 * float(high)
