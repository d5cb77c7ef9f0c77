"""The results of a study of a drive, which a report shows (paper, sec. 3)."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from core.arrays import BoolArray, FloatArray, IntArray
from core.encodings.compression import Compression
from core.evaluation.advisor import Advice
from core.evaluation.condition import Condition
from core.evaluation.plain import Plain, plain
from core.evaluation.sweep import Sweep
from core.numbers import none_if_nan
from core.parameters import MapParameters
from core.projection.images import Skipped
from core.scans.path import path_length_m


@dataclass(frozen=True, eq=False)
class Answers(Plain):
    """The answers of a map to the undisturbed queries, row by row.

    Attributes:
        scan: The scans that were queried.
        segment: The queries' true segments.
        matched_scan: The matched map scans.
        matched_segment: The segments of these.
        distance_m: How far apart the two were recorded, NaN where unknown.
        right: Which answers are right, by the study's criterion.
        other_pass: Which of them are of another pass through the same place.
        standing: Which scans were recorded while stationary.
    """

    scan: IntArray
    segment: IntArray
    matched_scan: IntArray
    matched_segment: IntArray
    distance_m: FloatArray
    right: BoolArray
    other_pass: BoolArray
    standing: BoolArray

    @property
    def wrong_segment(self) -> BoolArray:
        """Which were matched on a wrong segment."""
        return np.asarray(self.segment != self.matched_segment)

    def confusion(self, segments: int) -> IntArray:
        """Return how often segment `i` was matched as `j`, `(L, L)`, stationary scans included."""
        counts = np.zeros((segments, segments), dtype=np.int64)
        np.add.at(counts, (self.segment, self.matched_segment), 1)
        return counts

    def confused(self) -> list[tuple[int, int, int]]:
        """Return the cells of `confusion` that are not 0: true segment, matched one, how often."""
        pairs = np.stack([self.segment, self.matched_segment], axis=1)
        cells, counts = np.unique(pairs, axis=0, return_counts=True)
        return [(i, j, n) for (i, j), n in zip(cells.tolist(), counts.tolist(), strict=True)]


@dataclass(frozen=True)
class CurvePoint(Plain):
    """Accuracy under one disturbance.

    Attributes:
        condition: The disturbance.
        counted: Answers that count.
        right: How many of them are right.
        on_segment: How many are on the right segment.
    """

    condition: Condition
    counted: int
    right: int
    on_segment: int


@dataclass(frozen=True, eq=False)
class EncodingStudy(Plain):
    """A drive in one encoding.

    Attributes:
        parameters: The parameters of the map whose answers are shown, ranks included.
        sweep: All candidates.
        advice: Which one to take.
        segment_length: k of the map that is shown.
        segment_start: `(L + 1,)` the drive's scans where its segments begin, and K.
        recommended: Whether that map is the recommended candidate.
        relative_error: `(L,)` of its segments.
        compression: The compression of that map.
        answers: The answers to the scans held out, as driven.
        curves: Accuracy under each disturbance.
        refused: Scans held out that could not be queried.
    """

    parameters: MapParameters
    segment_length: int
    segment_start: IntArray
    recommended: bool
    advice: Advice
    sweep: Sweep
    relative_error: FloatArray
    compression: Compression
    answers: Answers
    curves: tuple[CurvePoint, ...]
    refused: tuple[int, ...]

    @property
    def name(self) -> str:
        """The encoding's name."""
        return self.parameters.encoding

    @property
    def segments(self) -> int:
        """L of the map that is shown."""
        return len(self.segment_start) - 1

    def curve(self, quantity: str) -> tuple[CurvePoint, ...]:
        """Return the points along one disturbance, the others 0, by rising value."""
        others = {"yaw_deg", "lateral_m", "noise_m"} - {quantity}
        along = [p for p in self.curves if not any(getattr(p.condition, o) for o in others)]
        return tuple(sorted(along, key=lambda p: float(getattr(p.condition, quantity))))

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        found = super().as_dict()
        last = {name: found.pop(name) for name in ("curves", "refused")}
        found["parameters"] = self.parameters.as_attributes()
        found["confusion"] = [list(cell) for cell in self.answers.confused()]
        return found | last


@dataclass(frozen=True, eq=False)
class Study:
    """The results of a drive.

    Attributes:
        drive: The drive's name.
        timestamp_s: `(K,)`.
        poses: `(K, 7)`.
        surrogate: `(K,)` the paper's norm of the 6-DOF change, NaN where unknown.
        standing: `(K,)` recorded while stationary.
        split: How scans were held out.
        criterion: What counts as a right answer.
        seed: The noise's seed.
        skipped: Mapped scans that could not be used, and why.
        encodings: The results of each.
    """

    drive: str
    timestamp_s: FloatArray
    poses: FloatArray
    surrogate: FloatArray
    standing: BoolArray
    split: str
    criterion: str
    seed: int
    skipped: tuple[Skipped, ...]
    encodings: tuple[EncodingStudy, ...]

    @property
    def scans(self) -> int:
        """K."""
        return len(self.poses)

    @property
    def length_m(self) -> float | None:
        """Length of the path, `None` where a pose is unknown."""
        return none_if_nan(path_length_m(self.poses))

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        return {
            "drive": self.drive,
            "scans": self.scans,
            "length_m": self.length_m,
            "split": self.split,
            "criterion": self.criterion,
            "seed": self.seed,
            "skipped": plain(self.skipped),
            "timestamp_s": plain(self.timestamp_s),
            "position_m": plain(self.poses[:, :3]),
            "motion_surrogate": plain(self.surrogate),
            "standing": plain(self.standing),
            "encodings": plain(self.encodings),
        }
