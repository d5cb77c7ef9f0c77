"""A scan query at a scan of the map, by the small image that the map keeps of it."""

from typing import TYPE_CHECKING

import numpy as np

from core.encodings.harmonic.query_limits import narrowed, within
from core.encodings.harmonic.verified_search import VerifiedSearch
from core.encodings.search import QueryLimits
from core.projection.small_image import STEPS_A_ROOT_METRE
from core.projection.visibility import HIDDEN, View, sector_of_column

if TYPE_CHECKING:
    from core.encodings.harmonic.model import HarmonicModel


def own_search(
    model: "HarmonicModel", row: int, limits: QueryLimits | None, turned: int
) -> VerifiedSearch | None:
    """Return the search of a query at one of a map's scans, of which limits leave a part.

    The query's cells are those that have the small image of the scan, and its signature has all
    kept harmonics.

    Args:
        model: The map's model.
        row: The scan's row.
        limits: What of it is searched, one of `limits_of_scan`; all of it without them.
        turned: By how many sectors the hidden ones of the limits are turned.

    Returns:
        The search; `None` of a map without small images, or if nothing is in what is left.
    """
    if model.verification_images is None:
        return None
    rows, (r1, _) = np.array([row]), model.sent_ranks if limits is None else limits.ranks
    rings = None if limits is None else limits.view.rings
    hidden = np.flatnonzero(~model.seen_on_line(rows)[0]).tolist()
    sectors = tuple(hidden) if limits is None else narrowed(hidden, limits.view, turned)
    small, sector = model.small_images(rows)[0], sector_of_column(model.columns)
    cells = (small[:, sector] / np.float32(STEPS_A_ROOT_METRE)) ** 2
    if rings is not None:
        cells[rings:] = 0.0
    cells[:, np.isin(sector, sectors or ())] = HIDDEN
    if sectors is None or not (cells > 0).any():
        return None
    view, seen = View(sectors, rings), model.seen_within(rings, r1)
    recorded = seen.renderings.at(rows, np.array([[model.on_line]]))[0, 0]
    if limits is not None:
        recorded = within(recorded, view, model.columns, limits.ranks[1])
    return VerifiedSearch(seen, recorded.astype(np.complex128), view, cells)
