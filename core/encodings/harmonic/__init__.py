"""The harmonic encoding: one radial basis for the whole map, circular harmonics in azimuth."""

from core.encodings.harmonic.basis import HarmonicBasis, harmonic_basis_digest
from core.encodings.harmonic.encoding import HarmonicEncoding
from core.encodings.harmonic.model import HarmonicModel
from core.encodings.harmonic.search import HarmonicSearch
from core.encodings.harmonics import (
    azimuth_factor,
    encode,
    energy,
    harmonic_elements,
    weights,
)

__all__ = [
    "ENCODING",
    "HarmonicBasis",
    "HarmonicEncoding",
    "HarmonicModel",
    "HarmonicSearch",
    "azimuth_factor",
    "encode",
    "energy",
    "harmonic_basis_digest",
    "harmonic_elements",
    "weights",
]

ENCODING = HarmonicEncoding()
