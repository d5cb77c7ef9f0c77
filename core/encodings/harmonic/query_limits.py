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
from core.projection.visibility import FULL_VIEW, MOST_RINGS, SECTORS, View

_STEP, _STEP_OF_SHORT = 5, 10  # sectors
_REACHES = 8  # classes of reach, of which the shortest two are divided ring by ring
_LITTLE = 0.25  # of the cells of an image
_ROUNDING = 1e-9
_WEIGHT_OF_SECTORS = 0.5  # docs/reference/trust-measurements.md#views-of-little
_LITTLE_OF_SCAN = 1.0 / 3.0  # docs/reference/trust-measurements.md#scans-of-little
_WEIGHT_OF_A_THIRD = 2.0 / 3.0  # the same; of a half of the view it is none, of a quarter all


def limits_of(
    shape: tuple[int, ...], usual: tuple[int, int], view: View, rings: int
) -> QueryLimits | None:
    """Return what a signature is limited to, `None` if its map is calibrated for it.

    Fewer numbers than usual count as a square of them, and a view if it sees a quarter of the cells
    or less. Of hidden sectors alone half of a rescaling applies: `Search.evidence` accounts for the
    rest.

    Args:
        shape: `(r1, r2)` numbers that it has.
        usual: The numbers that the map's queries of such a view have.
        view: What its scan saw.
        rings: How many the map's images have.
    """
    least = min(shape)
    has_all = shape[0] >= usual[0] and shape[1] >= usual[1]
    seen = _class_of(view, rings)
    if seen.share_of(rings) > _LITTLE:
        seen = FULL_VIEW
    if has_all and seen.is_full:
        return None
    return QueryLimits(
        usual if has_all else (least, least),
        seen,
        _WEIGHT_OF_SECTORS if has_all and seen.rings is None else 1.0,
    )


def limits_of_scan(ranks: tuple[int, int], view: View, rings: int) -> QueryLimits | None:
    """Return what a scan is limited to that is compared cell by cell, `None` if it sees enough.

    It is limited if sectors are hidden and it sees a third of the cells or less; a short reach
    alone does not bring wrong places nearer. Of a third two thirds of what is measured applies.

    Args:
        ranks: `(r1, r2)` numbers of its signature.
        view: What it saw.
        rings: How many the map's images have.
    """
    seen = _class_of(view, rings)
    share = seen.share_of(rings)
    if not seen.hidden or share > _LITTLE_OF_SCAN + _ROUNDING:
        return None
    return QueryLimits(ranks, seen, 1.0 if share <= _LITTLE else _WEIGHT_OF_A_THIRD)


def _class_of(view: View, rings: int) -> View:
    """Return a view of about as many sectors and rings, one of few."""
    step = _STEP if view.rings is None else _STEP_OF_SHORT
    hidden = min(step * round(len(view.hidden) / step), SECTORS - step)
    reach = view.rings
    if reach is not None and reach > _LITTLE * rings:
        reach = min(round(round(_REACHES * reach / rings) * rings / _REACHES), MOST_RINGS)
    return View(tuple(range(hidden)), reach)


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
        limits: The limits of the signature.
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
