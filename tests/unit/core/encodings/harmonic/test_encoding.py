"""The harmonic encoding's signatures as plain values."""

import pytest

from core.encodings.harmonic.encoding import ENCODING
from core.errors import InvalidSignature


@pytest.mark.parametrize(
    ("real", "imag"),
    [([], []), ([[]], [[]]), ([[1.0, 2.0]], [[0.0]]), ([[1.0]], [[0.0], [0.0]])],
    ids=["no rows", "no numbers", "rows of two lengths", "another number of rows"],
)
def test_values_that_are_no_matrix_are_no_signature(
    real: list[list[float]], imag: list[list[float]]
) -> None:
    with pytest.raises(InvalidSignature):
        ENCODING.from_values({"values_real": real, "values_imag": imag}, "0f" * 32)
