"""Imported revisions on the wire."""

from pydantic import Field

from app.builds.live_gate_schemas import LiveGateOut
from app.revisions.imports import Imported
from app.revisions.schemas import RevisionOut


class ImportedOut(RevisionOut):
    """A revision, and its recall compared with the revision that was live."""

    gate: LiveGateOut = Field(
        description="The check before live, as of a build with `make_live`; `reason` is why such a"
        " build would not have become live."
    )
    notes: list[str] = Field(
        description="Notes for the client: that the map's anchor is of another frame than that of"
        " this revision."
    )

    @classmethod
    def from_import(cls, imported: Imported, live_revision: str | None) -> "ImportedOut":
        """Return the model of an import."""
        shown = RevisionOut.from_record(imported.record, live_revision)
        gate = LiveGateOut.model_validate({**imported.gate.as_json(), "live": shown.live})
        return cls(**dict(shown), gate=gate, notes=list(imported.notes))
