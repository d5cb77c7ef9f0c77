"""Index by which pages of the audit log with some actions are found."""

from alembic import op

revision = "0024"
down_revision = "0023"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_index("ix_audit_action_seq", "audit", ["action", "seq"])


def downgrade() -> None:
    op.drop_index("ix_audit_action_seq", "audit")
