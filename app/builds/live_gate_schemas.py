"""The live gate over the wire."""

from pydantic import BaseModel, Field

from app.builds.recall import NoRecall


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
        None,
        description="Share of them that it finds. It may be lower than `recall_of_live` by .05,"
        " or by `max_recall_loss` or one query where that is more.",
    )
    reason: str | None = Field(
        description="Why it was not made live, or was made live without a comparison; also a note."
    )
