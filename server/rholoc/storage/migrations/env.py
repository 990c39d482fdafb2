"""Alembic's environment: runs migrations on the given connection, in the caller's transaction."""

from __future__ import annotations

from alembic import context

from rholoc.storage.tables import VERSION_TABLE, metadata

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    version_table=VERSION_TABLE,
    render_as_batch=True,
)
with context.begin_transaction():
    context.run_migrations()
