"""Captures that are uploaded in parts, until they are read."""

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None


def upgrade() -> None:
    slug = sa.String(64).with_variant(sa.String(64, collation="C"), "postgresql")
    op.create_table(
        "captures",
        sa.Column("id", sa.String(32), nullable=False),
        sa.Column("map_id", sa.String(32), nullable=False),
        sa.Column("drive", slug, nullable=False),
        sa.Column("files", sa.JSON(), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("part_bytes", sa.Integer(), nullable=False),
        sa.Column("topic", sa.String(255), nullable=True),
        sa.Column("first_scan", sa.BigInteger(), nullable=False),
        sa.Column("digest", sa.String(64), nullable=True),
        sa.Column("key_id", sa.String(32), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("touched_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("job_id", sa.String(32), nullable=True),
        sa.PrimaryKeyConstraint("id", name="pk_captures"),
        sa.ForeignKeyConstraint(
            ["map_id"], ["maps.id"], name="fk_captures_map_id", ondelete="CASCADE"
        ),
    )
    op.create_index("ix_captures_map_id", "captures", ["map_id"])
    op.create_table(
        "capture_parts",
        sa.Column("capture_id", sa.String(32), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("digest", sa.String(64), nullable=False),
        sa.Column("file_name", sa.String(100), nullable=False),
        sa.PrimaryKeyConstraint("capture_id", "number", name="pk_capture_parts"),
        sa.ForeignKeyConstraint(
            ["capture_id"],
            ["captures.id"],
            name="fk_capture_parts_capture_id",
            ondelete="CASCADE",
        ),
    )


def downgrade() -> None:
    # An earlier release would run them as builds, and cannot show them.
    op.execute("DELETE FROM jobs WHERE kind = 'capture'")
    op.drop_table("capture_parts")
    op.drop_table("captures")
