"""Checks of proposed loop closures: whether two scans show one place (paper, sec. 4)."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from core.arrays import BoolArray, ComplexArray, FloatArray
from core.confidence.logistic import logistic
from core.encodings.signature import Signature
from core.errors import InvalidParameters, InvalidSignature
from core.localization.localizer import Localizer
from core.loop_closure.birds_eye_view import align_views
from core.loop_closure.chance import above_chance
from core.numbers import none_if_nan
from core.projection.angles import azimuth_columns
from core.projection.height_image import project_heights
from core.projection.imager import LATERAL_RENDERINGS_M
from core.projection.levelling import level
from core.projection.reducer import Reducer
from core.projection.rings import RingGrid
from core.projection.visibility import sector_of_column, visible_sectors
from core.scans.angles import wrapped_deg
from core.scans.displacement import seen_from_beside
from core.scans.rigid import planar
from core.scans.scan import Scan

ACCEPT_FROM = 0.99
"""Least probability to accept a closure; a false one would distort a whole map."""

_GRID = RingGrid()
_LEAST = 1e-6
_BLUR_COLUMNS = 1.0  # a sparse scan leaves gaps
_LEAST_COMMON = 0.3  # of an image: what fewer columns agree on may be by chance
_PEAKS = 3  # headings that are compared: opposite directions of a street are similar
_APART_DEG = 10.0  # between them

# Of a logistic curve, fitted to simulated drives: docs/decisions/0015-loop-closures.md.
_INTERCEPT, _OF_SIMILARITY, _OF_OVERLAP = -8.1, 9.5, 10.8


class ClosureDecision(StrEnum):
    """Decision on a proposed closure."""

    ACCEPTED = "accepted"
    REJECTED = "rejected"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class LoopClosure:
    """A checked closure between a first and a second scan.

    Attributes:
        probability: Probability that they are within some 5 m of each other, with even prior odds;
            `None` if not known.
        relative_yaw_deg: Relative yaw of the second, counter-clockwise, -180..180; `None` if not
            known, as from the paper's signatures.
        forward_m: Distance of the second ahead of the first; `None` likewise.
        lateral_m: Its distance to the left; `None` likewise.
        image_similarity: Similarity of the height images in the best heading, at most 1, less that
            of any heading; `None` without returns.
        overlap: Overlap of the bird's-eye views in the best alignment, at most 1, likewise.
        signature_distance: Distance of the signatures in the measure of the map, `None` without.
    """

    probability: float | None
    relative_yaw_deg: float | None = None
    forward_m: float | None = None
    lateral_m: float | None = None
    image_similarity: float | None = None
    overlap: float | None = None
    signature_distance: float | None = None

    def __post_init__(self) -> None:
        if self.probability is not None and not 0.0 <= self.probability <= 1.0:
            raise InvalidParameters(f"probability is {self.probability}, wanted 0..1")

    @property
    def planar_pose(self) -> FloatArray:
        """The `(4, 4)` pose of the second scan in the levelled frame of the first.

        What is not known counts as the same place and heading.
        """
        return planar(self.forward_m or 0.0, self.lateral_m or 0.0, self.relative_yaw_deg or 0.0)

    def decide(self, accept_from: float = ACCEPT_FROM) -> ClosureDecision:
        """Accept or reject the closure, or leave it undecided.

        Args:
            accept_from: The least probability to accept; below a half it is rejected.

        Raises:
            InvalidParameters: If that is not above 0.5 and at most 1.
        """
        if not 0.5 < accept_from <= 1.0:
            raise InvalidParameters(f"accept_from is {accept_from}, wanted above 0.5, at most 1")
        if self.probability is None:
            return ClosureDecision.UNDECIDED
        if self.probability >= accept_from:
            return ClosureDecision.ACCEPTED
        return ClosureDecision.REJECTED if self.probability < 0.5 else ClosureDecision.UNDECIDED


def check_scans(first: Scan, second: Scan, sensor_height_m: float) -> LoopClosure:
    """Check a closure by both scans' returns.

    Both are levelled. Their height images are compared in every heading, from virtual viewpoints
    too; then their bird's-eye views in the best headings, with all shifts within 5 m; both only
    where the two scans see. The result depends on no map, encoding or sensor, but on the sensors'
    height.

    Args:
        first: The scan that the answer is relative to.
        second: The other one.
        sensor_height_m: The height of both sensors above ground.

    Raises:
        InvalidScan: If one has no return above the ground within 80 m.
        InvalidParameters: If `sensor_height_m` is not above 0.
    """
    first, second = level(first, sensor_height_m), level(second, sensor_height_m)
    similarity, relative_yaws_deg = _similarity(first, second, sensor_height_m)
    found = align_views(first, second, relative_yaws_deg, sensor_height_m)
    return LoopClosure(
        closure_probability(similarity, found.overlap),
        relative_yaw_deg=wrapped_deg(found.relative_yaw_deg),
        forward_m=found.forward_m,
        lateral_m=found.lateral_m,
        image_similarity=similarity,
        overlap=found.overlap,
    )


def check_signatures(
    localizer: Localizer, row: int, signatures: Sequence[Signature]
) -> LoopClosure:
    """Check a closure between a scan of a map and one of which only signatures are known.

    Far less reliable than `check_scans`: similar streets have nearly the same signatures, the more
    so the less of a place they contain. The probability is that of the map's calibration for such
    signatures, `None` without one.

    Args:
        localizer: The map's localizer.
        row: The row of the map's scan, the first of the closure.
        signatures: The second's signatures, made with the map's basis; only the one of the first
            scan's segment is used.

    Raises:
        InvalidSignature: If none is of the scan's segment, or as in `Localizer.search`.
        InvalidParameters: If the map has no such row.
        TensorMapError: As in `Localizer.search`.
    """
    tensor_map = localizer.map
    if not 0 <= row < len(tensor_map):
        raise InvalidParameters(f"row is {row}, the map has 0..{len(tensor_map) - 1}")
    among = np.zeros(len(tensor_map), dtype=np.bool_)
    among[row] = True
    search = localizer.search(signatures)
    found = search.nearest(1, among)
    if not len(found):
        segment = tensor_map.model.segment_of_scan[row]
        raise InvalidSignature(f"the scan is of segment {segment}, none of the signatures is")
    distance, calibration = float(found.distances[0]), tensor_map.calibration_of(search)
    return LoopClosure(
        None if calibration is None else calibration.probability_of_scan(distance, search.evidence),
        relative_yaw_deg=none_if_nan(found.relative_yaw_deg[0]),
        lateral_m=none_if_nan(found.lateral_m[0]),
        signature_distance=distance,
    )


def closure_probability(image_similarity: float, overlap: float) -> float:
    """Return the probability of a closure with that evidence.

    Examples:
        >>> closure_probability(0.7, 0.7) > 0.99, closure_probability(0.2, 0.2) < 0.1
        (True, True)
    """
    return logistic(_INTERCEPT + _OF_SIMILARITY * image_similarity + _OF_OVERLAP * overlap)


def _similarity(first: Scan, second: Scan, sensor_height_m: float) -> tuple[float, FloatArray]:
    """Return the greatest similarity over viewpoints, `above_chance`, and the best headings."""
    seen = _seen(first)
    query = _view(second, _seen(second), sensor_height_m)
    best, correlation = -1.0, np.zeros(_GRID.columns)
    for left_m in LATERAL_RENDERINGS_M:
        aside = Scan.from_returns(seen_from_beside(first.points_m, left_m)) if left_m else first
        cosines = _cosines(_view(aside, seen, sensor_height_m), query)
        above = above_chance(cosines)
        if above > best:
            best, correlation = above, cosines
    return min(1.0, best), _headings(correlation)


def _seen(scan: Scan) -> BoolArray:
    """Return which columns of an image a scan sees, `(J,)`."""
    column = azimuth_columns(scan.points_m, _GRID.columns)
    visible = visible_sectors(scan.points_m, column, _GRID.columns)
    return np.asarray(visible[sector_of_column(_GRID.columns)])


@dataclass(frozen=True)
class _View:
    """A height image where its scan sees, as transforms over the azimuths.

    Attributes:
        rings: The transforms of each ring's heights.
        squares: The transform of the sum of the squared heights of each column.
        seen: The transform of which columns are seen.
        least: The smallest sum of squares that a comparison counts.
    """

    rings: ComplexArray
    squares: ComplexArray
    seen: ComplexArray
    least: float


def _view(scan: Scan, seen: BoolArray, sensor_height_m: float) -> _View:
    from scipy.ndimage import gaussian_filter1d  # no answer needs it: decision 33

    heights = project_heights(scan, _GRID, Reducer.MEAN, sensor_height_m).astype(np.float64)
    heights = gaussian_filter1d(heights * seen, _BLUR_COLUMNS, axis=1, mode="wrap") * seen
    squares = (heights * heights).sum(axis=0)
    return _View(
        np.fft.rfft(heights, axis=1),
        np.fft.rfft(squares),
        np.fft.rfft(seen),
        max(_LEAST_COMMON * float(squares.sum()), _LEAST),
    )


def _cosines(first: _View, second: _View) -> FloatArray:
    """Return the cosine of two views where both see, over all headings, `(J,)`."""
    products = [
        (np.conj(first.rings) * second.rings).sum(axis=0),
        np.conj(first.squares) * second.seen,
        np.conj(first.seen) * second.squares,
    ]
    product, of_first, of_second = np.fft.irfft(products, _GRID.columns)
    common = np.maximum(of_first, first.least) * np.maximum(of_second, second.least)
    return np.asarray(product / np.sqrt(common))


def _headings(correlation: FloatArray) -> FloatArray:
    """Return the headings at the highest peaks, `(3,)` degrees."""
    step_deg = 360.0 / len(correlation)
    left = correlation.copy()
    yaws_deg: list[float] = []
    for _ in range(_PEAKS):
        yaw_deg = -float(left.argmax()) * step_deg
        yaws_deg.append(yaw_deg)
        away = np.abs(wrapped_deg(-step_deg * np.arange(len(left), dtype=np.float64) - yaw_deg))
        left[away < _APART_DEG] = -np.inf
    return np.array(yaws_deg)
