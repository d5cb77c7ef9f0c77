"""The store's id, maps, drives, scans, revisions, jobs and keys."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

_TIME = sa.DateTime(timezone=True)


def upgrade() -> None:
    op.create_table(
        "store",
        sa.Column("row", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("id", sa.String(32), nullable=False),
        sa.PrimaryKeyConstraint("row", name="pk_store"),
    )
    op.create_table(
        "maps",
        sa.Column("id", sa.String(32), nullable=False),
        sa.Column("slug", sa.String(64), nullable=False),
        sa.Column("description", sa.Text(), nullable=False),
        sa.Column("created_at", _TIME, nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_maps"),
        sa.UniqueConstraint("slug", name="uq_maps_slug"),
    )
    op.create_table(
        "drives",
        sa.Column("id", sa.String(32), nullable=False),
        sa.Column("map_id", sa.String(32), nullable=False),
        sa.Column("slug", sa.String(64), nullable=False),
        sa.Column("created_at", _TIME, nullable=False),
        sa.Column("closed", sa.Boolean(), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_drives"),
        sa.UniqueConstraint("map_id", "slug", name="uq_drives_map_id_slug"),
        sa.ForeignKeyConstraint(
            ["map_id"], ["maps.id"], name="fk_drives_map_id", ondelete="CASCADE"
        ),
    )
    op.create_table(
        "scans",
        sa.Column("drive_id", sa.String(32), nullable=False),
        sa.Column("scan_index", sa.BigInteger(), nullable=False),
        sa.Column("chunk", sa.String(64), nullable=False),
        sa.Column("chunk_row", sa.Integer(), nullable=False),
        sa.Column("digest", sa.String(64), nullable=False),
        sa.Column("returns", sa.Integer(), nullable=False),
        sa.Column("dropped_returns", sa.Integer(), nullable=False),
        sa.Column("timestamp_s", sa.Double(), nullable=True),
        sa.Column("pose", sa.JSON(), nullable=True),
        sa.PrimaryKeyConstraint("drive_id", "scan_index", name="pk_scans"),
        sa.ForeignKeyConstraint(
            ["drive_id"], ["drives.id"], name="fk_scans_drive_id", ondelete="CASCADE"
        ),
    )
    op.create_table(
        "revisions",
        sa.Column("map_id", sa.String(32), nullable=False),
        sa.Column("digest", sa.String(64), nullable=False),
        sa.Column("file_name", sa.String(100), nullable=False),
        sa.Column("encoding", sa.String(32), nullable=False),
        sa.Column("scans", sa.Integer(), nullable=False),
        sa.Column("segments", sa.Integer(), nullable=False),
        sa.Column("parameters", sa.JSON(), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("job_id", sa.String(32), nullable=True),
        sa.Column("created_at", _TIME, nullable=False),
        sa.PrimaryKeyConstraint("map_id", "digest", name="pk_revisions"),
        sa.ForeignKeyConstraint(
            ["map_id"], ["maps.id"], name="fk_revisions_map_id", ondelete="CASCADE"
        ),
    )
    op.create_table(
        "live_revisions",
        sa.Column("map_id", sa.String(32), nullable=False),
        sa.Column("digest", sa.String(64), nullable=False),
        sa.PrimaryKeyConstraint("map_id", name="pk_live_revisions"),
        sa.ForeignKeyConstraint(
            ["map_id"], ["maps.id"], name="fk_live_revisions_map_id", ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(
            ["map_id", "digest"],
            ["revisions.map_id", "revisions.digest"],
            name="fk_live_revisions_map_id_digest",
        ),
    )
    op.create_table(
        "jobs",
        sa.Column("id", sa.String(32), nullable=False),
        sa.Column("map_id", sa.String(32), nullable=False),
        sa.Column("kind", sa.String(32), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("stage", sa.String(64), nullable=False),
        sa.Column("done_units", sa.BigInteger(), nullable=False),
        sa.Column("total_units", sa.BigInteger(), nullable=False),
        sa.Column("parameters", sa.JSON(), nullable=False),
        sa.Column("error_type", sa.String(128), nullable=True),
        sa.Column("error_detail", sa.Text(), nullable=True),
        sa.Column("revision", sa.String(64), nullable=True),
        sa.Column("cancel_requested", sa.Boolean(), nullable=False),
        sa.Column("created_at", _TIME, nullable=False),
        sa.Column("started_at", _TIME, nullable=True),
        sa.Column("finished_at", _TIME, nullable=True),
        sa.PrimaryKeyConstraint("id", name="pk_jobs"),
        sa.ForeignKeyConstraint(["map_id"], ["maps.id"], name="fk_jobs_map_id", ondelete="CASCADE"),
    )
    op.create_index("ix_jobs_map_id", "jobs", ["map_id"])
    op.create_index("ix_jobs_created_at_id", "jobs", ["created_at", "id"])
    op.create_index("ix_jobs_state_created_at", "jobs", ["state", "created_at"])
    op.create_table(
        "keys",
        sa.Column("id", sa.String(32), nullable=False),
        sa.Column("secret_hash", sa.String(255), nullable=False),
        sa.Column("scopes", sa.JSON(), nullable=False),
        sa.Column("created_at", _TIME, nullable=False),
        sa.Column("revoked_at", _TIME, nullable=True),
        sa.PrimaryKeyConstraint("id", name="pk_keys"),
    )


def downgrade() -> None:
    for table in (
        "keys",
        "jobs",
        "live_revisions",
        "revisions",
        "scans",
        "drives",
        "maps",
        "store",
    ):
        op.drop_table(table)
