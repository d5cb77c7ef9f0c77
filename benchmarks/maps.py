"""Maps and methods that benchmarks query: of some scans of a drive, or random ones."""

from typing import Any

import numpy as np

from core.arrays import IntArray
from core.encodings.basis import Basis
from core.encodings.paper.model import PaperModel
from core.evaluation.methods import Enrolled, Method
from core.localization.localizer import Localizer
from core.mapping.pipeline import build, project_scans
from core.mapping.tensormap import TensorMap
from core.parameters import MapParameters
from core.progress import NO_PROGRESS, Progress
from core.projection.probe import PROBES
from core.scans.drive import Drive
from core.scans.trajectory import Trajectory
from core.segmentation.fixed import cut_fixed, segment_length_for
from core.topology import join_segments


class Once:
    """A method that enrols one drive once and keeps the result.

    Args:
        method: The method.
        name: Another name than its own.
    """

    def __init__(self, method: Method, name: str | None = None) -> None:
        self._method = method
        self._enrolled: Enrolled | None = None
        self.name = name or method.name

    def configuration(self) -> dict[str, Any]:
        """Return the method's."""
        return self._method.configuration()

    def enrol(self, drive: Drive, scans: IntArray, progress: Progress = NO_PROGRESS) -> Enrolled:
        """Enrol the scans, or return what was enrolled."""
        if self._enrolled is None:
            self._enrolled = self._method.enrol(drive, scans, progress)
        return self._enrolled


def localizer_of(
    drive: Drive,
    rows: IntArray,
    parameters: MapParameters,
    *,
    segments: int | None = None,
    kept: Basis | None = None,
    calibrated: bool = False,
) -> Localizer:
    """Return the localizer of a map of the scans `rows`, cut over these and nowhere else."""
    cuts = cut_fixed(len(rows), segment_length_for(len(rows), segments=segments))
    made = build(
        [drive],
        parameters,
        lambda _: project_scans(drive, rows, parameters, most_probes=PROBES if calibrated else 0),
        segment_start=np.append(rows[cuts[:-1]], len(drive)),
        kept=kept,
        calibrated=calibrated,
    )
    return Localizer(made.tensor_map)


def random_paper_map(segments: int, scans_a_segment: int, *, poses: bool) -> TensorMap:
    """Return a paper map of random orthonormal bases and signatures."""
    parameters = MapParameters()
    scans = segments * scans_a_segment
    rng = np.random.default_rng(0)
    (rows, columns), (r1, r2) = parameters.grid.shape, parameters.ranks
    u, v = (
        np.linalg.qr(rng.normal(size=(segments, n, r)))[0] for n, r in ((rows, r1), (columns, r2))
    )
    rows_of_poses = np.full((scans, 7), np.nan)
    if poses:
        rows_of_poses[:] = 0.0
        rows_of_poses[:, 0], rows_of_poses[:, 6] = np.arange(scans), 1.0
    trajectory = Trajectory.of_drive(
        "d", np.arange(scans, dtype=np.float64), rows_of_poses, np.arange(scans)
    )
    cuts = cut_fixed(scans, scans_a_segment)
    return TensorMap(
        parameters,
        PaperModel(u, v, rng.normal(size=(scans, r1, r2)).astype(np.float32), cuts),
        trajectory,
        join_segments(trajectory, cuts),
        np.full(segments, 0.5),
    )
