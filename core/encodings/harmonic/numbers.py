"""The signatures of a map as complex numbers, as files of older versions have them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.arrays import Complex64Array, Float32Array, IntArray, freeze
from core.encodings.harmonic.codes import SignatureCodes
from core.encodings.harmonic.stored import StoredSignatures
from core.encodings.model import require_sane
from core.errors import InvalidMap


@dataclass(frozen=True, eq=False)
class SignatureNumbers(StoredSignatures):
    """Signatures as they are.

    Attributes:
        values: `(K, D, r1, r2)` complex64, the first column real.
    """

    values: Complex64Array

    def __post_init__(self) -> None:
        freeze(self, values=np.complex64)
        if self.values.ndim != 4:
            raise InvalidMap("signatures have four axes")
        require_sane({}, self.values)
        if self.values[..., :1].imag.any():
            raise InvalidMap("the first column of a harmonic signature is real")

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """`(K, D, r1, r2)`."""
        scans, renderings, r1, r2 = self.values.shape
        return scans, renderings, r1, r2

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the one array."""
        return {"signatures": self.values}

    @property
    def numbers(self) -> Complex64Array:
        """All of them as they are."""
        return self.values

    def at(self, rows: IntArray, renderings: IntArray | None = None) -> Complex64Array:
        """Return the signatures of some renderings."""
        return self.values[rows] if renderings is None else self.values[rows[:, None], renderings]

    def select(self, rows: IntArray) -> "SignatureNumbers":
        """Return those of some scans."""
        return SignatureNumbers(self.values[rows])

    def limited(self, r1: int) -> "SignatureNumbers":
        """Return the first radial components."""
        return SignatureNumbers(self.values[:, :, :r1])

    def mixed(self, mixing: Float32Array) -> "SignatureNumbers":
        """Return the products."""
        return SignatureNumbers(mixing @ self.values)

    def joined(self, others: Sequence[StoredSignatures]) -> StoredSignatures:
        """Return numbers where all are, else codes."""
        numbers = [one for one in others if isinstance(one, SignatureNumbers)]
        if len(numbers) < len(others):
            return self.as_codes().joined(others)
        return SignatureNumbers(np.concatenate([one.values for one in (self, *numbers)]))

    def as_codes(self) -> SignatureCodes:
        """Round them."""
        return SignatureCodes.of(self.values)
