"""The figures of a report: panels, and tables with their numbers."""

from collections.abc import Sequence
from dataclasses import dataclass

from core.errors import InvalidParameters


@dataclass(frozen=True)
class Panel:
    """One drawing.

    Attributes:
        title: A title of a few words.
        alt: The drawing in words, for readers who cannot see it.
        svg: The drawing, an `svg` element.
    """

    title: str
    alt: str
    svg: str


@dataclass(frozen=True)
class Table:
    """Numbers behind a figure, as they are written."""

    caption: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def __post_init__(self) -> None:
        if any(len(row) != len(self.headings) for row in self.rows):
            raise InvalidParameters(f"table {self.caption!r}: a row does not fit the headings")


@dataclass(frozen=True)
class Figure:
    """Panels that belong together.

    Attributes:
        key: The figure's address in the page.
        title: A title of a few words.
        caption: How to read it, units and definitions included.
        panels: The drawings; none if there is nothing to draw, and the caption then has the reason.
        tables: The numbers.
    """

    key: str
    title: str
    caption: str
    panels: tuple[Panel, ...]
    tables: tuple[Table, ...] = ()


def percent(share: float) -> str:
    """Write a share.

    Examples:
        >>> percent(0.925), percent(1)
        ('92.5 %', '100.0 %')
    """
    return f"{100 * share:.1f} %"


def shown(values: Sequence[object]) -> tuple[str, ...]:
    """Write a table's row; what is unknown is a dash.

    Examples:
        >>> shown([3, 0.12345, -0.0001, float("nan"), None, True, "x"])
        ('3', '0.123', '0', '–', '–', 'yes', 'x')
    """
    return tuple(_one(value) for value in values)


def _one(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        # What rounds to -0 is 0.
        return "–" if value != value else f"{round(value, 3) + 0.0:.3f}".rstrip("0").rstrip(".")
    return "–" if value is None else str(value)
