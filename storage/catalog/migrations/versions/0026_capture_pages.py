"""Indexes by which pages of captures are found, of a map and of a drive."""

from alembic import op

revision = "0026"
down_revision = "0025"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_index("ix_captures_map_id_created_at_id", "captures", ["map_id", "created_at", "id"])
    op.create_index(
        "ix_captures_map_id_drive_created_at_id",
        "captures",
        ["map_id", "drive", "created_at", "id"],
    )
    op.drop_index("ix_captures_map_id", "captures")


def downgrade() -> None:
    op.create_index("ix_captures_map_id", "captures", ["map_id"])
    op.drop_index("ix_captures_map_id_drive_created_at_id", "captures")
    op.drop_index("ix_captures_map_id_created_at_id", "captures")
