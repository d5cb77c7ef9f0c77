"""The drive that scans or poses are put into, from its look-up to its change."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

from sqlalchemy import bindparam, select
from sqlalchemy.orm import Session

from storage.catalog.models import Drive, Map
from storage.catalog.records import ScanRecord
from storage.errors import LostRace
from storage.names import is_recycled

# Of every upload; made once, because making a statement takes longer than SQLite takes for it.
_HELD_DRIVE = (
    select(Drive.id, Drive.closed, Map.slug)
    .join(Map, Map.id == Drive.map_id)
    .where(Drive.map_id == bindparam("map_id"), Drive.slug == bindparam("drive_slug"))
    .with_for_update(of=Drive)
)


@dataclass(frozen=True)
class PutTarget:
    """The drive that scans are put into, and which of them it has already.

    Attributes:
        exists: Whether the drive exists; if not, `drive_id` is its future id.
        stored: The requested scans that are stored, by index.
    """

    map_id: str
    drive_id: str
    drive_slug: str
    exists: bool
    closed: bool
    stored: Mapping[int, ScanRecord]


def hold(session: Session, target: PutTarget) -> None:
    """Lock the target's drive, or make it.

    Raises:
        LostRace: If the target has changed: the drive was made, closed or removed, or the map was
            removed.
    """
    named = {"map_id": target.map_id, "drive_slug": target.drive_slug}
    found = session.connection().execute(_HELD_DRIVE, named).first()
    drive_id, closed, map_slug = found or (None, None, None)
    if found is None:  # the drive is to be made, or gone, perhaps with its map
        map_slug = session.scalar(select(Map.slug).where(Map.id == target.map_id))
    if map_slug is None or is_recycled(map_slug):
        raise LostRace(f"the map of drive {target.drive_slug!r} was removed meanwhile")
    if target.exists:
        if (drive_id, closed) != (target.drive_id, target.closed):
            raise LostRace(f"drive {target.drive_slug!r} was closed or removed meanwhile")
        return
    if found is not None:
        raise LostRace(f"drive {target.drive_slug!r} was made meanwhile")
    row = Drive(
        id=target.drive_id,
        map_id=target.map_id,
        slug=target.drive_slug,
        created_at=datetime.now(UTC),
    )
    session.add(row)
    session.flush()
