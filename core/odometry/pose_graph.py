"""Poses adjusted to odometry and loop closures, with their covariances.

Between two scans of closures the steps of odometry are one step, whose covariance is the sum of
theirs, so that the least-squares problem is small and dense; what it corrects is then spread over
the scans in between as that sum grows.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.odometry.closures import Closure
from core.scans.rigid import are_near, inverse
from core.scans.sampling import spread_evenly

_MOST_NODES = 60
_MOST_CLOSURES = 40
# Recorded drives take 4; simulated ones, bent by 150 m, up to 305 until right closures agreed.
_MOST_EVALUATIONS = 400

# Of odometry, along a root of a metre: chosen on simulated worlds, docs/decisions/0040-odometry.md.
_SIGMA_M, _SIGMA_DEG = 0.05, 0.05
_STANDING_M = 0.1  # path that a step counts at least: a vehicle that turns on the spot
# Of any step at least: no edge of the graph has infinite weight.
_STILL_M, _STILL_DEG = 1e-4, 1e-3
# Of a step that was not registered.
_LOST_M, _LOST_DEG = 10.0, 20.0
# Of a closure.
_CLOSURE_M, _CLOSURE_DEG = 0.2, 0.3
_OUTLIER = 3.0  # residual, in standard deviations, from which a closure counts less
_AGREE_M, _AGREE_DEG = 1.0, 2.0  # most between a closure and adjusted poses
_DERIVATIVE_STEP = 1e-6


@dataclass(frozen=True, eq=False)
class Adjusted:
    """Adjusted poses.

    Attributes:
        poses: `(K, 4, 4)`, the first one as it was.
        sigmas: `(K, 2)` standard deviations against the first: of x and y in metres, of the
            heading in degrees.
        kept: `(c,)` which closures the poses agree with.
    """

    poses: FloatArray
    sigmas: FloatArray
    kept: BoolArray


def adjust(poses: FloatArray, registered: BoolArray, closures: Sequence[Closure]) -> Adjusted:
    """Adjust poses to closures.

    Closures that contradict one another can keep the solver from converging. After 400 evaluations
    it ends with the best poses that it has found; `kept` says which closures agree with them.

    Args:
        poses: `(K, 4, 4)` by odometry.
        registered: `(K,)` which were registered to those before.
        closures: Measured ones, in any order.
    """
    if len(poses) < 2:
        return Adjusted(poses, np.zeros((len(poses), 2)), np.zeros(0, bool))
    of_steps = _variances(poses, registered)
    grown = np.concatenate([[0.0], np.cumsum(of_steps[:, 0])])
    chosen = [closures[at] for at in spread_evenly(np.arange(len(closures)), _MOST_CLOSURES)]
    nodes = _nodes(grown, chosen)
    # Summed edge by edge: differences of the sum along a long drive would round to zero.
    graph = _Graph(poses, np.add.reduceat(of_steps, nodes[:-1]), nodes, chosen)
    corrected, variances = graph.solve()
    adjusted = _spread_corrections(poses, corrected, nodes, grown)
    of_scans = [np.interp(grown, grown[nodes], of_nodes) for of_nodes in variances.T]
    sigmas = np.sqrt(np.stack(of_scans, axis=1)) * np.array([1.0, np.degrees(1.0)])
    kept = [
        are_near(
            one.pose, inverse(adjusted[one.first]) @ adjusted[one.second], _AGREE_M, _AGREE_DEG
        )
        for one in closures
    ]
    return Adjusted(adjusted, sigmas, np.array(kept, bool))


def _variances(poses: FloatArray, registered: BoolArray) -> FloatArray:
    """Return the variances of the steps from scan to scan, `(K - 1, 2)`, m^2 and rad^2."""
    steps_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    counted_m = np.maximum(steps_m, _STANDING_M * (steps_m > 1e-3))[:, None]
    each = counted_m * np.array([_SIGMA_M, np.radians(_SIGMA_DEG)]) ** 2
    each = np.maximum(each, np.array([_STILL_M, np.radians(_STILL_DEG)]) ** 2)
    each[~registered[1:]] += np.array([_LOST_M, np.radians(_LOST_DEG)]) ** 2
    return np.asarray(each)


def _spread_corrections(
    poses: FloatArray, corrected: FloatArray, nodes: IntArray, grown: FloatArray
) -> FloatArray:
    """Return all poses, `(K, 4, 4)`: each moves with the nodes before and after it."""
    from scipy.spatial.transform import Rotation  # only drives without poses need it

    moves = corrected @ inverse(poses[nodes])
    before = np.clip(np.searchsorted(nodes, np.arange(len(poses)), side="right") - 1, 0, None)
    before = np.minimum(before, len(nodes) - 2)
    start, length = grown[nodes[before]], np.diff(grown[nodes])[before]
    share = ((grown - start) / np.maximum(length, _STILL_M**2))[:, None]
    with_first, with_second = moves[before] @ poses, moves[before + 1] @ poses
    adjusted = with_first.copy()
    adjusted[:, :3, 3] += share * (with_second - with_first)[:, :3, 3]
    first = Rotation.from_matrix(with_first[:, :3, :3])
    turn = first.inv() * Rotation.from_matrix(with_second[:, :3, :3])
    adjusted[:, :3, :3] = (first * Rotation.from_rotvec(share * turn.as_rotvec())).as_matrix()
    return adjusted


def _nodes(grown: FloatArray, closures: Sequence[Closure]) -> IntArray:
    """Return the scans whose poses are unknowns, and the first: those of closures, and others."""
    ends = [0, len(grown) - 1, *(at for one in closures for at in (one.first, one.second))]
    spread = np.linspace(0.0, grown[-1], max(2, _MOST_NODES - len(set(ends))))
    return np.unique([*ends, *np.searchsorted(grown, spread[:-1]).tolist()])


class _Graph:
    """The least-squares problem; the unknowns are `(n - 1, 6)` corrections of the nodes' poses.

    A correction is a move in the world's axes and a rotation vector in the scan's.
    """

    def __init__(
        self, poses: FloatArray, of_steps: FloatArray, nodes: IntArray, closures: Sequence[Closure]
    ) -> None:
        self._poses = poses[nodes]
        first = [one.first for one in closures]
        second = [one.second for one in closures]
        self._first = np.concatenate([np.arange(len(nodes) - 1), np.searchsorted(nodes, first)])
        self._second = np.concatenate([np.arange(1, len(nodes)), np.searchsorted(nodes, second)])
        chain = inverse(self._poses[:-1]) @ self._poses[1:]
        measured = np.concatenate([chain, *(one.pose[None] for one in closures)])
        self._measured_inverse = inverse(measured)
        steps = np.sqrt(of_steps)
        length_m = np.linalg.norm(chain[:, :3, 3], axis=1)
        # Headings that drift within a step move its end aside: the integral of a random walk.
        steps[:, 0] = np.hypot(steps[:, 0], length_m * steps[:, 1] / np.sqrt(3.0))
        of_closures = np.tile([_CLOSURE_M, np.radians(_CLOSURE_DEG)], (len(closures), 1))
        self._weights = 1.0 / np.repeat(np.concatenate([steps, of_closures]), 3, axis=1)
        self._of_closures = np.repeat(np.arange(len(measured)) >= len(chain), 6)

    def solve(self) -> tuple[FloatArray, FloatArray]:
        """Return the nodes' poses, `(n, 4, 4)`, and their variances, `(n, 2)`, m^2 and rad^2."""
        from scipy.optimize import least_squares  # only drives without poses need it

        found = least_squares(
            self._residuals,
            np.zeros(6 * (len(self._poses) - 1)),
            jac=self._jacobian,
            loss=self._loss,  # type: ignore[arg-type]  # the stubs want an argument SciPy lacks
            max_nfev=_MOST_EVALUATIONS,
        )
        slopes = np.asarray(found.jac, dtype=np.float64)
        variances = np.diag(np.linalg.inv(slopes.T @ slopes)).reshape(-1, 6)
        of_nodes = np.stack([variances[:, :2].mean(axis=1), variances[:, 5]], axis=1)
        return self._posed(found.x), np.concatenate([np.zeros((1, 2)), of_nodes])

    def _posed(self, corrections: FloatArray) -> FloatArray:
        from scipy.spatial.transform import Rotation  # only drives without poses need it

        each = np.concatenate([np.zeros(6), corrections]).reshape(-1, 6)
        posed = self._poses.copy()
        posed[:, :3, 3] += each[:, :3]
        posed[:, :3, :3] = posed[:, :3, :3] @ Rotation.from_rotvec(each[:, 3:]).as_matrix()
        return posed

    def _of_edges(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return the weighted residuals of edges between poses, `(e, 6)`."""
        from scipy.spatial.transform import Rotation  # only drives without poses need it

        off = self._measured_inverse @ inverse(first) @ second
        turns = Rotation.from_matrix(off[:, :3, :3]).as_rotvec()
        return np.asarray(np.hstack([off[:, :3, 3], turns]) * self._weights)

    def _residuals(self, corrections: FloatArray) -> FloatArray:
        posed = self._posed(corrections)
        return self._of_edges(posed[self._first], posed[self._second]).ravel()

    def _jacobian(self, corrections: FloatArray) -> FloatArray:
        """Return the derivatives by differences, those of one component of all nodes at once.

        An edge depends on the nodes at its ends only: first these are moved, then those.
        """
        edges = len(self._first)
        jacobian = np.zeros((6 * edges, len(corrections)))
        rows = np.arange(6 * edges).reshape(edges, 6)
        posed = self._posed(corrections)
        here = self._of_edges(posed[self._first], posed[self._second])
        for component in range(6):
            step = np.zeros((len(self._poses) - 1, 6))
            step[:, component] = _DERIVATIVE_STEP
            moved = self._posed(corrections + step.ravel())
            for ends, residuals in (
                (self._first, self._of_edges(moved[self._first], posed[self._second])),
                (self._second, self._of_edges(posed[self._first], moved[self._second])),
            ):
                free = ends > 0  # the first node stays
                columns = 6 * (ends[free] - 1) + component
                jacobian[rows[free], columns[:, None]] = (
                    residuals[free] - here[free]
                ) / _DERIVATIVE_STEP
        return jacobian

    def _loss(self, squares: FloatArray) -> FloatArray:
        """Return Cauchy's loss of closures, the square of steps, and both derivatives."""
        scaled = 1.0 + squares / _OUTLIER**2
        loss = np.stack([squares, np.ones_like(squares), np.zeros_like(squares)])
        at = self._of_closures
        loss[:, at] = [
            _OUTLIER**2 * np.log(scaled[at]),
            1.0 / scaled[at],
            -1.0 / (_OUTLIER * scaled[at]) ** 2,
        ]
        return loss
