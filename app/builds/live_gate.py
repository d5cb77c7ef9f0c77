"""The live gate: a build may become live if its recall is not below the live revision's."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from app.builds.parameters import BuildParameters
from app.revisions.recall import NoRecall, Recall, measure_recall
from core.mapping.tensormap import TensorMap
from storage.errors import CorruptFile, RevisionNotFound
from storage.files.map_file import read_map
from storage.store import Store


@dataclass(frozen=True)
class Gate:
    """Whether a build becomes live, and why.

    Attributes:
        live: Whether it does.
        compared_with: Digest of the live revision that it was compared with; `None` if it was not.
        recall: Recall of both, or why that is unknown; `None` if they were not compared.
        reason: Why it does not become live, or becomes live without a comparison.
        if_live: The revision that must still be live for this decision to hold, empty for none;
            `None` if the decision holds in any case.
    """

    live: bool
    compared_with: str | None = None
    recall: Recall | NoRecall | None = None
    reason: str | None = None
    if_live: str | None = None

    def as_json(self) -> dict[str, Any]:
        """Return plain values, for a job's result."""
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
    """Decide whether a build with `make_live` becomes live.

    It does if there is no live revision, if it is forced, or if recall on the scans that both have
    falls by at most `max_recall_loss`. It also does, with a reason, if that cannot be measured: a
    drive was recorded again, the live map was imported, images were not kept.

    Args:
        store: With the images of the drives.
        map_id: The map.
        drive_ids: Of the build, by slug.
        tensor_map: The new map.
        parameters: Of the build.

    Raises:
        MapNotFound: If the map was deleted.
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
    except RevisionNotFound:  # another is live by now; `if_live` detects that
        return Gate(live=True, if_live=digest)
    except (CorruptFile, FileNotFoundError):
        reason = f"live revision {digest[:12]} cannot be read: recall was not compared"
        return Gate(live=True, compared_with=digest, reason=reason, if_live=digest)
    recall = measure_recall(store, map_id, (drive_ids, tensor_map), (record.drive_ids, live_map))
    if isinstance(recall, NoRecall):
        reason = f"made live, recall could not be compared with {digest[:12]}: {recall}"
        return Gate(live=True, compared_with=digest, recall=recall, reason=reason, if_live=digest)
    if recall.other - recall.this <= parameters.max_recall_loss + 1e-9:
        return Gate(live=True, compared_with=digest, recall=recall, if_live=digest)
    reason = (
        f"not made live: of {recall.asked} scans that it shares with live revision"
        f" {digest[:12]} it finds {recall.this:.3f}, that one {recall.other:.3f}; at"
        f" most {parameters.max_recall_loss:g} less is allowed, force makes it live"
    )
    return Gate(live=False, compared_with=digest, recall=recall, reason=reason, if_live=digest)
