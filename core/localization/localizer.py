"""Localization: the map's scan with the closest signature (paper, sec. 2.3)."""

from collections.abc import Sequence
from dataclasses import dataclass

from core.confidence.decision import Decision
from core.confidence.spread import Covariance, Deviation
from core.encodings.search import Search
from core.encodings.signature import REVISION_PREFIX_BYTES, Signature
from core.errors import InvalidScan, InvalidSignature, StaleSignature, UnknownSegment
from core.localization.candidates import deviation_of, find_candidates
from core.localization.match import Match, match_at
from core.localization.priors import NO_PRIORS, MapPrior, Priors
from core.mapping.tensormap import TensorMap
from core.numbers import require_at_least, require_whole
from core.projection.imager import Image
from core.scans.scan import Scan


@dataclass(frozen=True)
class Localization:
    """The answer to one query.

    Attributes:
        revision: The revision that answered.
        matches: The nearest scans, nearest first; with priors in a calibrated map the most likely
            first. At least one.
        runner_up: The nearest scan *away from* the best match, `None` if there is none or it was
            not wanted.
        segments: The segments that were searched.
        decision: Whether the best match is accepted, and its probability.
        deviation: Standard deviations of the estimate if it is right, `None` where not known.
        ratio: Distance of the best match divided by that of the runner-up: near 1 the match is
            ambiguous. `None` without a runner-up; at most 1, also where priors prefer a match that
            is farther.
    """

    revision: str
    matches: tuple[Match, ...]
    runner_up: Match | None
    segments: tuple[int, ...]
    decision: Decision
    deviation: Deviation | None
    ratio: float | None

    @property
    def localized(self) -> bool:
        """Whether the best match is accepted."""
        return self.decision.localized

    @property
    def best(self) -> Match:
        """The best match."""
        return self.matches[0]

    @property
    def position_covariance_m2(self) -> Covariance | None:
        """Covariance of the best match's position in the map's frame, `None` where not known."""
        if self.deviation is None or self.best.pose is None:
            return None
        return self.deviation.covariance_m2(self.best.pose.yaw_deg)

    @property
    def heading_std_deg(self) -> float | None:
        """Standard deviation of the best match's heading, `None` where that is not estimated."""
        if self.deviation is None or self.best.heading_deg is None:
            return None
        return self.deviation.heading_deg


class Localizer:
    """Answers queries against one map revision; safe to share between threads."""

    def __init__(self, tensor_map: TensorMap) -> None:
        self.map = tensor_map
        self.basis = tensor_map.basis()

    def localize_scan(
        self,
        scan: Scan,
        k: int = 1,
        sensor_height_m: float | None = None,
        priors: Priors = NO_PRIORS,
        min_probability: float | None = None,
        *,
        with_runner_up: bool = True,
    ) -> Localization:
        """Localize a scan of the map's sensor.

        Args:
            scan: The returns.
            k: Number of matches.
            sensor_height_m: This scan's sensor height, if it is not the map's; only height images
                depend on it.
            priors: What is known of the place before the search.
            min_probability: Least probability to accept; the map's threshold by default.
            with_runner_up: Whether the runner-up is wanted: to estimate the pose relative to it
                takes as long as to the match. The ratio of the distances is known without it.

        Raises:
            InvalidScan: If no return falls inside the grid, or it is no `Scan`.
            InvalidParameters: If `k` is below 1 or no whole number, `min_probability` is not within
                0..1 or a prior cannot be used in this map.
            UnknownSegment: If a prior names a segment that the map does not have.
        """
        if not isinstance(scan, Scan):
            raise InvalidScan(
                f"wanted a Scan, got {type(scan).__name__}: Scan.from_returns makes one of (n, 3)"
                " metres"
            )
        image = self.basis.image(scan, sensor_height_m)
        return self.localize_image(image, k, priors, min_probability, with_runner_up=with_runner_up)

    def localize_image(
        self,
        image: Image,
        k: int = 1,
        priors: Priors = NO_PRIORS,
        min_probability: float | None = None,
        *,
        with_runner_up: bool = True,
    ) -> Localization:
        """Localize an image of the map's kind and grid.

        Raises:
            SensorMismatch: If the image is of another kind or grid.
            InvalidParameters: As in `localize_scan`.
            UnknownSegment: As in `localize_scan`.
        """
        search = self.search_image(image)
        cells = image.occupied_cells
        return self._localize(
            search, k, priors, min_probability, cells, with_runner_up=with_runner_up
        )

    def localize_signatures(
        self,
        signatures: Sequence[Signature],
        k: int = 1,
        priors: Priors = NO_PRIORS,
        min_probability: float | None = None,
        *,
        with_runner_up: bool = True,
    ) -> Localization:
        """Localize one or more signatures of one scan, each made with its own segment's bases.

        Only those segments are searched. A harmonic signature is compared with all segments.

        Raises:
            StaleSignature: If one names neither this revision nor a basis that it has.
            UnknownSegment: If the map, or the basis that it names, has no such segment.
            InvalidSignature: If they are no sequence, there is none, a segment is repeated, the
                shape is not r1 x r2 or they are of another encoding.
            InvalidParameters: As in `localize_scan`.
        """
        search = self.search(signatures)
        return self._localize(
            search, k, priors, min_probability, None, with_runner_up=with_runner_up
        )

    def _localize(
        self,
        search: Search,
        k: int,
        priors: Priors,
        min_probability: float | None,
        occupied_cells: int | None,
        *,
        with_runner_up: bool,
    ) -> Localization:
        require_whole(k=k)
        require_at_least(1, k=k)
        prior = None if priors == NO_PRIORS else MapPrior(priors, self.map)
        calibration = self.map.calibration_of(search)
        spread = calibration is not None and calibration.spread is not None
        candidates = find_candidates(self.map, search, k, prior, spread=spread)
        decision = candidates.decide(calibration, min_probability, occupied_cells)
        away = candidates.away if with_runner_up else candidates.away[:0]
        return Localization(
            self.map.revision,
            tuple(
                match_at(self.map, search, candidates.matches, position)
                for position in range(len(candidates.matches))
            ),
            match_at(self.map, search, away) if len(away) else None,
            search.segments,
            decision,
            deviation_of(self.map, search, candidates),
            candidates.ratio,
        )

    def search(self, signatures: Sequence[Signature]) -> Search:
        """Return the comparison of one scan's signatures with the map's.

        Raises:
            StaleSignature: If one was made with another revision's bases.
            UnknownSegment: If the map has no such segment.
            InvalidSignature: As in `localize_signatures`.
        """
        self._require_answerable(signatures)
        return self.map.model.search(signatures)

    def search_image(self, image: Image) -> Search:
        """Return the comparison of an image with the map's scans.

        Raises:
            SensorMismatch: If the image is of another kind or grid.
        """
        return self.map.model.search_image(image, self.basis)

    def _require_answerable(self, signatures: Sequence[Signature]) -> None:
        if isinstance(signatures, Signature | bytes):
            raise InvalidSignature(
                f"wanted a sequence of signatures, got {type(signatures).__name__}:"
                " put one into a list, or unpack them with unpack_signatures"
            )
        if not signatures:
            raise InvalidSignature("wanted at least one signature, got none")
        for shape in {signature.values.shape for signature in signatures}:
            self.map.parameters.encoder.require_shape(shape, self.map.parameters)
        for named in {signature.revision for signature in signatures}:
            held, segments = self._segments_of(named), self.map.model.segments
            if not held:
                raise StaleSignature(
                    f"the signature was made with revision or basis {named or '(none)'}, this one"
                    f" is {self.map.revision} with basis {self.map.basis_digest}"
                )
            for signature in signatures:
                # For a number beyond, `search` raises that the map has no such segment.
                if signature.revision == named and held <= (signature.segment or 0) < segments:
                    raise UnknownSegment(
                        f"basis {named} is of segments 0..{held - 1}, the signature of"
                        f" {signature.segment}"
                    )

    def _segments_of(self, named: str) -> int:
        """Return the number of segments with bases in a revision or basis, 0 if it is not known."""
        if len(named) < 2 * REVISION_PREFIX_BYTES:
            return 0
        if self.map.revision.startswith(named):
            return self.map.model.segments
        digests = enumerate(self.map.basis_digests, 1)
        return next((count for count, digest in digests if digest.startswith(named)), 0)

    def answers(self, named: str) -> bool:
        """Return whether signatures may name this digest: the revision's or that of its basis.

        Args:
            named: A digest of 64 hexadecimal digits, or at least its first 16.
        """
        return self._segments_of(named) > 0
