"""Where maps are on the Earth."""

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("maps", sa.Column("anchor", sa.JSON(none_as_null=True), nullable=True))


def downgrade() -> None:
    op.drop_column("maps", "anchor")
