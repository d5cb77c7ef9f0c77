"""Retention policies of maps: which revisions are kept, for how long, and whether raw returns."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timedelta
from enum import StrEnum
from typing import Any, Literal

from core.errors import InvalidParameters

MOST_REVISIONS = 1_000_000
LONGEST_DAYS = 36_525.0


class RawScans(StrEnum):
    """Whether a scan's returns are kept once a map was built of it."""

    KEEP = "keep"
    DROP = "drop"


@dataclass(frozen=True)
class Retention:
    """What is kept; by default everything.

    A revision is removed when neither its number nor its age keeps it.

    Attributes:
        retained_revisions: How many are kept besides the live and the newest one, or `all`.
        retained_for_days: How long any is kept after it was built or, if it was live, replaced.
        raw_scans: Whether the returns that the live revision was built of are kept.

    Raises:
        InvalidParameters: If a number is not finite, or out of range.
    """

    retained_revisions: int | Literal["all"] = "all"
    retained_for_days: float = 30.0
    raw_scans: RawScans = RawScans.KEEP

    def __post_init__(self) -> None:
        count, days = self.retained_revisions, self.retained_for_days
        if count != "all" and not 0 <= count <= MOST_REVISIONS:
            raise InvalidParameters(
                f"retained_revisions is {count}, wanted 0 to {MOST_REVISIONS} or 'all'"
            )
        if not (math.isfinite(days) and 0.0 <= days <= LONGEST_DAYS):
            raise InvalidParameters(f"retained_for_days is {days}, wanted 0 to {LONGEST_DAYS:g}")


@dataclass(frozen=True)
class OwnRetention:
    """The values of a `Retention` that a map has chosen; `None` is the service's default."""

    retained_revisions: int | Literal["all"] | None = None
    retained_for_days: float | None = None
    raw_scans: RawScans | None = None

    def __post_init__(self) -> None:
        self.over(Retention())  # rejects values out of range

    def over(self, default: Retention) -> Retention:
        """Return the policy in force.

        Examples:
            >>> in_force = OwnRetention(retained_revisions=3).over(Retention(retained_for_days=7.0))
            >>> in_force.retained_revisions, in_force.retained_for_days
            (3, 7.0)
        """
        return replace(default, **self.chosen())

    def chosen(self) -> dict[str, Any]:
        """Return the chosen values, as plain values for JSON."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@dataclass(frozen=True)
class Candidate:
    """A revision, and what decides whether it is kept.

    Attributes:
        digest: The revision's digest.
        number: Counts the map's revisions in the order in which they were added.
        retained_from: When it was last built or, if it was live later, replaced.
        live: Whether it is the live one.
        needed: Whether a queued or running job is based on it.
    """

    digest: str
    number: int
    retained_from: datetime
    live: bool = False
    needed: bool = False


def to_collect(
    revisions: Sequence[Candidate], retention: Retention, now: datetime
) -> tuple[str, ...]:
    """Return the digests of the revisions of a map that a policy does not keep, oldest first.

    Every policy keeps the live one, those that a job needs, and the newest one: it may be about to
    be made live.
    """
    if retention.retained_revisions == "all":
        return ()
    newest = max(revisions, key=lambda one: (one.number, one.digest), default=None)
    others = sorted(
        (one for one in revisions if not one.live and one is not newest),
        key=lambda one: (one.retained_from, one.digest),
        reverse=True,
    )
    horizon = now - timedelta(days=retention.retained_for_days)
    old = [
        one.digest
        for one in others[retention.retained_revisions :]
        if one.retained_from <= horizon and not one.needed
    ]
    return tuple(reversed(old))
