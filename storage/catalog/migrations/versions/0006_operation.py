"""Slugs are in the order of their bytes on PostgreSQL too, whatever language it speaks."""

from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None

_COLUMNS = (("maps", "slug"), ("drives", "slug"), ("audit", "map_slug"))


def upgrade() -> None:
    _collate('"C"')


def downgrade() -> None:
    _collate('"default"')


def _collate(name: str) -> None:
    if op.get_bind().dialect.name == "postgresql":  # SQLite compares bytes anyway
        for table, column in _COLUMNS:
            op.execute(f"ALTER TABLE {table} ALTER COLUMN {column} TYPE VARCHAR(64) COLLATE {name}")
