"""The error of a job, as a problem's type and detail."""

from pydantic import BaseModel, Field

from app.http.problems import problem_type
from storage.catalog import JobRecord


class JobErrorOut(BaseModel):
    """Why a job failed."""

    type: str = Field(
        description="Stable name of the error, as in a problem; the path explains it.",
        examples=["/problems/empty-drive"],
    )
    detail: str

    @classmethod
    def from_record(cls, record: JobRecord) -> "JobErrorOut | None":
        """Show the error of a job's record, `None` if it has none."""
        if record.error_type is None:
            return None
        return cls(type=problem_type(record.error_type), detail=record.error_detail or "")
