"""What a map keeps, since when a revision is only retained, and which drives it was built of."""

from datetime import UTC, datetime

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("maps", sa.Column("retention", sa.JSON(), nullable=True))
    op.add_column("revisions", sa.Column("drive_ids", sa.JSON(), nullable=True))
    op.add_column(
        "revisions", sa.Column("retained_from", sa.DateTime(timezone=True), nullable=True)
    )
    # When each was replaced was not written down: none is older than this.
    rows = sa.table("revisions", sa.column("retained_from", sa.DateTime(timezone=True)))
    op.execute(sa.update(rows).values(retained_from=datetime.now(UTC)))


def downgrade() -> None:
    op.drop_column("revisions", "retained_from")
    op.drop_column("revisions", "drive_ids")
    op.drop_column("maps", "retention")
