"""The key that requested a job, so that keys share the queue; unknown for earlier jobs."""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("jobs", sa.Column("key_id", sa.String(32), nullable=True))
    op.create_index("ix_jobs_key_id_started_at", "jobs", ["key_id", "started_at"])


def downgrade() -> None:
    op.drop_index("ix_jobs_key_id_started_at", "jobs")
    op.drop_column("jobs", "key_id")
