"""How the given poses of a drive agree with its scans."""

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("drives", sa.Column("pose_check", sa.JSON(none_as_null=True), nullable=True))


def downgrade() -> None:
    op.drop_column("drives", "pose_check")
