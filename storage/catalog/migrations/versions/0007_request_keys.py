"""The idempotency key of a job's request, so that a repeated request creates no second job."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("jobs", sa.Column("request_key", sa.String(255), nullable=True))
    op.add_column("jobs", sa.Column("request_digest", sa.String(64), nullable=True))
    op.create_index("ix_jobs_request_key", "jobs", ["map_id", "request_key"], unique=True)


def downgrade() -> None:
    op.drop_index("ix_jobs_request_key", "jobs")
    op.drop_column("jobs", "request_digest")
    op.drop_column("jobs", "request_key")
