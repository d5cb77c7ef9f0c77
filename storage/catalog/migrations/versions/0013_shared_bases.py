"""Shared bases, which builds of any map can use."""

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None


def upgrade() -> None:
    slug = sa.String(64).with_variant(sa.String(64, collation="C"), "postgresql")
    op.create_table(
        "bases",
        sa.Column("digest", sa.String(64), nullable=False),
        sa.Column("name", slug, nullable=False),
        sa.Column("file_name", sa.String(100), nullable=False),
        sa.Column("encoding", sa.String(32), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("digest", name="pk_bases"),
        sa.UniqueConstraint("name", name="uq_bases_name"),
    )


def downgrade() -> None:
    op.drop_table("bases")
