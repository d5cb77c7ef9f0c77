"""Marks recycle-bin entries whose purge has begun."""

import sqlalchemy as sa
from alembic import op

revision = "0023"
down_revision = "0022"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column(
        "recycle_bin",
        sa.Column("purging", sa.Boolean(), nullable=False, server_default=sa.false()),
    )


def downgrade() -> None:
    # An earlier version would list and restore what is left of them; it moves their files to
    # orphans/.
    op.execute(
        "DELETE FROM live_revisions WHERE map_id IN"
        " (SELECT map_id FROM recycle_bin WHERE purging AND drive_id IS NULL)"
    )
    op.execute("DELETE FROM drives WHERE id IN (SELECT drive_id FROM recycle_bin WHERE purging)")
    op.execute(
        "DELETE FROM maps WHERE id IN"
        " (SELECT map_id FROM recycle_bin WHERE purging AND drive_id IS NULL)"
    )
    op.drop_column("recycle_bin", "purging")
