"""Idempotency keys of one access key only; the last versions of purged maps."""

import sqlalchemy as sa
from alembic import op

revision = "0025"
down_revision = "0024"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.drop_index("ix_jobs_request_key", "jobs")
    op.create_index("ix_jobs_request_key", "jobs", ["map_id", "request_key", "key_id"], unique=True)
    slug = sa.String(64).with_variant(sa.String(64, collation="C"), "postgresql")
    op.create_table(
        "purged_maps",
        sa.Column("slug", slug, nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("slug", name="pk_purged_maps"),
    )


def downgrade() -> None:
    op.drop_table("purged_maps")
    # An earlier version answers a repeated request with the first job of any key.
    op.execute(
        "UPDATE jobs SET request_key = NULL, request_digest = NULL WHERE EXISTS"
        " (SELECT 1 FROM jobs AS first WHERE first.map_id = jobs.map_id"
        " AND first.request_key = jobs.request_key AND first.id <> jobs.id"
        " AND (first.created_at, first.id) < (jobs.created_at, jobs.id))"
    )
    op.drop_index("ix_jobs_request_key", "jobs")
    op.create_index("ix_jobs_request_key", "jobs", ["map_id", "request_key"], unique=True)
