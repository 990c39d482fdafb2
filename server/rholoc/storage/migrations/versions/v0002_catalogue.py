"""The catalogue of what lies in object storage: maps and their versions, small files, recordings, uploads."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    """Make the tables."""
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
    _create_recordings()


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
