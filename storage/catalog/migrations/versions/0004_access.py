"""What a key is called, is limited to and when it ends; tokens; the audit log."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
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
    op.create_table(
        "tokens",
        sa.Column("id", sa.String(32), nullable=False),
        sa.Column("secret_hash", sa.String(255), nullable=False),
        sa.Column("key_hash", sa.String(255), nullable=False),
        sa.Column("scopes", sa.JSON(), nullable=False),
        sa.Column("maps", sa.JSON(), nullable=True),
        sa.Column("created_at", _TIME, nullable=False),
        sa.Column("expires_at", _TIME, nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_tokens"),
        sa.UniqueConstraint("secret_hash", name="uq_tokens_secret_hash"),
    )
    op.create_index("ix_tokens_expires_at", "tokens", ["expires_at"])
    op.create_table(
        "audit",
        sa.Column("seq", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("at", _TIME, nullable=False),
        sa.Column("key_id", sa.String(32), nullable=False),
        sa.Column("action", sa.String(300), nullable=False),
        sa.Column("subject", sa.String(300), nullable=False),
        sa.Column("map_slug", sa.String(64), nullable=True),
        sa.Column("detail", sa.String(300), nullable=False),
        sa.Column("outcome", sa.String(100), nullable=False),
        sa.Column("hash", sa.String(64), nullable=False),
        sa.PrimaryKeyConstraint("seq", name="pk_audit"),
    )
    op.create_index("ix_audit_key_id", "audit", ["key_id"])
    op.create_index("ix_audit_map_slug", "audit", ["map_slug"])
    head = op.create_table(
        "audit_head",
        sa.Column("row", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("seq", sa.BigInteger(), nullable=False),
        sa.Column("hash", sa.String(64), nullable=False),
        sa.PrimaryKeyConstraint("row", name="pk_audit_head"),
    )
    op.bulk_insert(head, [{"row": 1, "seq": 0, "hash": "0" * 64}])


def downgrade() -> None:
    op.drop_table("audit_head")
    op.drop_table("audit")
    op.drop_table("tokens")
    with op.batch_alter_table("keys") as batch:
        batch.drop_constraint("uq_keys_secret_hash", type_="unique")
        for column in ("name", "maps", "first_run", "expires_at"):
            batch.drop_column(column)
