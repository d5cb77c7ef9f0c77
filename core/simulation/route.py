"""The line that a simulated vehicle follows: straights joined by arcs, closed to a loop."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from core.arrays import BoolArray, FloatArray, IntArray, frozen
from core.errors import InvalidParameters
from core.scans.angles import wrapped_rad


@dataclass(frozen=True, eq=False)
class Route:
    """A closed line of straights and arcs, its heading continuous.

    Attributes:
        pieces: `(n, 5)`: distance along the route at which a piece begins, x and y there in
            metres, heading there in radians, curvature per metre (0 straight, left positive).
        length_m: Once round.
    """

    pieces: FloatArray
    length_m: float

    @classmethod
    def around(cls, corners_m: ArrayLike, *, turn_radius_m: float) -> "Route":
        """Return the loop along a polygon, its corners rounded.

        It begins in the middle of the side from the first corner to the second, so that its end
        passes the street in which it began.

        Args:
            corners_m: `(n, 2)`, at least three corners that are corners.
            turn_radius_m: The radius of the arc at each corner.

        Raises:
            InvalidParameters: If a side is too short for the arcs at its ends.

        Examples:
            >>> square = Route.around([(0, 0), (80, 0), (80, 80), (0, 80)], turn_radius_m=10.0)
            >>> round(square.length_m, 3)
            302.832
            >>> x_m, y_m, heading_deg = square.at(np.array([0.0, square.length_m / 2]))
            >>> x_m.round(6).tolist(), y_m.round(6).tolist(), heading_deg.round(6).tolist()
            ([40.0, 40.0], [0.0, 80.0], [0.0, 180.0])
        """
        corners = np.asarray(corners_m, dtype=np.float64).reshape(-1, 2)
        if len(corners) < 3 or turn_radius_m <= 0.0:
            raise InvalidParameters("a route wants at least three corners and a positive radius")
        sides = np.roll(corners, -1, axis=0) - corners
        side_m = np.hypot(*sides.T)
        heading = np.arctan2(sides[:, 1], sides[:, 0])
        turn = wrapped_rad(np.roll(heading, -1) - heading)
        # From where an arc begins to its corner, at the end of each side.
        tangent_m = turn_radius_m * np.tan(np.abs(turn) / 2.0)
        straight_m = side_m - tangent_m - np.roll(tangent_m, 1)
        if (straight_m <= 0.0).any():
            raise InvalidParameters(f"arcs of {turn_radius_m} m do not fit the route's sides")
        ahead = sides / side_m[:, None]
        leaves = corners + ahead * np.roll(tangent_m, 1)[:, None]
        enters = np.roll(corners, -1, axis=0) - ahead * tangent_m[:, None]
        rows: list[tuple[float, ...]] = []
        along_m = 0.0
        for side in range(len(corners)):
            start = (corners[0] + corners[1]) / 2.0 if side == 0 else leaves[side]
            rows.append((along_m, *start, heading[side], 0.0))
            along_m += float(np.hypot(*(enters[side] - start)))
            rows.append(
                (along_m, *enters[side], heading[side], np.sign(turn[side]) / turn_radius_m)
            )
            along_m += turn_radius_m * abs(float(turn[side]))
        rows.append((along_m, *leaves[0], heading[0], 0.0))
        along_m += float(np.hypot(*((corners[0] + corners[1]) / 2.0 - leaves[0])))
        return cls(frozen(rows, np.float64), along_m)

    @property
    def arc_starts_m(self) -> FloatArray:
        """Distance along the route at which each turn begins."""
        return np.asarray(self.pieces[self.pieces[:, 4] != 0.0, 0])

    def on_arc(self, along_m: ArrayLike) -> BoolArray:
        """Return where the route turns."""
        return np.asarray(self.pieces[self._piece(along_m), 4] != 0.0)

    def at(self, along_m: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x and y in metres and heading in degrees, at distances past the loop's end too."""
        start_m, x, y, heading, curvature = self.pieces[self._piece(along_m)].T
        on_m = np.mod(along_m, self.length_m) - start_m
        turned = heading + curvature * on_m
        arc = curvature != 0.0
        radius = np.divide(1.0, curvature, out=np.zeros_like(curvature), where=arc)
        x = x + np.where(arc, (np.sin(turned) - np.sin(heading)) * radius, on_m * np.cos(heading))
        y = y + np.where(arc, (np.cos(heading) - np.cos(turned)) * radius, on_m * np.sin(heading))
        return x, y, np.degrees(turned)

    def _piece(self, along_m: ArrayLike) -> IntArray:
        along = np.mod(along_m, self.length_m)
        return np.asarray(np.searchsorted(self.pieces[:, 0], along, side="right") - 1)
