"""The order in which the revisions of a map were added, whatever the clock said."""

from collections import Counter

import sqlalchemy as sa
from alembic import op

revision = "0021"
down_revision = "0020"
branch_labels = None
depends_on = None


def upgrade() -> None:
    number = sa.Column("number", sa.BigInteger(), nullable=False, server_default="0")
    op.add_column("revisions", number)
    names = "map_id", "digest", "number", "created_at"
    rows = sa.table("revisions", *map(sa.column, names))
    connection, of_map = op.get_bind(), Counter[str]()
    in_order = sa.select(rows.c.map_id, rows.c.digest).order_by(rows.c.created_at, rows.c.digest)
    numbered = []
    for map_id, digest in connection.execute(in_order).all():
        of_map[map_id] += 1
        numbered.append({"of": map_id, "named": digest, "n": of_map[map_id]})
    if numbered:
        is_row = (rows.c.map_id == sa.bindparam("of")) & (rows.c.digest == sa.bindparam("named"))
        change = sa.update(rows).where(is_row).values(number=sa.bindparam("n"))
        connection.execute(change, numbered)


def downgrade() -> None:
    op.drop_column("revisions", "number")
