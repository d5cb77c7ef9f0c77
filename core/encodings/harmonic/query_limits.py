"""Limits of harmonic queries: fewer numbers, a narrow view, a short reach.

Wrong places are nearer within them, by more than what a calibration knows of. They come in few
classes, so that there are few to measure (docs/decisions/0011-trust.md).
"""

from collections.abc import Iterable

import numpy as np

from core.arrays import Complex64Array
from core.encodings.harmonic.window import window_of
from core.encodings.harmonics import two_sided
from core.encodings.search import QueryLimits
from core.encodings.signature import Signature
from core.projection.visibility import SECTORS, View

_STEP, _LEAST_HIDDEN = 5, 45  # sectors
_LITTLE_REACH = 0.25  # of the rings
_WEIGHT_OF_SECTORS = 0.5  # docs/reference/trust-measurements.md#views-of-little
_LEAST_HIDDEN_OF_SCAN = 40  # docs/reference/trust-measurements.md#scans-of-little
_WEIGHT_OF_A_THIRD = 2.0 / 3.0  # the same; of a half of the view it is none, of a quarter all


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


def limits_of_scan(ranks: tuple[int, int], view: View) -> QueryLimits | None:
    """Return what a scan is limited to that is compared cell by cell, `None` if it sees enough.

    Sectors are hidden from two thirds of them on, in the classes of `limits_of`. Of two
    thirds two thirds of what is measured applies.

    Args:
        ranks: `(r1, r2)` numbers of its signature.
        view: What it saw.
    """
    hidden = _STEP * round(len(view.hidden) / _STEP)
    if hidden < _LEAST_HIDDEN_OF_SCAN:
        return None
    return QueryLimits(
        ranks,
        View(tuple(range(min(hidden, SECTORS - _STEP)))),
        _WEIGHT_OF_A_THIRD if hidden < _LEAST_HIDDEN else 1.0,
    )


def narrowed(hidden: Iterable[int], view: View, turned: int) -> tuple[int, ...] | None:
    """Return the hidden sectors of a scan that sees no more than a view, `None` if it sees nothing.

    Args:
        hidden: The sectors that the scan does not see.
        view: A view, of whose hidden sectors the number counts.
        turned: By how many sectors they are turned: those after them stay first.

    Examples:
        >>> hidden = narrowed([1], View(tuple(range(57))), turned=2)
        >>> sorted(set(range(60)) - set(hidden))
        [0, 2, 59]
    """
    own, first = set(hidden), turned + len(view.hidden)
    around = ((first + sector) % SECTORS for sector in range(SECTORS))
    left = [sector for sector in around if sector not in own][: SECTORS - len(view.hidden)]
    return tuple(sorted(set(range(SECTORS)).difference(left))) if left else None


def within(recorded: Complex64Array, view: View, columns: int, sent: int) -> Complex64Array:
    """Return `sent` harmonics of what a view leaves of a recorded signature, `(r1, sent)`.

    Args:
        recorded: `(r1, r2)` of all kept harmonics.
        view: The view.
        columns: J, how many azimuths an image has.
        sent: At most as many as are kept.
    """
    left = window_of(view, columns, sent).mixing(recorded.shape[1])
    values = (two_sided(recorded) @ left.T)[:, sent - 1 :].astype(np.complex64)
    values.imag[:, 0] = 0.0
    return values


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
    sectors = narrowed(hidden, limits.view, turned)
    if sectors is None:
        return None
    sent = limits.ranks[1]
    view = View(sectors, limits.view.rings)
    values = within(recorded, view, columns, sent) if limits.view.hidden else recorded
    return Signature(values[:, :sent], None, named, view=view)
