"""The answer of several maps, and why the others were not searched."""

# `tensormap where` prints it: import no database and no HTTP here, 0.6 s of each start.
from dataclasses import dataclass
from enum import StrEnum

from core.localization.all_maps import AllMapsLocalization


class Reason(StrEnum):
    """Why a map was not searched."""

    NO_LIVE_REVISION = "no_live_revision"
    OTHER_BASIS = "other_basis"
    NOT_INDEXED = "not_indexed"
    DAMAGED = "damaged"


@dataclass(frozen=True)
class AllMapsAnswer:
    """An answer, and what it was searched in.

    Attributes:
        found: The answer.
        searched: How many maps were searched.
        not_searched: The other maps that the key may see, in the order of their names, and why.
        notes: Notes on the query.
    """

    found: AllMapsLocalization
    searched: int
    not_searched: tuple[tuple[str, Reason], ...]
    notes: tuple[str, ...] = ()
