"""Bytes a scan of a map's file: signatures, and poses, times and scales.

Signatures are one byte a number: D renderings of r1 components and r2 harmonics have
r1 (2 r2 - 1) numbers each. The bars are 1.1 times that, and 90 bytes for poses, times and scales.
Of any views the file has 40 bytes more for hidden sectors, and the images that scan queries are
verified with.
"""

import sys

import h5py

from benchmarks.queried_map import ANY_VIEWS, FULL_VIEWS, queried_map
from benchmarks.results import Row, show

SIGNATURES_BAR, OTHERS_BAR_BYTES = 1.1, 90.0
_SIGNATURES, _OTHERS = ("signature_codes",), ("pose", "timestamp_s", "rendering_scales")


def measure() -> list[Row]:
    """Return the rows of a map of full views and one of the present default."""
    rows = []
    for name, parameters in {"full": FULL_VIEWS, "any": ANY_VIEWS}.items():
        queried = queried_map(parameters)
        tensor_map = queried.localizer.map
        r1, r2 = tensor_map.model.ranks
        renderings = len(tensor_map.parameters.lateral_renderings_m or (0.0,))
        scans = len(tensor_map)
        numbers = renderings * r1 * (2 * r2 - 1)
        with h5py.File(queried.path, "r", locking=False) as file:
            signatures, others = (
                sum(file[dataset].id.get_storage_size() for dataset in some) / scans
                for some in (_SIGNATURES, _OTHERS)
            )
        whole = f"whole file {queried.path.stat().st_size / scans:.0f}"
        what = f"{name}: signatures, {renderings} x {r1} x {2 * r2 - 1}, bytes a scan"
        rows.append(Row(what, signatures, SIGNATURES_BAR * numbers, whole, is_exact=True))
        what = f"{name}: poses, times and scales, bytes a scan"
        rows.append(Row(what, others, OTHERS_BAR_BYTES, whole, is_exact=True))
    return rows


if __name__ == "__main__":
    sys.exit(show(measure()))
