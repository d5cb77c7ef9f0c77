"""Segments' ends on the driven line (paper, fig. 1, 4 i-m and 5 h)."""

import numpy as np

from app.report.drawing import ACCENT, ERROR, GOOD, Drawing
from app.report.figure import Figure, Panel, Table, shown
from core.arrays import FloatArray, IntArray
from core.evaluation.study import Study
from core.scans.pose import is_known
from core.segmentation.fixed import cut_fixed
from core.text import count_of


def nodes_figure(study: Study) -> Figure:
    """Nodes on the trajectory, for every k that was tried and every map that is shown."""
    known = is_known(study.poses)
    lengths = sorted(
        {p.segment_length for encoding in study.encodings for p in encoding.sweep.points}
        | {encoding.segment_length for encoding in study.encodings}
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
    panels, rows = [], []
    for length in lengths:
        nodes = np.append(cut_fixed(study.scans, length)[:-1], study.scans - 1)
        users = " and ".join(
            encoding.name for encoding in study.encodings if encoding.segment_length == length
        )
        used = f", shown for {users}" if users else ""
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


def _panel(position_m: FloatArray, nodes: IntArray, title: str, key: str) -> Panel:
    x_m, y_m = position_m[:, :2].T
    with Drawing.on(title, key, "x, m", "y, m", height_in=3.6) as drawing:
        axes = drawing.axes
        axes.plot(x_m, y_m, color=ACCENT, linewidth=1.4)
        inner = nodes[1:-1]
        axes.plot(x_m[inner], y_m[inner], "o", color=ERROR, label="node")
        for scan, marker, label in ((nodes[0], "o", "start"), (nodes[-1], "s", "end")):
            axes.plot(
                x_m[scan], y_m[scan], marker, markersize=7, markerfacecolor="none",
                markeredgecolor=GOOD, markeredgewidth=1.8, label=label,
            )  # fmt: skip
        axes.set_aspect("equal", adjustable="datalim")
        width_m, height_m = (np.nanmax(m) - np.nanmin(m) for m in (x_m, y_m))
        drawing.alt = (
            f"{count_of(len(nodes), 'node')} on a line that spans {width_m:.0f} m by"
            f" {height_m:.0f} m."
        )
    return drawing.panel
