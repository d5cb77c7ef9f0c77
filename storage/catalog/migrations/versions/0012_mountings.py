"""How a drive's sensor was mounted, and how many of its scans become one of a map."""

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("drives", sa.Column("mounting", sa.JSON(), nullable=True))
    op.add_column(
        "drives", sa.Column("accumulate", sa.Integer(), nullable=False, server_default="1")
    )


def downgrade() -> None:
    op.drop_column("drives", "accumulate")
    op.drop_column("drives", "mounting")
