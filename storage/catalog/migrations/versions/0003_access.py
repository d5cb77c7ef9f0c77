"""What a key is called, which maps it is limited to and when it ends."""

import sqlalchemy as sa
from alembic import op

revision = "0003_access"
down_revision = "0002"
branch_labels = None
depends_on = None

_TIME = sa.DateTime(timezone=True)


def upgrade() -> None:
    op.add_column("keys", sa.Column("name", sa.String(100), nullable=True))
    op.add_column("keys", sa.Column("maps", sa.JSON(), nullable=True))
    op.add_column("keys", sa.Column("first_run", sa.Boolean(), nullable=True))
    op.add_column("keys", sa.Column("expires_at", _TIME, nullable=True))
    # Until now the service itself made every key, at its first start.
    keys = sa.table("keys", sa.column("name", sa.String), sa.column("first_run", sa.Boolean))
    op.execute(keys.update().values(name="administrator", first_run=True))
    with op.batch_alter_table("keys") as batch:
        batch.alter_column("name", existing_type=sa.String(100), nullable=False)
        batch.alter_column("first_run", existing_type=sa.Boolean(), nullable=False)
        batch.create_unique_constraint("uq_keys_secret_hash", ["secret_hash"])


def downgrade() -> None:
    with op.batch_alter_table("keys") as batch:
        batch.drop_constraint("uq_keys_secret_hash", type_="unique")
        for column in ("name", "maps", "first_run", "expires_at"):
            batch.drop_column(column)
