"""Where segments end on the driven line (paper, fig. 1, 4 i-m and 5 h)."""

import numpy as np

from app.report.drawing import ACCENT, ERROR, GOOD, Drawing
from app.report.figure import Figure, Panel, Table, shown
from core.arrays import FloatArray, IntArray
from core.evaluation.study import Study
from core.scans.pose import is_known
from core.segmentation.fixed import cut_fixed


def nodes_figure(study: Study) -> Figure:
    """Nodes on the trajectory, for every k that was tried and every map that is shown."""
    known = is_known(study.poses)
    lengths = sorted(
        {p.segment_length for of in study.encodings for p in of.sweep.points}
        | {of.segment_length for of in study.encodings}
    )
    if known.sum() < 2:
        return Figure(
            "nodes",
            "Nodes on the trajectory",
            "The drive has no poses: there is no map to draw. Segments are cut by scans alone.",
            (),
        )
    origin_m = study.poses[known][0, :3]
    position_m = study.poses[:, :3] - origin_m
    shown_by = {
        length: [
            str(of.parameters.encoding) for of in study.encodings if of.segment_length == length
        ]
        for length in lengths
    }
    panels, rows = [], []
    for length in lengths:
        nodes = _nodes(study.scans, length)
        used = f", shown for {' and '.join(shown_by[length])}" if shown_by[length] else ""
        panels.append(_panel(position_m, nodes, f"k = {length}{used}", f"nodes-{length}"))
        rows += [
            shown((length, number, scan, *position_m[scan].tolist()))
            for number, scan in enumerate(nodes.tolist())
        ]
    return Figure(
        key="nodes",
        title="Nodes on the trajectory",
        caption=(
            "The driven line seen from above, in metres from its first scan, and the nodes where"
            " segments of k scans end. Nodes are not evenly spaced where the vehicle's speed is"
            " not even."
        ),
        panels=tuple(panels),
        tables=(Table("Nodes", ("k", "node", "scan", "x m", "y m", "z m"), tuple(rows)),),
    )


def _nodes(scans: int, segment_length: int) -> IntArray:
    starts = cut_fixed(scans, segment_length)
    return np.append(starts[:-1], scans - 1)


def _panel(position_m: FloatArray, nodes: IntArray, title: str, key: str) -> Panel:
    with Drawing.on(key, height_in=3.6) as drawing:
        axes = drawing.axes
        axes.plot(position_m[:, 0], position_m[:, 1], color=ACCENT, linewidth=1.4)
        inner = nodes[1:-1]
        axes.plot(
            position_m[inner, 0], position_m[inner, 1], linestyle="none", marker="o",
            color=ERROR, label="node",
        )  # fmt: skip
        for scan, marker, label in ((nodes[0], "o", "start"), (nodes[-1], "s", "end")):
            axes.plot(
                position_m[scan, 0], position_m[scan, 1], linestyle="none", marker=marker,
                markersize=7, markerfacecolor="none", markeredgecolor=GOOD, markeredgewidth=1.8,
                label=label,
            )  # fmt: skip
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("x, m")
        axes.set_ylabel("y, m")
        drawing.legend()
    extent_m = np.nanmax(position_m[:, :2], axis=0) - np.nanmin(position_m[:, :2], axis=0)
    alt = f"{len(nodes)} nodes on a line that spans {extent_m[0]:.0f} m by {extent_m[1]:.0f} m."
    return Panel(title, alt, drawing.svg)
