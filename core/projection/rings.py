"""The polar lattice of a height image: rings around the sensor, cut into azimuths."""

from dataclasses import asdict, dataclass

from core.errors import InvalidParameters
from core.scans.sensor import MAX_CELLS, require_lattice

_MIN_STEP = 1e-3  # metres, degrees


@dataclass(frozen=True)
class RingGrid:
    """Rings of equal width on the ground, half-open, and azimuths rounded to whole steps.

    A return at horizontal distance d lies in ring floor(d / ring_m); azimuth phi in column
    round(phi / step) mod J, so that a full turn has no seam.

    Examples:
        >>> RingGrid().shape, RingGrid().reach_m
        ((20, 360), 80.0)
    """

    ring_m: float = 4.0
    rings: int = 20
    azimuth_step_deg: float = 1.0

    def __post_init__(self) -> None:
        # 4 and 4.0 are one grid, and must be one digest.
        for name, most in (("ring_m", 1000.0), ("azimuth_step_deg", 90.0)):
            object.__setattr__(self, name, float(getattr(self, name)))
            if not _MIN_STEP <= getattr(self, name) <= most:
                raise InvalidParameters(
                    f"{name} is {getattr(self, name)}, wanted {_MIN_STEP}..{most:g}"
                )
        if self.rings != self.rings // 1 or not 1 <= self.rings <= MAX_CELLS:
            raise InvalidParameters(f"rings is {self.rings}, wanted a whole number, at least 1")
        object.__setattr__(self, "rings", int(self.rings))
        require_lattice(self.azimuth_step_deg, self.rows, self.columns)

    @property
    def rows(self) -> int:
        """I, how many rings."""
        return self.rings

    @property
    def columns(self) -> int:
        """J, how many azimuths: an even number."""
        return round(360.0 / self.azimuth_step_deg)

    @property
    def shape(self) -> tuple[int, int]:
        """`(I, J)`: rings, azimuths."""
        return self.rows, self.columns

    @property
    def wraps(self) -> bool:
        """Whether the last column's neighbour is the first: always."""
        return True

    @property
    def reach_m(self) -> float:
        """Where the last ring ends."""
        return self.ring_m * self.rings

    def as_attributes(self) -> dict[str, float | int | bool]:
        """Return plain values for a file's attributes."""
        return asdict(self)
