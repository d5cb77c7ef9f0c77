"""The images of a study of a drive: of the mapped scans, and of the queries."""

from dataclasses import dataclass, replace

import numpy as np

from core.arrays import BoolArray, Float32Array, IntArray, frozen
from core.errors import InvalidParameters
from core.evaluation.query_set import QuerySet, hold_out
from core.evaluation.split import Split
from core.mapping.pipeline import DriveImages, project_scans
from core.parameters import MapParameters
from core.progress import NO_PROGRESS, Progress
from core.projection.probe import spread_evenly
from core.scans.drive import Drive
from core.scans.scan import Scan


def held_out_scans(drive: Drive, split: Split, most: int) -> tuple[BoolArray, IntArray]:
    """Return which scans are not mapped, `(K,)`, and which of those are queries, rising.

    The drive is split as a whole: the same scans are held out with any segments. At most `most` of
    them are queries, spread evenly.

    Raises:
        InvalidParameters: If nothing is held out or nothing is left to map.
    """
    held_out = hold_out(split, np.array([0, len(drive)]))
    return held_out, spread_evenly(np.flatnonzero(held_out), most)


@dataclass(frozen=True, eq=False)
class QueryImages:
    """A drive's mapped images and those of its queries, made alike.

    Attributes:
        parameters: How images are made; the ranks are not used here.
        mapped: The mapped scans' images.
        queries: The scans that are queried, usable under every condition.
        cells: `(C, n, I, J)` float32, their images under each of the C conditions.
        refused: Scans that had no image under some condition.
    """

    parameters: MapParameters
    mapped: DriveImages
    queries: QuerySet
    cells: Float32Array
    refused: tuple[int, ...]

    @classmethod
    def of_drive(
        cls,
        held_out: BoolArray,
        queries: QuerySet,
        parameters: MapParameters,
        progress: Progress = NO_PROGRESS,
    ) -> "QueryImages":
        """Read and project a drive once.

        Raises:
            EmptyDrive: If no mapped scan is usable.
            InvalidParameters: If no query is.
        """
        mapped = project_scans(queries.drive, np.flatnonzero(~held_out), parameters, progress)

        def image(_: int, scan: Scan) -> Float32Array:
            return parameters.imager.image(scan).cells

        (images,) = queries.answers([image], "querying", progress)
        usable = np.all([[cells is not None for cells in row] for row in images], axis=0)
        if not usable.any():
            raise InvalidParameters(f"not one of the {len(queries)} held-out scans is usable")
        cells = [[row[i] for i in np.flatnonzero(usable).tolist()] for row in images]
        return cls(
            parameters,
            mapped,
            replace(queries, scans=queries.scans[usable]),
            frozen(np.array(cells), np.float32),
            tuple(queries.scans[~usable].tolist()),
        )
