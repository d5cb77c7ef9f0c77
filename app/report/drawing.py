"""Matplotlib figures as `svg` elements that follow the page's colours and fonts."""

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from xml.etree import ElementTree as ET

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure as Canvas
from matplotlib.layout_engine import ConstrainedLayoutEngine

from app.report.figure import Panel

# Colours that nothing else uses; each is replaced by a variable of the page, in two themes.
_VARIABLES = {
    "#010201": "ink",
    "#010202": "muted",
    "#010203": "grid",
    "#010204": "accent",
    "#010205": "error",
    "#010206": "good",
    **{f"#01021{i}": f"series-{i}" for i in range(6)},
}
INK, MUTED, GRID, ACCENT, ERROR, GOOD = list(_VARIABLES)[:6]
SERIES = tuple(list(_VARIABLES)[6:])
MARKERS = ("o", "s", "^", "D", "v", "P")
"""One a series: not every reader can distinguish the colours."""


def look_of(series: int) -> tuple[str, str]:
    """Return the marker and the colour of a series, no two of the first 36 alike.

    Examples:
        >>> len({look_of(series) for series in range(36)})
        36
    """
    rounds = series // len(SERIES)
    return MARKERS[(series + rounds) % len(MARKERS)], SERIES[series % len(SERIES)]


_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "tensormap",  # the same figure is the same text
    "font.family": "sans-serif",
    "font.size": 10.0,
    "axes.edgecolor": GRID,
    "axes.labelcolor": INK,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.unicode_minus": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": GRID,
    "ytick.color": GRID,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "legend.columnspacing": 1.2,
    "legend.handlelength": 1.4,
    "legend.handletextpad": 0.5,
    "lines.linewidth": 1.6,
    "lines.markersize": 4.5,
}
_SVG = "{http://www.w3.org/2000/svg}"
_LINK = "{http://www.w3.org/1999/xlink}href"
_FONT = re.compile(r"(font:[^;]*?\d+(?:\.\d+)?px)[^;]*")
_COLOUR = re.compile("|".join(_VARIABLES))


class Drawing:
    """One panel being drawn.

    Attributes:
        axes: What is drawn on.
        alt: What the drawing shows, in words; set in the block of `on`.
        panel: The panel, once that block has ended.
    """

    axes: Axes
    alt: str
    panel: Panel

    @classmethod
    @contextmanager
    def on(
        cls,
        title: str,
        key: str,
        xlabel: str,
        ylabel: str,
        *,
        height_in: float = 3.0,
        legend_columns: int = 5,
        **settings: Any,  # noqa: ANN401 - of Matplotlib
    ) -> Iterator["Drawing"]:
        """Give axes of 4.6 inches, narrow enough for a telephone.

        Args:
            title: The panel's title.
            key: Distinguishes the panel's element ids from those of all others in the page.
            xlabel: The horizontal axis's label.
            ylabel: The vertical axis's label.
            height_in: How high the panel is.
            legend_columns: Number of columns of the legend above the axes, where it covers nothing;
                0 for no legend.
            settings: The axes' settings, such as limits, applied when the block ends.
        """
        with mpl.rc_context():
            mpl.rcdefaults()  # a user's own matplotlibrc does not apply here
            mpl.rcParams.update(_STYLE)
            layout = ConstrainedLayoutEngine()
            canvas = Canvas(figsize=(4.6, height_in), layout=layout)
            FigureCanvasSVG(canvas)  # which measures text as it will be written
            drawing = cls()
            drawing.axes = canvas.subplots()
            yield drawing
            drawing.axes.set(xlabel=xlabel, ylabel=ylabel, **settings)
            if legend_columns:
                canvas.legend(loc="outside upper left", ncols=legend_columns)
            # Settled once: Matplotlib would do it twice, and draw everything each time.
            layout.execute(canvas)
            canvas.set_layout_engine(None)
            text = io.StringIO()
            canvas.savefig(text, format="svg", transparent=True, metadata={"Date": None})
        drawing.panel = Panel(title, drawing.alt, _for_page(text.getvalue(), key))


def _for_page(text: str, key: str) -> str:
    root = ET.fromstring(text)  # noqa: S314  # Matplotlib wrote it just now
    for tag in (f"{_SVG}metadata", f"{_SVG}style"):
        for parent in root.iter():
            for child in parent.findall(tag):
                parent.remove(child)
    for element in root.iter():
        element.tag = element.tag.removeprefix(_SVG)
        link = element.attrib.pop(_LINK, None)
        if link is not None:
            element.set("href", f"#{key}-{link.removeprefix('#')}")
        if "id" in element.attrib:
            element.set("id", f"{key}-{element.attrib['id']}")
        for name, value in element.attrib.items():
            element.set(name, _for_theme(value.replace("url(#", f"url(#{key}-")))
    for name in ("width", "height", "version"):
        root.attrib.pop(name, None)
    root.set("aria-hidden", "true")  # the panel's own words are read instead
    return ET.tostring(root, encoding="unicode")


def _for_theme(style: str) -> str:
    style = _FONT.sub(r"\1 system-ui, sans-serif", style)
    return _COLOUR.sub(lambda found: f"var(--{_VARIABLES[found[0]]})", style)
