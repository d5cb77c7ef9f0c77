"""What one map answered (paper, fig. 5 and 6): segments, scans, errors, noise and displacement."""

import itertools
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator, MultipleLocator

from app.report.drawing import ACCENT, ERROR, GOOD, INK, MARKERS, MUTED, SERIES, Drawing
from app.report.figure import Figure, Panel, Table, percent, shown
from core.arrays import BoolArray, FloatArray, IntArray
from core.evaluation.study import Answers, CurvePoint, EncodingStudy, Study

_MOST_NUMBERED = 12  # segments, beyond which the matrix' cells are too small for numbers


def answers_figure(study: Study, of: EncodingStudy) -> Figure:
    """Scans held out against segments and closest scans, with the motion surrogate (a, b, d, e)."""
    name, answers = str(of.parameters.encoding), of.answers
    wrong = answers.wrong_segment
    panels = [_segments_panel(of, f"{name}-segments"), _scans_panel(of, f"{name}-scans")]
    known = bool(np.isfinite(study.surrogate).any())
    if known:
        panels.append(_motion_panel(study, of, f"{name}-motion"))
    if np.isfinite(answers.distance_m).any():
        panels.append(_distance_panel(study, of, f"{name}-distance"))
    moving = int((wrong & ~answers.standing).sum())
    without = "" if known else " The drive has no poses: there is no motion surrogate."
    return Figure(
        key=f"{name}-answers",
        title="Scans held out, their segments and closest scans",
        caption=(
            f"{len(answers.scan)} scans were asked as driven; {int(wrong.sum())} were put on a"
            f" wrong segment, {moving} of them while the vehicle moved;"
            f" {int((~answers.right).sum())} answers are not right ({study.criterion}). The motion"
            " surrogate is the paper's: the norm of the change in 6-DOF pose since the scan before,"
            f" metres and radians together.{without}"
        ),
        panels=tuple(panels),
        tables=(
            Table(
                "Every scan that was asked",
                ("scan", "segment", "found on", "closest scan", "metres apart", "right",
                 "standing", "motion surrogate"),
                tuple(
                    shown(row)
                    for row in zip(
                        answers.scan.tolist(), answers.segment.tolist(),
                        answers.matched_segment.tolist(), answers.matched_scan.tolist(),
                        answers.distance_m.tolist(), answers.right.tolist(),
                        answers.standing.tolist(), study.surrogate[answers.scan].tolist(),
                        strict=True,
                    )
                ),
            ),
        ),
    )  # fmt: skip


def _segments_panel(of: EncodingStudy, key: str) -> Panel:
    answers, wrong = of.answers, of.answers.wrong_segment
    with Drawing.on(key) as drawing:
        axes = drawing.axes
        axes.step(answers.scan, answers.segment, where="mid", color=MUTED, label="where it belongs")
        _mark(axes, answers.scan, answers.matched_segment, ~wrong, ".", ACCENT, "found there")
        _mark(axes, answers.scan, answers.matched_segment, wrong, "x", ERROR, "found elsewhere")
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("scan")
        axes.set_ylabel("segment")
        drawing.legend()
    alt = f"{int(wrong.sum())} of {len(wrong)} scans lie off their segment's step."
    return Panel("(a) Segments", alt, drawing.svg)


def _scans_panel(of: EncodingStudy, key: str) -> Panel:
    answers, right = of.answers, of.answers.right
    with Drawing.on(key) as drawing:
        axes = drawing.axes
        _mark_right(axes, answers, answers.matched_scan)
        axes.set_xlabel("scan that was asked")
        axes.set_ylabel("closest scan of the map")
        drawing.legend()
    alt = f"{int(right.sum())} of {len(right)} answers lie on the diagonal."
    return Panel("(d) Closest scans", alt, drawing.svg)


def _motion_panel(study: Study, of: EncodingStudy, key: str) -> Panel:
    answers, wrong = of.answers, of.answers.wrong_segment
    standing = study.standing
    with Drawing.on(key) as drawing:
        axes = drawing.axes
        axes.plot(study.surrogate, color=ACCENT, linewidth=1.0, label="motion surrogate")
        _shade(drawing, standing)
        surrogate = study.surrogate[answers.scan]
        _mark(axes, answers.scan, surrogate, wrong, "x", ERROR, "wrong segment")
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("scan")
        axes.set_ylabel("change in pose a scan (m, rad)")
        drawing.legend()
    alt = (
        f"Median {np.nanmedian(study.surrogate):.2f} a scan; the vehicle stands in"
        f" {int(standing.sum())} of {len(standing)} scans;"
        f" {int((wrong & answers.standing).sum())} of {int(wrong.sum())} errors fall there."
    )
    return Panel("(b) Motion and errors", alt, drawing.svg)


def _distance_panel(study: Study, of: EncodingStudy, key: str) -> Panel:
    answers = of.answers
    known = answers.distance_m[np.isfinite(answers.distance_m)]
    with Drawing.on(key) as drawing:
        axes = drawing.axes
        # Drawn from 1 cm: a standing vehicle's closest scan was recorded where it stands.
        _mark_right(axes, answers, np.maximum(answers.distance_m, 0.01))
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        _shade(drawing, study.standing)
        axes.set_xlabel("scan")
        axes.set_ylabel("m from asked to closest (log)")
        drawing.legend()
    alt = f"Median {np.median(known):.2f} m, at most {known.max():.1f} m."
    return Panel("(e) How far off", alt, drawing.svg)


def _mark(
    axes: Axes,
    x: IntArray,
    y: IntArray | FloatArray,
    rows: BoolArray,
    marker: str,
    colour: str,
    label: str,
) -> None:
    axes.plot(x[rows], y[rows], linestyle="none", marker=marker, color=colour, label=label)


def _mark_right(axes: Axes, answers: Answers, y: IntArray | FloatArray) -> None:
    _mark(axes, answers.scan, y, answers.right, ".", ACCENT, "right")
    _mark(axes, answers.scan, y, ~answers.right, "x", ERROR, "not right")


def _shade(drawing: Drawing, standing: BoolArray) -> None:
    """Mark where the vehicle stands."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], standing.astype(np.int8), [0]])))
    for i, (start, end) in enumerate(zip(edges[::2], edges[1::2], strict=True)):
        drawing.axes.axvspan(
            start - 0.5, end - 0.5, color=GOOD, alpha=0.18, linewidth=0,
            label="standing" if i == 0 else None,
        )  # fmt: skip


def relative_error_figure(of: EncodingStudy) -> Figure:
    """Relative error of each segment (c, f)."""
    name, errors = str(of.parameters.encoding), 100 * of.relative_error
    with Drawing.on(f"{name}-errors") as drawing:
        axes = drawing.axes
        axes.bar(np.arange(len(errors)), errors, color=ACCENT, alpha=0.75)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_ylim(bottom=0.0)
        axes.grid(axis="x", visible=False)
        axes.set_xlabel("segment")
        axes.set_ylabel("relative error, %")
    alt = f"From {errors.min():.1f} % to {errors.max():.1f} % over {len(errors)} segments."
    starts = of.segment_start.tolist()
    return Figure(
        key=f"{name}-relative-error",
        title="Relative error of each segment",
        caption=(
            "|X - X^| / |X|: how much of a segment's images the map does not keep. A large error"
            " is no fault by itself; places can be told apart by what is kept."
        ),
        panels=(Panel("(c, f) Relative error", alt, drawing.svg),),
        tables=(
            Table(
                "Segments",
                ("segment", "first scan", "last scan", "relative error"),
                tuple(
                    shown((i, start, end - 1, f"{error:.1f} %"))
                    for i, ((start, end), error) in enumerate(
                        zip(itertools.pairwise(starts), errors.tolist(), strict=True)
                    )
                ),
            ),
        ),
    )


def confusion_figure(of: EncodingStudy) -> Figure:
    """Confusion matrix of segments (g)."""
    name, segments = str(of.parameters.encoding), of.segments
    counts = of.answers.confusion(segments)
    total = np.maximum(counts.sum(axis=1, keepdims=True), 1)
    with Drawing.on(f"{name}-confusion", height_in=4.2) as drawing:
        axes = drawing.axes
        for (i, j), count in np.ndenumerate(counts):
            if not count:
                continue
            share = float(count / total[i, 0])
            colour = to_rgba(ACCENT if i == j else ERROR, 0.15 + 0.45 * share)
            axes.add_patch(_cell(j, i, colour))
            if segments <= _MOST_NUMBERED:
                axes.text(j, i, str(count), ha="center", va="center", color=INK)
        axes.grid(visible=False)
        axes.set_xlim(-0.5, segments - 0.5)
        axes.set_ylim(segments - 0.5, -0.5)
        axes.set_aspect("equal")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        axes.set_xlabel("segment that was found")
        axes.set_ylabel("segment it belongs to")
    right = int(np.trace(counts))
    return Figure(
        key=f"{name}-confusion",
        title="Confusion of segments",
        caption=(
            "How many of the scans held out of each segment (row) were found on which (column),"
            " standing scans too. Stronger colour is a larger share of the row."
        ),
        panels=(
            Panel("(g) Confusion", f"{right} of {counts.sum()} on the diagonal.", drawing.svg),
        ),
        tables=(
            Table(
                "Where scans of each segment were found",
                ("belongs to", *(f"found on {j}" for j in range(segments))),
                tuple(shown((i, *row)) for i, row in enumerate(counts.tolist())),
            ),
        ),
    )


def _cell(column: int, row: int, colour: tuple[float, float, float, float]) -> Rectangle:
    return Rectangle((column - 0.5, row - 0.5), 1.0, 1.0, facecolor=colour, edgecolor="none")


def curves_figure(study: Study) -> Figure:
    """Accuracy against noise, translation and turns, of all encodings (fig. 6)."""
    panels, tables = [], []
    for quantity, title, label, unit in (
        ("noise_m", "Gaussian noise", "sigma of noise on every coordinate, m", "m"),
        ("lateral_m", "Translation", "metres to the left (negative: right)", "m"),
        ("yaw_deg", "Turn", "degrees turned", "deg"),
    ):
        lines = [(of, of.curve(quantity)) for of in study.encodings]
        lines = [(of, points) for of, points in lines if len(points) > 1]
        if not lines:
            continue
        panels.append(_curves_panel(lines, quantity, title, label))
        tables.append(
            Table(
                title,
                ("encoding", unit, "judged", "right", "on their segment"),
                tuple(
                    shown(
                        (
                            str(of.parameters.encoding),
                            getattr(p.condition, quantity),
                            p.judged,
                            percent(p.right / max(p.judged, 1)),
                            percent(p.on_segment / max(p.judged, 1)),
                        )
                    )
                    for of, points in lines
                    for p in points
                ),
            )
        )
    maps = "; ".join(
        f"{of.parameters.encoding}: {of.parameters.ranks[0]} x {of.parameters.ranks[1]},"
        f" k = {of.segment_length}"
        for of in study.encodings
    )
    return Figure(
        key="disturbances",
        title="Accuracy against noise, translation and turns",
        caption=(
            f"The maps that are shown below ({maps}), asked with disturbed scans. Right: "
            f"{study.criterion}. The bands are 95 % intervals (Wilson). As in the paper a"
            " translation moves the recorded returns; a vehicle that is truly beside the line also"
            " sees what was hidden, so a second drive tells more. Turns are not in the paper."
        ),
        panels=tuple(panels),
        tables=tuple(tables),
    )


def _curves_panel(
    lines: Sequence[tuple[EncodingStudy, Sequence[CurvePoint]]],
    quantity: str,
    title: str,
    label: str,
) -> Panel:
    told = []
    with Drawing.on(f"curve-{quantity.replace('_', '-')}") as drawing:
        axes = drawing.axes
        for i, (of, points) in enumerate(lines):
            x = [float(getattr(p.condition, quantity)) for p in points]
            shares = [100 * p.right / max(p.judged, 1) for p in points]
            low, high = zip(*(_wilson(p.right, p.judged) for p in points), strict=True)
            axes.fill_between(x, low, high, color=SERIES[i], alpha=0.15, linewidth=0)
            axes.plot(
                x, shares, color=SERIES[i], marker=MARKERS[i], label=str(of.parameters.encoding)
            )
            told.append(
                f"{of.parameters.encoding} {shares[x.index(min(x, key=abs))]:.0f} % undisturbed,"
                f" {min(shares):.0f} % at worst"
            )
        if quantity == "yaw_deg":
            axes.xaxis.set_major_locator(MultipleLocator(45))
        axes.set_ylim(-3.0, 103.0)
        axes.set_xlabel(label)
        axes.set_ylabel("right answers, %")
        drawing.legend()
    return Panel(title, f"{'; '.join(told)}.", drawing.svg)


def _wilson(hits: int, asked: int) -> tuple[float, float]:
    """Return the 95 % interval of a share, in percent."""
    if asked == 0:
        return 0.0, 100.0
    z2 = 1.96**2
    share = hits / asked
    centre = (share + z2 / (2 * asked)) / (1 + z2 / asked)
    half = np.sqrt(z2 * (share * (1 - share) + z2 / (4 * asked)) / asked) / (1 + z2 / asked)
    return 100 * (centre - half), 100 * (centre + half)
