"""How the poses of a drive were computed, if they are the service's own, and how good each is."""

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("drives", sa.Column("odometry", sa.JSON(), nullable=True))
    op.add_column("scans", sa.Column("pose_sigma", sa.JSON(), nullable=True))


def downgrade() -> None:
    # An earlier release would take computed poses for given ones.
    op.execute(
        "UPDATE scans SET pose = NULL WHERE drive_id IN"
        " (SELECT id FROM drives WHERE odometry IS NOT NULL)"
    )
    op.drop_column("scans", "pose_sigma")
    op.drop_column("drives", "odometry")
    _forget_parameters()


def _forget_parameters() -> None:
    """Remove the parameters of builds that an earlier release rejects, in jobs and their plans."""
    jobs = sa.table(
        "jobs",
        sa.column("id", sa.String),
        sa.column("parameters", sa.JSON),
        sa.column("plan", sa.JSON),
    )
    for job_id, parameters, plan in op.get_bind().execute(sa.select(jobs)).all():
        values = {"parameters": _earlier(parameters)}
        if plan is not None:
            values["plan"] = {**plan, "parameters": _earlier(plan["parameters"])}
        op.execute(jobs.update().where(jobs.c.id == job_id).values(values))


def _earlier(parameters: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in parameters.items() if name not in {"align", "odometry"}}
