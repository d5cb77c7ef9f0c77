"""Deleted maps and drives, until they are restored or removed for good."""

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None


def upgrade() -> None:
    slug = sa.String(64).with_variant(sa.String(64, collation="C"), "postgresql")
    op.create_table(
        "recycle_bin",
        sa.Column("id", sa.String(32), nullable=False),
        sa.Column("map_id", sa.String(32), nullable=False),
        sa.Column("drive_id", sa.String(32), nullable=True),
        sa.Column("slug", slug, nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_recycle_bin"),
        sa.ForeignKeyConstraint(
            ["map_id"], ["maps.id"], name="fk_recycle_bin_map_id", ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(
            ["drive_id"], ["drives.id"], name="fk_recycle_bin_drive_id", ondelete="CASCADE"
        ),
    )


def downgrade() -> None:
    # An earlier version would list them by their ids; it moves their files to orphans/.
    op.execute(
        "DELETE FROM live_revisions WHERE map_id IN"
        " (SELECT map_id FROM recycle_bin WHERE drive_id IS NULL)"
    )
    op.execute("DELETE FROM drives WHERE id IN (SELECT drive_id FROM recycle_bin)")
    op.execute(
        "DELETE FROM maps WHERE id IN (SELECT map_id FROM recycle_bin WHERE drive_id IS NULL)"
    )
    op.drop_table("recycle_bin")
