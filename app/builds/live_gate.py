"""The live gate: what a build must find to become live.

On the scans of the live revision it must find what that one does, and on scans of new drives about
as much as that one on its own.
"""

from dataclasses import dataclass, replace
from typing import Any

from app.builds.parameters import BuildParameters
from app.builds.recall import (
    DrivenMap,
    NoRecall,
    OwnRecall,
    Recall,
    drives_stored_here,
    measure_own_recall,
    measure_recall,
)
from core.mapping.tensormap import TensorMap
from storage.catalog import RevisionRecord
from storage.errors import CorruptFile, RevisionNotFound
from storage.store import Store

MOST_BELOW_OLD = 0.05
"""How much lower recall may be on new drives than that of the live revision on its own."""
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Compared:
    """Recall of a map and of the live revision.

    Attributes:
        recall: The recall on the scans that both have, or why it is unknown.
        old: Recall of the live revision: on these or, without any, on all its scans.
        new: Recall of the map on its drives that the live revision lacks; `None` without any.
    """

    recall: Recall | NoRecall
    old: OwnRecall | NoRecall
    new: OwnRecall | NoRecall | None

    def as_json(self) -> dict[str, Any]:
        """Return plain values, for a job's result."""
        shared = self.recall if isinstance(self.recall, Recall) else None
        old = self.old if isinstance(self.old, OwnRecall) else None
        new = self.new if isinstance(self.new, OwnRecall) else None
        return {
            "asked": None if shared is None else shared.queries,
            "recall": None if shared is None else shared.this,
            "recall_of_live": None if old is None else old.share,
            "recall_unknown": self.recall if isinstance(self.recall, NoRecall) else None,
            "asked_new": None if new is None else new.queries,
            "recall_of_new": None if new is None else new.share,
        }

    def fault(self, digest: str, max_recall_loss: float) -> str | None:
        """Return why the map should not replace the live revision, `None` if it may.

        Args:
            digest: The live revision's digest.
            max_recall_loss: How much lower recall may be on scans that both have.
        """
        of_live = f"live revision {digest[:12]}"
        if isinstance(self.old, NoRecall):
            return f"recall of {of_live} cannot be measured: {self.old}"
        if isinstance(self.recall, Recall):
            loss = self.recall.other - self.recall.this
            if loss > max_recall_loss + _ROUNDING:
                return (
                    f"of {self.recall.queries} scans that it shares with {of_live} it finds"
                    f" {self.recall.this:.3f}, that one {self.recall.other:.3f}; at most"
                    f" {max_recall_loss:g} less is allowed"
                )
        elif self.recall != NoRecall.NO_SCAN_IN_BOTH:
            return f"recall could not be compared with that of {of_live}: {self.recall}"
        if isinstance(self.new, NoRecall):
            return f"recall on its new drives cannot be measured: {self.new}"
        if self.new is not None:
            # One query that is not found is no evidence against a short drive.
            most = max(MOST_BELOW_OLD, max_recall_loss, 1.0 / self.new.queries)
            if self.old.share - self.new.share > most + _ROUNDING:
                return (
                    f"of {self.new.queries} scans of its new drives it finds {self.new.share:.3f},"
                    f" {of_live} finds {self.old.share:.3f} of its own; at most {most:.2g} less is"
                    " allowed"
                )
        return None


@dataclass(frozen=True)
class Gate:
    """Whether a build becomes live, and why.

    Attributes:
        live: Whether it does.
        compared_with: Digest of the live revision that it was compared with; `None` if it was not.
        compared: Recall of both; `None` if they were not compared.
        reason: Why it does not become live, or becomes live without a comparison.
        if_live: The revision that must still be live for this decision to hold, empty for none;
            `None` if the decision holds in any case.
    """

    live: bool
    compared_with: str | None = None
    compared: Compared | None = None
    reason: str | None = None
    if_live: str | None = None

    def as_json(self) -> dict[str, Any]:
        """Return plain values, for a job's result."""
        return {
            "live": self.live,
            "compared_with": self.compared_with,
            **(_NOT_COMPARED if self.compared is None else self.compared.as_json()),
            "reason": self.reason,
        }


_NOT_COMPARED = dict.fromkeys(
    ("asked", "recall", "recall_of_live", "recall_unknown", "asked_new", "recall_of_new")
)


def pass_gate(store: Store, map_id: str, built: DrivenMap, parameters: BuildParameters) -> Gate:
    """Decide whether a build with `make_live` becomes live.

    It does if there is no live revision, or none that can be read, and if it is forced. Else recall
    on the scans that both have may be lower by at most `max_recall_loss`, and recall on new drives
    lower than that of the live revision by at most `MOST_BELOW_OLD`. If that cannot be measured, it
    does not become live.

    Args:
        store: The store with the drives' images.
        map_id: The map.
        built: The new map.
        parameters: The build's parameters.

    Raises:
        MapNotFound: If the map was deleted.
    """
    if parameters.force:
        return Gate(live=True)
    gate = compare_with_live(store, map_id, built, parameters.max_recall_loss)
    if gate.live or gate.reason is None:
        return gate
    return replace(gate, reason=f"not made live: {gate.reason}; force makes it live")


def compare_with_live(store: Store, map_id: str, this: DrivenMap, max_recall_loss: float) -> Gate:
    """Return whether a map may replace the live revision, and the recall of both.

    Args:
        store: The store with the drives' images.
        map_id: The map.
        this: The map's content.
        max_recall_loss: How much lower recall may be on scans that both have.

    Raises:
        MapNotFound: If the map was deleted.
    """
    digest = store.maps.get_by_id(map_id).live_revision
    if digest is None:
        return Gate(live=True, if_live="")
    if digest == this.tensor_map.revision:
        return Gate(live=True, if_live=digest)
    try:
        record = store.revisions.of_map(map_id, digest)
        live_map = store.revisions.read(record)
    except RevisionNotFound:  # another is live by now; `if_live` detects that
        return Gate(live=True, if_live=digest)
    except CorruptFile:  # it answers no query either
        reason = f"live revision {digest[:12]} cannot be read: recall was not compared"
        return Gate(live=True, compared_with=digest, reason=reason, if_live=digest)
    compared = _compare(store, map_id, this, record, live_map)
    fault = compared.fault(digest, max_recall_loss)
    return Gate(
        live=fault is None,
        compared_with=digest,
        compared=compared,
        reason=fault,
        if_live=digest,
    )


def _compare(
    store: Store, map_id: str, this: DrivenMap, record: RevisionRecord, live_map: TensorMap
) -> Compared:
    this = _stored_here(store, map_id, this)
    live = _stored_here(store, map_id, DrivenMap(record.drive_ids, live_map))
    live_ids = live.drive_ids
    recall = measure_recall(store, map_id, this, live)
    old: OwnRecall | NoRecall
    if isinstance(recall, Recall):
        old = OwnRecall(recall.queries, recall.other)
    else:
        old = measure_own_recall(store, map_id, live, live_ids)
    drive_ids, tensor_map = this
    fresh = [name for name in drive_ids if live_ids.get(name) != drive_ids[name]]
    unknown = [name for name in tensor_map.trajectory.drives if name not in drive_ids]
    new: OwnRecall | NoRecall | None = None
    if unknown:
        new = NoRecall.NOT_BUILT_HERE
    elif fresh:
        new = measure_own_recall(store, map_id, this, fresh)
    return Compared(recall, old, new)


def _stored_here(store: Store, map_id: str, side: DrivenMap) -> DrivenMap:
    """Return a map with the ids of its drives, also if it was imported."""
    if side.drive_ids:
        return side
    return DrivenMap(drives_stored_here(store, map_id, side.tensor_map), side.tensor_map)
