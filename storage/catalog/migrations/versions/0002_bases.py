"""Which bases a revision answers to, and what a job has to say about what it built."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "revision_bases",
        sa.Column("map_id", sa.String(32), nullable=False),
        sa.Column("basis", sa.String(64), nullable=False),
        sa.Column("digest", sa.String(64), nullable=False),
        sa.PrimaryKeyConstraint("map_id", "basis", "digest", name="pk_revision_bases"),
        sa.ForeignKeyConstraint(
            ["map_id", "digest"],
            ["revisions.map_id", "revisions.digest"],
            name="fk_revision_bases_map_id_digest",
            ondelete="CASCADE",
        ),
    )
    op.add_column("jobs", sa.Column("notes", sa.JSON(), nullable=True))


def downgrade() -> None:
    op.drop_column("jobs", "notes")
    op.drop_table("revision_bases")
