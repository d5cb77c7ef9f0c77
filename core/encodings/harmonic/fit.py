"""The fit of a harmonic map: its radial basis, and the signatures of all renderings."""

import itertools
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from core.arrays import Float32Array, FloatArray, IntArray
from core.encodings.basis import Basis
from core.encodings.blocks import read_blocks
from core.encodings.distance import Distance
from core.encodings.grams import drive_gram, fit_radial_basis
from core.encodings.harmonic.basis import HarmonicBasis
from core.encodings.harmonic.codes import SignatureCodes
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonic.stored import StoredSignatures
from core.encodings.harmonics import encode, energy, kept_ranks
from core.errors import InvalidParameters
from core.progress import Progress
from core.projection.imager import Views
from core.projection.images import ImageSource
from core.projection.rings import RingGrid
from core.projection.small_image import small_image
from core.projection.visibility import bits_of_hidden
from core.scans.stands import first_of_stands
from core.scans.trajectory import Trajectory

if TYPE_CHECKING:
    from core.parameters import MapParameters


def fit(
    images: ImageSource,
    trajectory: Trajectory,
    segment_start: IntArray,
    parameters: "MapParameters",
    progress: Progress,
    kept: Basis | None = None,
    grams: Mapping[str, FloatArray] | None = None,
) -> tuple[HarmonicModel, FloatArray]:
    """Fit one radial basis to all renderings of all scans unless it is kept, and encode them.

    Of a stand only the first scan counts for the basis.

    A segment's relative error is sqrt(1 - sum |G|^2 / sum |S|^2) over its scans' renderings,
    |G| in the weighted norm: U and the harmonics are orthonormal, so that is what they leave
    out.
    """
    one_pass = kept is not None or grams is not None
    progress.start("fitting", len(images) if one_pass else 2 * len(images))
    if isinstance(kept, HarmonicBasis):
        u = kept.radial_basis
    else:
        u = _fit_basis(images, trajectory, parameters, progress, grams)
    columns, (r1, r2) = parameters.grid.columns, kept_ranks(parameters)
    shape = parameters.imager.shape
    codes = np.empty((2 * r2 - 1, r1, shape[0], len(images)), np.int8)
    scales = np.empty((len(images), shape[0]), np.float32)
    hidden = None if parameters.views == Views.FULL else np.zeros(scales.shape, np.int64)
    small: list[NDArray[np.uint8]] = []
    offsets_m = np.array(parameters.lateral_renderings_m)
    on_line = int(np.abs(offsets_m).argmin())
    errors = np.zeros(len(segment_start) - 1)
    for segment, (start, end) in enumerate(itertools.pairwise(segment_start.tolist())):
        covered = whole = 0.0
        for first, block in read_blocks(images, start, end, shape, progress):
            seen = np.maximum(block, 0.0)
            encoded = encode(seen, u, r2)
            rows = slice(first, first + len(block))
            coded = SignatureCodes.of(encoded.astype(np.complex64))
            codes[..., rows], scales[rows] = coded.codes, coded.scales
            if hidden is not None:
                hidden[rows] = bits_of_hidden(block)
            if parameters.verification_images:
                small.append(small_image(block[:, on_line]))
            covered += float(energy(encoded, columns).sum())
            whole += float(np.square(seen, dtype=np.float64).sum())
        if whole > 0.0:
            errors[segment] = np.sqrt(max(0.0, 1.0 - covered / whole))
    stored = SignatureCodes(codes, scales)
    images_kept = np.concatenate(small) if small else None
    model = model_of(u, stored, offsets_m, segment_start, parameters, hidden, images_kept)
    return model, errors


def _fit_basis(
    images: ImageSource,
    trajectory: Trajectory,
    parameters: "MapParameters",
    progress: Progress,
    grams: Mapping[str, FloatArray] | None,
) -> Float32Array:
    rows = parameters.grid.rows
    if grams is None:
        spans = itertools.pairwise(trajectory.drive_start.tolist())
        grams = {
            name: drive_gram(images, start, first_of_stands(trajectory.poses[start:end]), progress)
            for name, (start, end) in zip(trajectory.drives, spans, strict=True)
        }
    if set(grams) != set(trajectory.drives):
        raise InvalidParameters(
            f"the sums are of drives {sorted(grams)}, wanted {sorted(trajectory.drives)}"
        )
    for name, gram in grams.items():
        if gram.shape != (rows, rows):
            raise InvalidParameters(f"the sum of drive {name} is {gram.shape}, wanted {rows} rows")
    return fit_radial_basis(grams, kept_ranks(parameters)[0])


def model_of(
    u: Float32Array,
    stored: StoredSignatures,
    offsets_m: FloatArray,
    segment_start: IntArray,
    parameters: "MapParameters",
    hidden: IntArray | None,
    small: NDArray[np.uint8] | None = None,
) -> HarmonicModel:
    """Return the model of a basis and the signatures of all scans.

    Args:
        u: `(rows, r1)` radial basis.
        stored: The signatures of all renderings.
        offsets_m: Lateral offsets of the renderings.
        segment_start: `(L + 1,)` rows where segments begin, and K.
        parameters: Those of the map.
        hidden: Hidden sectors of each rendering, as bits; `None` in a map of full views.
        small: Verification images, if the map has them.
    """
    measure = parameters.distance or Distance.NORMALISED  # parameters always have one
    grid = parameters.grid
    ring_m = grid.ring_m if isinstance(grid, RingGrid) else 1.0
    return HarmonicModel(
        u,
        stored,
        offsets_m,
        segment_start,
        grid.columns,
        measure,
        parameters.ranks,
        hidden,
        small,
        ring_m,
    )
