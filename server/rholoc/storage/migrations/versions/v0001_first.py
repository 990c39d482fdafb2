"""The tables of 1.0.0."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None


def upgrade() -> None:
    """Create the tables."""
    _create_jobs()
    _create_catalogue()
    _create_recordings()
    _create_accounts()


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
        sa.Column("warnings", sa.JSON, nullable=False),
        sa.Column("error_code", sa.Text),
        sa.Column("error_message", sa.Text),
        sa.Column("error_hint", sa.Text),
        sa.Column("created", sa.Float, nullable=False),
        sa.Column("started", sa.Float),
        sa.Column("ended", sa.Float),
        sa.Column("attempts", sa.Integer, nullable=False),
        sa.Column("deaths", sa.Integer, nullable=False),
        sa.Column("run", sa.String(41), nullable=False),
        sa.Column("worker", sa.String(100)),
        sa.Column("turn", sa.Float, nullable=False),
        sa.Column("memory_bytes", sa.BigInteger),
        sa.Column("asked_in", sa.Text),
    )
    op.create_table(
        "rholoc_workers",
        sa.Column("id", sa.String(100), primary_key=True),
        sa.Column("heartbeat", sa.Float, nullable=False),
        sa.Column("memory_bytes", sa.BigInteger),
        sa.Column("error", sa.Text),
    )


def _create_catalogue() -> None:
    catalogue = op.create_table(
        "rholoc_catalogue",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("revision", sa.BigInteger, nullable=False),
    )
    op.bulk_insert(catalogue, [{"id": 1, "revision": 0}])
    op.create_table(
        "rholoc_maps",
        sa.Column("name", sa.String(64), primary_key=True),
        sa.Column("blob", sa.String(32)),
        sa.Column("size_bytes", sa.BigInteger, nullable=False),
        sa.Column("modified", sa.Float, nullable=False),
        sa.Column("map_id", sa.Text, nullable=False),
        sa.Column("version", sa.Integer, nullable=False),
        sa.Column("revision", sa.BigInteger, nullable=False, index=True),
    )
    op.create_table(
        "rholoc_map_versions",
        sa.Column("name", sa.String(64), primary_key=True),
        sa.Column("number", sa.Integer, primary_key=True),
        sa.Column("blob", sa.String(32), nullable=False),
        sa.Column("size_bytes", sa.BigInteger, nullable=False),
        sa.Column("map_id", sa.Text, nullable=False),
        sa.Column("version", sa.Integer, nullable=False),
    )
    op.create_table(
        "rholoc_documents",
        sa.Column("path", sa.String(200), primary_key=True),
        sa.Column("content", sa.LargeBinary),
        sa.Column("revision", sa.BigInteger, nullable=False, index=True),
    )


def _create_recordings() -> None:
    op.create_table(
        "rholoc_recordings",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("files", sa.JSON, nullable=False),
        sa.Column("size_bytes", sa.BigInteger, nullable=False),
        sa.Column("created", sa.Float, nullable=False),
    )
    op.create_table(
        "rholoc_recording_notes",
        sa.Column("recording", sa.String(32), primary_key=True),
        sa.Column("file", sa.String(100), primary_key=True),
        sa.Column("content", sa.LargeBinary, nullable=False),
    )
    op.create_table(
        "rholoc_uploads",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("file_name", sa.Text, nullable=False),
        sa.Column("length", sa.BigInteger, nullable=False),
        sa.Column("offset", sa.BigInteger, nullable=False),
        sa.Column("map_name", sa.Text, nullable=False),
        sa.Column("options", sa.JSON, nullable=False),
        sa.Column("touched", sa.Float, nullable=False),
    )
    op.create_table(
        "rholoc_upload_pieces",
        sa.Column("upload", sa.String(32), primary_key=True),
        sa.Column("start", sa.BigInteger, primary_key=True),
        sa.Column("size_bytes", sa.BigInteger, nullable=False),
        sa.Column("blob", sa.String(32), nullable=False),
    )


def _create_accounts() -> None:
    op.create_table(
        "rholoc_changes",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer, "sqlite"), primary_key=True),
        sa.Column("time", sa.Float, nullable=False),
        sa.Column("who", sa.Text, nullable=False),
        sa.Column("method", sa.String(8), nullable=False),
        sa.Column("path", sa.Text, nullable=False),
        sa.Column("status", sa.Integer, nullable=False),
        sa.Column("job", sa.String(64), nullable=False),
        sa.Column("request_id", sa.String(64), nullable=False),
    )
    op.create_table(
        "rholoc_holdings",
        sa.Column("kind", sa.String(16), primary_key=True),
        sa.Column("name", sa.String(64), primary_key=True),
        sa.Column("key", sa.String(64), nullable=False, index=True),
        sa.Column("holder", sa.String(64), nullable=False, index=True),
        sa.Column("size_bytes", sa.BigInteger, nullable=False),
    )
