"""Poses of scans that are still to come."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "expected_poses",
        sa.Column("drive_id", sa.String(32), nullable=False),
        sa.Column("scan_index", sa.BigInteger(), nullable=False),
        sa.Column("timestamp_s", sa.Double(), nullable=True),
        sa.Column("pose", sa.JSON(), nullable=True),
        sa.PrimaryKeyConstraint("drive_id", "scan_index", name="pk_expected_poses"),
        sa.ForeignKeyConstraint(
            ["drive_id"],
            ["drives.id"],
            name="fk_expected_poses_drive_id",
            ondelete="CASCADE",
        ),
    )


def downgrade() -> None:
    op.drop_table("expected_poses")
