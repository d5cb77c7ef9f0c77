"""The order in which jobs were queued, whatever the clock said."""

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("jobs", sa.Column("number", sa.BigInteger(), nullable=False, server_default="0"))
    jobs = sa.table("jobs", *(sa.column(name) for name in ("id", "number", "created_at")))
    connection = op.get_bind()
    ids = connection.scalars(sa.select(jobs.c.id).order_by(jobs.c.created_at, jobs.c.id)).all()
    if ids:
        connection.execute(
            sa.update(jobs).where(jobs.c.id == sa.bindparam("of")).values(number=sa.bindparam("n")),
            [{"of": job_id, "n": number} for number, job_id in enumerate(ids, 1)],
        )
    op.drop_index("ix_jobs_created_at_id", "jobs")
    op.drop_index("ix_jobs_state_created_at", "jobs")
    op.create_index("ix_jobs_number_id", "jobs", ["number", "id"])
    op.create_index("ix_jobs_state_number", "jobs", ["state", "number"])


def downgrade() -> None:
    op.drop_index("ix_jobs_state_number", "jobs")
    op.drop_index("ix_jobs_number_id", "jobs")
    op.create_index("ix_jobs_state_created_at", "jobs", ["state", "created_at"])
    op.create_index("ix_jobs_created_at_id", "jobs", ["created_at", "id"])
    op.drop_column("jobs", "number")
