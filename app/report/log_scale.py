"""A logarithmic axis whose numbers are read as decimals and do not overlap."""

from matplotlib.axis import Axis
from matplotlib.ticker import Locator, LogLocator, MaxNLocator, NullLocator

_FEWEST, _MOST = 3, 7  # numbers on a panel of 4.6 by 3 inches


class DecimalLocator(Locator):
    """Rounded numbers: 1, 2 and 5 of each decade, or fewer or more for what is shown."""

    def __call__(self) -> list[float]:
        """Return the ticks of the axis."""
        return self.tick_values(*self.axis.get_view_interval())  # type: ignore[union-attr]

    def tick_values(self, vmin: float, vmax: float) -> list[float]:
        """Return ticks between two numbers above 0.

        Examples:
            >>> DecimalLocator().tick_values(232.0, 760.0)
            [300.0, 400.0, 500.0, 600.0, 700.0]
            >>> DecimalLocator().tick_values(0.008, 90.0)
            [0.01, 0.1, 1.0, 10.0]
        """
        low, high = sorted((vmin, vmax))
        ticks: list[float] = []
        for locator in (
            LogLocator(subs=(1.0, 2.0, 5.0), numticks=99),
            LogLocator(subs=(1.0,), numticks=99),
            LogLocator(subs=(1.0,), numticks=_MOST),
            MaxNLocator(nbins=5),
        ):
            placed = map(float, locator.tick_values(low, high))
            ticks = [tick for tick in placed if low <= tick <= high]
            if _FEWEST <= len(ticks) <= _MOST:
                break
        return ticks


def decimal(value: float, _: float = 0.0) -> str:
    """Write a number without an exponent.

    Examples:
        >>> decimal(0.01), decimal(1000.0), decimal(0.9)
        ('0.01', '1000', '0.9')
    """
    return f"{value:.6f}".rstrip("0").rstrip(".")


def make_logarithmic(axis: Axis) -> None:
    """Give an axis a logarithmic scale with decimal numbers."""
    axis.axes.set(**{f"{axis.axis_name}scale": "log"})  # type: ignore[attr-defined]
    axis.set_major_locator(DecimalLocator())
    axis.set_major_formatter(decimal)
    axis.set_minor_locator(NullLocator())  # whose numbers would be powers between ours
