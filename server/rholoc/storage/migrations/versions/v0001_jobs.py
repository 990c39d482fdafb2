"""Jobs and workers, as releases without migrations made them."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None


def upgrade() -> None:
    """Make the tables, or bring those of an earlier release up to date."""
    present = set(sa.inspect(op.get_bind()).get_table_names())
    if "rholoc_jobs" not in present:
        _create_jobs()
    elif "warnings" not in {column["name"] for column in sa.inspect(op.get_bind()).get_columns("rholoc_jobs")}:
        op.add_column("rholoc_jobs", sa.Column("warnings", sa.JSON))
    if "rholoc_workers" not in present:
        op.create_table(
            "rholoc_workers",
            sa.Column("id", sa.String(100), primary_key=True),
            sa.Column("heartbeat", sa.Float, nullable=False),
        )


def _create_jobs() -> None:
    op.create_table(
        "rholoc_jobs",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("recording", sa.String(32), nullable=False),
        sa.Column("map_name", sa.Text, nullable=False),
        sa.Column("options", sa.JSON, nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("stage", sa.String(16), nullable=False),
        sa.Column("progress", sa.Float, nullable=False),
        sa.Column("message", sa.Text, nullable=False),
        sa.Column("log", sa.JSON, nullable=False),
        sa.Column("warnings", sa.JSON),
        sa.Column("error_code", sa.Text),
        sa.Column("error_message", sa.Text),
        sa.Column("error_hint", sa.Text),
        sa.Column("created", sa.Float, nullable=False),
        sa.Column("started", sa.Float),
        sa.Column("ended", sa.Float),
        sa.Column("attempts", sa.Integer, nullable=False),
        sa.Column("workflow_id", sa.Text, nullable=False),
    )
