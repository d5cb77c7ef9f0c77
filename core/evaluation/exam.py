"""The images that a study of a drive works with: of the mapped scans, and of those held out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from core.arrays import BoolArray, Float32Array, IntArray, frozen
from core.errors import InvalidParameters, InvalidScan
from core.evaluation.condition import Condition
from core.evaluation.split import Split
from core.mapping.pipeline import DriveImages, project_scans
from core.parameters import MapParameters
from core.progress import NO_PROGRESS, Progress
from core.scans.drive import Drive

__all__ = ["Exam", "held_out_scans"]


def held_out_scans(drive: Drive, split: Split, most: int | None) -> tuple[BoolArray, IntArray]:
    """Return which scans are not mapped, `(K,)`, and which of those are asked, rising.

    The drive is split as one: whatever its segments, the same scans are held out. At most `most`
    of them are asked, spread evenly.

    Raises:
        InvalidParameters: If nothing is held out or nothing is left to map.
    """
    held_out = split.held_out(np.array([0, len(drive)]))
    scans = np.flatnonzero(held_out)
    if not len(scans) or held_out.all():
        raise InvalidParameters(
            f"{split} holds {len(scans)} of {len(drive)} scans out: some must be asked, some mapped"
        )
    if most is not None and most < len(scans):
        scans = scans[np.linspace(0, len(scans) - 1, most).round().astype(np.int64)]
    return held_out, scans


@dataclass(frozen=True, eq=False)
class Exam:
    """A drive's mapped images and its questions, in one way to make images.

    Attributes:
        parameters: How images are made; the ranks are not used here.
        scans: K, how many scans the drive has.
        mapped: The mapped scans' images.
        asked: `(n,)` the scans that are asked, usable under every condition.
        conditions: The C disturbances they are asked under.
        questions: `(C, n, I, J)` float32, their images.
        refused: Scans that had no image under some condition.
    """

    parameters: MapParameters
    scans: int
    mapped: DriveImages
    asked: IntArray
    conditions: tuple[Condition, ...]
    questions: Float32Array
    refused: tuple[int, ...]

    @classmethod
    def of_drive(
        cls,
        drive: Drive,
        held_out: BoolArray,
        asked: IntArray,
        parameters: MapParameters,
        conditions: Sequence[Condition],
        *,
        seed: int = 0,
        progress: Progress = NO_PROGRESS,
    ) -> "Exam":
        """Read and project a drive once.

        Raises:
            EmptyDrive: If no mapped scan is usable.
            InvalidParameters: If no scan that is asked is.
        """
        mapped = project_scans(drive, np.flatnonzero(~held_out), parameters, progress)
        progress.start("asking", len(asked))
        usable: list[int] = []
        images: list[Float32Array] = []
        for index in asked.tolist():
            try:
                scan = drive.scan(index)
                images.append(
                    np.stack(
                        [
                            parameters.imager.image(
                                condition.apply(scan, np.random.default_rng([seed, index]))
                            ).cells
                            for condition in conditions
                        ]
                    )
                )
                usable.append(index)
            except InvalidScan:
                pass
            progress.advance()
        if not usable:
            raise InvalidParameters(f"not one of the {len(asked)} scans held out can be asked")
        return cls(
            parameters=parameters,
            scans=len(drive),
            mapped=mapped,
            asked=np.array(usable, dtype=np.int64),
            conditions=tuple(conditions),
            questions=frozen(np.stack(images, axis=1), np.float32),
            refused=tuple(sorted(set(asked.tolist()) - set(usable))),
        )
