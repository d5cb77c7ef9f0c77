"""Limits of harmonic signatures: fewer numbers, a narrow view, a short reach.

Wrong places are nearer within them, by more than what a calibration knows of. They come in few
classes, so that there are few to measure (docs/decisions/0011-trust.md).
"""

from collections.abc import Iterable

import numpy as np

from core.arrays import Complex64Array
from core.encodings.harmonic.window import window_of
from core.encodings.harmonics import two_sided
from core.encodings.model import QueryLimits
from core.encodings.signature import Signature
from core.projection.visibility import SECTORS, View

_STEP, _LEAST_HIDDEN = 5, 45  # sectors
_LITTLE_REACH = 0.25  # of the rings
_WEIGHT_OF_SECTORS = 0.5  # docs/reference/trust-measurements.md#views-of-little


def limits_of(
    shape: tuple[int, ...], usual: tuple[int, int], view: View, rings: int
) -> QueryLimits | None:
    """Return what a signature is limited to, `None` if its map is calibrated for it.

    Fewer numbers than usual count as a square of them, hidden sectors from three quarters of them
    on in steps of 30 degrees, and limits of reach from a quarter of the rings down. Of hidden
    sectors alone half of a rescaling applies: `Search.evidence` accounts for the rest.

    Args:
        shape: `(r1, r2)` numbers that it has.
        usual: The numbers that the map's queries of such a view have.
        view: What its scan saw.
        rings: How many the map's images have.
    """
    least = min(shape)
    has_all = shape[0] >= usual[0] and shape[1] >= usual[1]
    hidden = _STEP * round(len(view.hidden) / _STEP)
    if hidden < _LEAST_HIDDEN:
        hidden = 0
    is_short = view.rings is not None and view.rings <= _LITTLE_REACH * rings
    if has_all and not hidden and not is_short:
        return None
    return QueryLimits(
        usual if has_all else (least, least),
        View(tuple(range(min(hidden, SECTORS - _STEP))), view.rings if is_short else None),
        _WEIGHT_OF_SECTORS if has_all and not is_short else 1.0,
    )


def limited(
    recorded: Complex64Array,
    hidden: Iterable[int],
    limits: QueryLimits,
    turned: int,
    columns: int,
    named: str,
) -> Signature | None:
    """Return what a recorded signature would be within limits, `None` if nothing of it is left.

    Args:
        recorded: `(r1, r2)` the radial components that are sent, of all kept harmonics, within the
            reach of the limits.
        hidden: The sectors that its own scan did not see.
        limits: Of the signature.
        turned: By how many sectors the hidden ones of the limits are turned.
        columns: J, how many azimuths an image has.
        named: What the signature names.
    """
    sent, kept = limits.ranks[1], recorded.shape[1]
    sectors = {(sector + turned) % SECTORS for sector in limits.view.hidden}.union(hidden)
    if len(sectors) == SECTORS:
        return None
    view = View(tuple(sorted(sectors)), limits.view.rings)
    values = recorded
    if limits.view.hidden:
        left = window_of(view, columns, sent).mixing(kept)
        values = (two_sided(recorded) @ left.T)[:, sent - 1 :].astype(np.complex64)
        values.imag[:, 0] = 0.0
    return Signature(values[:, :sent], None, named, view=view)
