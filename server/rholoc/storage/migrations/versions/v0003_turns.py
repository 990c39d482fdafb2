"""Who has a job, in which order jobs are taken, and how much memory jobs need and workers have."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    """Add the columns; an earlier release's servers and workers, which go on meanwhile, leave them null."""
    for column in (
        sa.Column("worker", sa.String(100)),
        sa.Column("release", sa.Integer),
        sa.Column("turn", sa.Float),
        sa.Column("memory_bytes", sa.BigInteger),
    ):
        op.add_column("rholoc_jobs", column)
    for column in (sa.Column("release", sa.Integer), sa.Column("memory_bytes", sa.BigInteger)):
        op.add_column("rholoc_workers", column)
