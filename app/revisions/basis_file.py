"""A basis as a NumPy file, for vehicles."""

import io
import json

import numpy as np

from core.encodings.basis import Basis

NPZ = "application/vnd.tensormap.basis+npz"
"""Its media type."""


def basis_file(basis: Basis, least_cells: int | None = None) -> bytes:
    """Return the `.npz` file of a basis: its arrays, revision, digest and parameters.

    Args:
        basis: The basis.
        least_cells: The map's, `None` of a shared basis.
    """
    file = io.BytesIO()
    of_map = {} if least_cells is None else {"least_cells": np.array(least_cells)}
    np.savez(
        file,
        # None of the arrays is named allow_pickle.
        **basis.arrays(),  # type: ignore[arg-type]
        revision=np.array(basis.revision),
        basis=np.array(basis.digest),
        parameters=np.array(json.dumps(basis.parameters.as_attributes())),
        **of_map,  # type: ignore[arg-type]
    )
    return file.getvalue()
