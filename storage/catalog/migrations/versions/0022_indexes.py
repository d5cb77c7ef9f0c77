"""Indexes by which pages of the audit log, tokens of a key and scans of a file are found."""

from alembic import op

revision = "0022"
down_revision = "0021"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_index("ix_audit_key_id_seq", "audit", ["key_id", "seq"])
    op.create_index("ix_audit_map_slug_seq", "audit", ["map_slug", "seq"])
    op.create_index("ix_audit_at_seq", "audit", ["at", "seq"])
    op.drop_index("ix_audit_key_id", "audit")
    op.drop_index("ix_audit_map_slug", "audit")
    op.create_index("ix_tokens_key_hash_expires_at", "tokens", ["key_hash", "expires_at"])
    op.create_index("ix_scans_drive_id_chunk", "scans", ["drive_id", "chunk"])


def downgrade() -> None:
    op.drop_index("ix_scans_drive_id_chunk", "scans")
    op.drop_index("ix_tokens_key_hash_expires_at", "tokens")
    op.create_index("ix_audit_map_slug", "audit", ["map_slug"])
    op.create_index("ix_audit_key_id", "audit", ["key_id"])
    op.drop_index("ix_audit_at_seq", "audit")
    op.drop_index("ix_audit_map_slug_seq", "audit")
    op.drop_index("ix_audit_key_id_seq", "audit")
