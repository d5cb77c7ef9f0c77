"""Maps of some scans of a drive, as benchmarks query them."""

import numpy as np

from core.arrays import IntArray
from core.encodings.basis import Basis
from core.localization.localizer import Localizer
from core.mapping.pipeline import build, project_scans
from core.parameters import MapParameters
from core.scans.drive import Drive
from core.segmentation.fixed import cut_fixed, segment_length_for


def localizer_of(
    drive: Drive,
    rows: IntArray,
    parameters: MapParameters,
    *,
    segments: int | None = None,
    kept: Basis | None = None,
    calibrated: bool = False,
) -> Localizer:
    """Return what localizes in a map of the scans `rows`, cut over these and nowhere else."""
    cuts = cut_fixed(len(rows), segment_length_for(len(rows), segments=segments))
    made = build(
        [drive],
        parameters,
        lambda _: project_scans(drive, rows, parameters),
        segment_start=np.append(rows[cuts[:-1]], len(drive)),
        kept=kept,
        calibrated=calibrated,
    )
    return Localizer(made.tensor_map)
