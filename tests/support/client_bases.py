"""Bases of maps of all kinds, as the service makes them and as its client reads them."""

import numpy as np
from tensormap_client import Basis as ClientBasis

from app.revisions.basis_file import basis_file
from core.encodings.basis import Basis
from core.encodings.harmonic.basis import HarmonicBasis
from core.encodings.harmonics import encode, kept_ranks
from core.encodings.paper.basis import PaperBasis
from core.encodings.signature import Signature, pack_signatures
from core.parameters import MapParameters
from core.projection.imager import Image, ImageKind, Views
from core.projection.reducer import Reducer

_SEGMENTS = 3  # of a map in the paper's encoding

PARAMETERS = {
    "default": MapParameters.for_sensor(),
    "default, mean": MapParameters.for_sensor(reducer=Reducer.MEAN),
    "any, 5 x 5": MapParameters.for_sensor(ranks=(5, 5), views=Views.ANY),
    "full heights": MapParameters.for_sensor(views=Views.FULL, verification_images=False),
    "full heights, mean": MapParameters.for_sensor(
        views=Views.FULL, reducer=Reducer.MEAN, verification_images=False
    ),
    **{
        f"harmonic ranges, {reducer}": MapParameters.for_sensor(
            image=ImageKind.RANGE, reducer=reducer
        )
        for reducer in (Reducer.MEAN, Reducer.NEAREST, Reducer.FARTHEST, Reducer.LAST)
    },
    **{
        f"paper, {reducer}": MapParameters.for_sensor(encoding="paper", reducer=reducer)
        for reducer in (Reducer.LAST, Reducer.MEAN, Reducer.NEAREST)
    },
    "paper, hdl-32e": MapParameters.for_sensor("hdl-32e", encoding="paper", sensor_height_m=0.95),
}
"""Parameters of maps, by what is special about them."""


def basis_of(parameters: MapParameters) -> Basis:
    """Return a basis of any orthonormal columns."""
    rng = np.random.default_rng(7)
    rows, columns = parameters.grid.shape

    def basis(size, rank):
        return np.linalg.qr(rng.normal(size=(size, rank)))[0].astype(np.float32)

    if parameters.encoding == "harmonic":
        return HarmonicBasis.of(parameters, basis(rows, kept_ranks(parameters)[0]))
    r1, r2 = parameters.ranks
    u = np.stack([basis(rows, r1) for _ in range(_SEGMENTS)])
    v = np.stack([basis(columns, r2) for _ in range(_SEGMENTS)])
    return PaperBasis("", "0f" * 32, parameters, np.arange(_SEGMENTS), u, v)


def all_numbers(basis: Basis, image: Image) -> bytes:
    """Return the packed signature of an image with all numbers that maps of any views keep."""
    assert isinstance(basis, HarmonicBasis)
    view, r2 = basis.view(image), kept_ranks(basis.parameters)[1]
    values = encode(image.seen[: view.rings], basis.radial_basis[: view.rings], r2)
    whole = Signature(values.astype(np.complex64), None, basis.digest, view=view)
    return pack_signatures([whole])


def as_downloaded(basis: Basis, least_cells: int | None = None) -> ClientBasis:
    """Return a basis as a client reads what the service answers, with that of its map."""
    return ClientBasis.from_npz(basis_file(basis, least_cells))
