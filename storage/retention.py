"""What of a map is kept: how many revisions, for how long, and whether raw returns."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timedelta
from enum import StrEnum
from typing import Any, Literal

from core.errors import InvalidParameters

MOST_REVISIONS = 1_000_000
LONGEST_DAYS = 36_525.0


class RawScans(StrEnum):
    """What becomes of a scan's returns once a map was built of it."""

    KEEP = "keep"
    DROP = "drop"


@dataclass(frozen=True)
class Retention:
    """What is kept; by default everything.

    A revision goes when neither its number nor its age keeps it.

    Attributes:
        retained_revisions: How many are kept besides the live and the newest one, or `all`.
        retained_for_days: How long any is kept after it was built or, if it was live, replaced.
        raw_scans: What becomes of the returns that the live revision was built of.

    Raises:
        InvalidParameters: If a number is none, or out of range.
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
    """What a map has chosen of a `Retention`; `None` is what the service does by default."""

    retained_revisions: int | Literal["all"] | None = None
    retained_for_days: float | None = None
    raw_scans: RawScans | None = None

    def __post_init__(self) -> None:
        self.over(Retention())  # refuses what is out of range

    def over(self, default: Retention) -> Retention:
        """Return what is in force.

        Examples:
            >>> in_force = OwnRetention(retained_revisions=3).over(Retention(retained_for_days=7.0))
            >>> in_force.retained_revisions, in_force.retained_for_days
            (3, 7.0)
        """
        return replace(default, **self.chosen())

    def chosen(self) -> dict[str, Any]:
        """Return what it does not leave to the default, as plain values for JSON."""
        return {name: value for name, value in asdict(self).items() if value is not None}

    def changed(self, changes: Mapping[str, Any]) -> "OwnRetention":
        """Return it with some of its attributes replaced."""
        return replace(self, **changes)

    @classmethod
    def from_chosen(cls, chosen: Mapping[str, Any]) -> "OwnRetention":
        """Read what `chosen` gave."""
        raw_scans = chosen.get("raw_scans")
        return cls(
            chosen.get("retained_revisions"),
            chosen.get("retained_for_days"),
            None if raw_scans is None else RawScans(raw_scans),
        )


@dataclass(frozen=True)
class Standing:
    """What decides whether a revision is kept.

    Attributes:
        digest: Its name.
        created_at: When the map got it.
        retained_from: When it was built last or, if it was live later, replaced.
        live: Whether it is the live one.
        needed: Whether a job that waits or runs is based on it.
    """

    digest: str
    created_at: datetime
    retained_from: datetime
    live: bool = False
    needed: bool = False


def to_collect(
    revisions: Iterable[Standing], retention: Retention, now: datetime
) -> tuple[str, ...]:
    """Return the digests of the revisions of a map that a policy does not keep, oldest first.

    Whatever the policy, the live one stays, what a job needs, and the newest one: whoever built it
    has not had the time to make it live.
    """
    if retention.retained_revisions == "all":
        return ()
    standing = list(revisions)
    newest = max(standing, key=lambda one: (one.created_at, one.digest), default=None)
    others = sorted(
        (one for one in standing if not one.live and one is not newest),
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
