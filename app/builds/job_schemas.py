"""Jobs over the wire."""

from datetime import UTC, datetime

from pydantic import BaseModel, ConfigDict, Field

from app.builds.parameters import BuildParameters
from app.builds.plans import Plan
from app.http.problems import problem_type
from app.http.shown import Shown
from app.revisions.recall import NoRecall
from storage.catalog import JobRecord, JobState


class JobErrorOut(BaseModel):
    """Why a job failed."""

    type: str = Field(
        description="Stable name of the error, as in a problem; the path explains it.",
        examples=["/problems/empty-drive"],
    )
    detail: str


class LiveGateOut(BaseModel):
    """Whether a build was made live, and its recall compared with the revision that was live."""

    live: bool = Field(description="Whether it was made live when it was done.")
    compared_with: str | None = Field(
        description="The revision that was live; null for a first build and with `force`."
    )
    asked: int | None = Field(description="How many scans both were queried with.")
    recall: float | None = Field(description="Share of them that it finds, 0..1.")
    recall_of_live: float | None = Field(
        description="Share that the live revision found of them or, if there are none, of its own."
    )
    recall_unknown: NoRecall | None = Field(
        description="Why recall is unknown, as in a comparison."
    )
    asked_new: int | None = Field(
        None, description="How many scans of drives that the live revision lacks were queries."
    )
    recall_of_new: float | None = Field(
        None, description="Share of them that it finds; at most .05 lower than `recall_of_live`."
    )
    reason: str | None = Field(
        description="Why it was not made live, or was made live without a comparison; also a note."
    )


class CaptureJobParameters(BaseModel):
    """What a job of kind `capture` reads."""

    model_config = ConfigDict(extra="forbid")

    capture: str = Field(description="Id of the capture.")
    drive: str = Field(description="The drive that gets its scans.")


class JobOut(Shown):
    """A job and its progress."""

    job: str
    kind: str = Field(description="`build`, or `capture`: it reads a capture into a drive.")
    state: JobState
    stage: str = Field(description="Its current stage.", examples=["projecting", "fitting"])
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
        description="Of a build with `make_live`, when it is done; else null."
    )
    error: JobErrorOut | None
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None

    @classmethod
    def from_record(cls, record: JobRecord) -> "JobOut":
        """Show a job's record."""
        error = None
        if record.error_type is not None:
            error = JobErrorOut(
                type=problem_type(record.error_type), detail=record.error_detail or ""
            )
        return cls.of(
            record,
            job=record.id,
            done=record.done_units,
            total=record.total_units,
            remaining_s=record.remaining_s(datetime.now(UTC)),
            gate=record.result.get("gate"),
            error=error,
        )
