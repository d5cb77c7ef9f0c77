"""Jobs over the wire."""

from datetime import UTC, datetime

from pydantic import BaseModel, ConfigDict, Field

from app.builds.live_gate_schemas import LiveGateOut
from app.builds.parameters import BuildParameters
from app.builds.plans import Plan
from app.http.job_error import JobErrorOut
from app.http.shown import Shown
from storage.catalog import JobRecord, JobState


class CaptureJobParameters(BaseModel):
    """What a job of kind `capture` reads."""

    model_config = ConfigDict(extra="forbid")

    capture: str = Field(description="Id of the capture.")
    drive: str = Field(description="The drive that gets its scans.")


class JobOut(Shown):
    """A job and its progress."""

    job: str
    map: str = Field(
        description="Name of its map, as it is now; of a deleted map, the name that it had."
    )
    kind: str = Field(description="`build`, or `capture`: it reads a capture into a drive.")
    state: JobState
    stage: str = Field(description="The job's current stage.", examples=["projecting", "fitting"])
    done: int = Field(description="Units of this stage that are done.")
    total: int = Field(description="Units of this stage.")
    remaining_s: float | None = Field(
        description="Seconds until this stage is done at its pace so far; null if unknown."
    )
    parameters: BuildParameters | CaptureJobParameters
    plan: Plan | None = Field(
        description="What it is built from, chosen when it was queued; null for a build that an"
        " earlier version queued, and for a capture."
    )
    revision: str | None = Field(description="The revision that it built, when it is done.")
    notes: list[str] = Field(description="Notes for the client, such as a basis that fits badly.")
    gate: LiveGateOut | None = Field(
        description="The check before live of a build with `make_live`, when it is done; else null."
    )
    error: JobErrorOut | None
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None

    @classmethod
    def from_record(cls, record: JobRecord) -> "JobOut":
        """Show a job's record."""
        return cls.of(
            record,
            job=record.id,
            map=record.map_slug,
            done=record.done_units,
            total=record.total_units,
            remaining_s=record.remaining_s(datetime.now(UTC)),
            gate=record.result.get("gate"),
            error=JobErrorOut.from_record(record),
        )
