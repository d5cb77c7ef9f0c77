"""Where am I: the map's scan with the closest signature (paper, sec. 2.3)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from core.confidence.spread import Deviation
from core.confidence.verdict import Verdict
from core.encodings.model import Neighbours, Search
from core.encodings.signature import REVISION_PREFIX_BYTES, Signature
from core.errors import (
    InvalidParameters,
    InvalidSignature,
    StaleSignature,
    UnknownSegment,
)
from core.localization.candidates import deviation_of, find_candidates
from core.localization.match import Match, match_at
from core.localization.priors import NO_HINTS, Hints, Prior
from core.mapping.tensormap import TensorMap
from core.projection.imager import Image
from core.scans.scan import Scan


@dataclass(frozen=True)
class Localization:
    """The answer to one query.

    Attributes:
        revision: The revision that answered.
        matches: The nearest scans, nearest first; at least one.
        runner_up: The nearest scan *away from* the winner, `None` if the map holds none.
        segments: The segments that were searched.
        verdict: Whether it is an answer at all, and how likely it is right.
        deviation: How far off it may be if it is right, `None` where the map cannot tell.
        ratio: Distance of the winner over that of the runner-up: near 1 the answer is ambiguous.
            `None` without a runner-up; at most 1, though hints may prefer a winner that is farther.
    """

    revision: str
    matches: tuple[Match, ...]
    runner_up: Match | None
    segments: tuple[int, ...]
    verdict: Verdict
    deviation: Deviation | None
    ratio: float | None

    @property
    def localized(self) -> bool:
        """Whether the best match may be taken for where the query was made."""
        return self.verdict.localized

    @property
    def best(self) -> Match:
        """The nearest scan."""
        return self.matches[0]

    @property
    def position_covariance_m2(self) -> tuple[float, float, float] | None:
        """xx, xy and yy of the best position in the map's frame, `None` where not known."""
        place = self.best.pose if self.best.estimated_pose is None else self.best.estimated_pose
        if self.deviation is None or place is None or self.best.pose is None:
            return None
        return self.deviation.covariance_m2(self.best.pose.yaw_deg)


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
        hints: Hints = NO_HINTS,
        min_probability: float | None = None,
    ) -> Localization:
        """Localize a scan of the map's sensor.

        Args:
            scan: The returns.
            k: How many nearest scans to answer.
            sensor_height_m: Of this scan, if its sensor is mounted otherwise than the map's; only
                height images depend on it.
            hints: What is known of the place beforehand.
            min_probability: Below it the answer is a refusal; the map's threshold by default.

        Raises:
            InvalidScan: If no return falls inside the grid.
            InvalidParameters: If `k` is below 1, `min_probability` not within 0..1 or a hint says
                nothing in this map.
            UnknownSegment: If a hint names a segment that the map does not have.
        """
        image = self.basis.image(scan, sensor_height_m)
        return self.localize_image(image, k, hints, min_probability)

    def localize_image(
        self,
        image: Image,
        k: int = 1,
        hints: Hints = NO_HINTS,
        min_probability: float | None = None,
    ) -> Localization:
        """Localize an image of the map's kind and grid.

        Raises:
            SensorMismatch: If the image is of another kind or grid.
            InvalidParameters: As `localize_scan`.
            UnknownSegment: Likewise.
        """
        cells = int(np.count_nonzero(image.cells))
        search = self.map.model.search_values(self.basis.project(image))
        return self._localize(search, k, hints, min_probability, cells)

    def localize_signatures(
        self,
        signatures: Sequence[Signature],
        k: int = 1,
        hints: Hints = NO_HINTS,
        min_probability: float | None = None,
    ) -> Localization:
        """Localize by one or more signatures of one scan, each in its own segment's bases.

        Exactly those segments are searched: a signature made with one segment's bases says
        nothing in another's. A harmonic signature is one for all segments.

        Raises:
            StaleSignature: If one names neither this revision nor a basis that it has.
            UnknownSegment: If the map, or the basis that it names, has no such segment.
            InvalidSignature: If there is none, a segment comes twice, the shape is not r1 x r2 or
                they are of another encoding.
            InvalidParameters: As `localize_scan`.
        """
        return self._localize(self.search(signatures), k, hints, min_probability, None)

    def _localize(
        self,
        search: Search,
        k: int,
        hints: Hints,
        min_probability: float | None,
        occupied_cells: int | None,
    ) -> Localization:
        if k < 1:
            raise InvalidParameters(f"k is {k}, wanted at least 1")
        prior = None if hints == NO_HINTS else Prior(hints, self.map)
        candidates = find_candidates(self.map, search, k, prior)
        verdict = candidates.judge(self.map.calibration, min_probability, occupied_cells)
        return Localization(
            self.map.revision,
            tuple(
                match_at(self.map, search, candidates.matches, position)
                for position in range(len(candidates.matches))
            ),
            match_at(self.map, search, candidates.away) if len(candidates.away) else None,
            search.segments,
            verdict,
            deviation_of(self.map, search, candidates.matches),
            candidates.ratio,
        )

    def compare(self, signatures: Sequence[Signature], row: int) -> Neighbours:
        """Compare a scan's signatures with one scan of the map.

        Raises:
            StaleSignature: If one names neither this revision nor a basis that it has.
            UnknownSegment: If the map, or the basis that it names, has no such segment.
            InvalidSignature: If none is of the scan's segment, or as in `localize_signatures`.
            InvalidParameters: If the map has no such row.
        """
        if not 0 <= row < len(self.map):
            raise InvalidParameters(f"row is {row}, the map has 0..{len(self.map) - 1}")
        among = np.zeros(len(self.map), dtype=np.bool_)
        among[row] = True
        found = self.search(signatures).nearest(1, among)
        if not len(found):
            segment = self.map.model.segment_of_scan[row]
            raise InvalidSignature(f"the scan is of segment {segment}, none of the signatures is")
        return found

    def search(self, signatures: Sequence[Signature]) -> Search:
        """Compare one scan's signatures with the map's, and answer nothing yet.

        Raises:
            StaleSignature: If one was made with another revision's bases.
            UnknownSegment: If the map has no such segment.
            InvalidSignature: As `localize_signatures` does.
        """
        self._require_answerable(signatures)
        return self.map.model.search(signatures)

    def _require_answerable(self, signatures: Sequence[Signature]) -> None:
        if not signatures:
            raise InvalidSignature("there is no signature to search with")
        for shape in {signature.values.shape for signature in signatures}:
            if shape != self.map.parameters.ranks:
                raise InvalidSignature(
                    f"the signature has shape {shape}, this map's have {self.map.parameters.ranks}"
                )
        for named in {signature.revision for signature in signatures}:
            held, segments = self._held(named), self.map.model.segments
            for signature in signatures:
                # Beyond, the map has no such segment itself.
                if signature.revision == named and held <= (signature.segment or 0) < segments:
                    raise UnknownSegment(
                        f"basis {named} is of segments 0..{held - 1}, the signature of"
                        f" {signature.segment}"
                    )

    def _held(self, named: str) -> int:
        """Return how many segments' bases that revision or basis has."""
        if not self.answers(named):
            raise StaleSignature(
                f"the signature was made with revision or basis {named or '(none)'}, this one is"
                f" {self.map.revision} with basis {self.map.basis_digest}"
            )
        if self.map.revision.startswith(named):
            return self.map.model.segments
        return [digest.startswith(named) for digest in self.map.basis_digests].index(True) + 1

    def answers(self, named: str) -> bool:
        """Return whether signatures that name this revision or basis can be answered here.

        Args:
            named: A digest of 64 hexadecimal digits, or at least its first 16.
        """
        if len(named) < 2 * REVISION_PREFIX_BYTES:
            return False
        own = (self.map.revision, *self.map.basis_digests)
        return any(digest.startswith(named) for digest in own)
