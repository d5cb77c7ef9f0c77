"""Whether a build may become live: it must find as many scans as the live revision does."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from app.builds.parameters import BuildParameters
from app.revisions.recall import NoRecall, Recall, measure_recall
from core.mapping.tensormap import TensorMap
from storage.catalog import RevisionRecord
from storage.errors import CorruptFile, RevisionNotFound
from storage.files.map_file import read_map
from storage.store import Store


@dataclass(frozen=True)
class Gate:
    """Whether a build becomes live, and why.

    Attributes:
        live: Whether it does.
        compared_with: Digest of the live revision that it was compared with; `None` if it was not.
        recall: What both find, or why that is not known; `None` if they were not compared.
        reason: Why it does not become live, or does so unmeasured; `None` if nothing is to say.
        if_live: What the decision depends on: this revision being live, empty for none; `None` if
            it depends on nothing.
    """

    live: bool
    compared_with: str | None = None
    recall: Recall | NoRecall | None = None
    reason: str | None = None
    if_live: str | None = None

    def as_json(self) -> dict[str, Any]:
        """Return plain values, as a job's result keeps them."""
        known = self.recall if isinstance(self.recall, Recall) else None
        return {
            "live": self.live,
            "compared_with": self.compared_with,
            "asked": None if known is None else known.asked,
            "recall": None if known is None else known.this,
            "recall_of_live": None if known is None else known.other,
            "recall_unknown": self.recall if isinstance(self.recall, NoRecall) else None,
            "reason": self.reason,
        }


def pass_gate(
    store: Store,
    map_id: str,
    drive_ids: Mapping[str, str],
    tensor_map: TensorMap,
    parameters: BuildParameters,
) -> Gate:
    """Decide whether a build that is to be made live may be.

    It may if there is no live revision, if it is forced, or if recall on the scans that both have
    falls by at most `max_recall_loss`. Where that cannot be measured it may too, with a reason: a
    drive recorded anew, another live map that was imported, images that were not kept.

    Args:
        store: With the images of the drives.
        map_id: The map.
        drive_ids: Of the build, by slug.
        tensor_map: What was built.
        parameters: What was asked for.

    Raises:
        MapNotFound: If the map is gone.
    """
    if parameters.force:
        return Gate(live=True)
    digest = store.maps.get_by_id(map_id).live_revision
    if digest is None:
        return Gate(live=True, if_live="")
    if digest == tensor_map.revision:
        return Gate(live=True, if_live=digest)
    try:
        record = store.revisions.of_map(map_id, digest)
        live_map = read_map(store.revisions.path_of(record))
    except RevisionNotFound:  # another is live by now; `if_live` says so
        return Gate(live=True, if_live=digest)
    except (CorruptFile, FileNotFoundError):
        reason = f"live revision {digest[:12]} cannot be read: recall was not compared"
        return Gate(live=True, compared_with=digest, reason=reason, if_live=digest)
    return _compared(store, record, live_map, drive_ids, tensor_map, parameters.max_recall_loss)


def _compared(
    store: Store,
    record: RevisionRecord,
    live_map: TensorMap,
    drive_ids: Mapping[str, str],
    tensor_map: TensorMap,
    max_loss: float,
) -> Gate:
    recall = measure_recall(
        store, record.map_id, (drive_ids, tensor_map), (record.drive_ids, live_map)
    )
    live, reason = True, None
    if isinstance(recall, NoRecall):
        reason = f"made live, recall could not be compared with {record.digest[:12]}: {recall}"
    elif recall.other - recall.this > max_loss + 1e-9:
        live = False
        reason = (
            f"not made live: of {recall.asked} scans that it shares with live revision"
            f" {record.digest[:12]} it finds {recall.this:.3f}, that one {recall.other:.3f}; at"
            f" most {max_loss:g} less is wanted, force makes it live"
        )
    return Gate(live, record.digest, recall, reason, record.digest)
