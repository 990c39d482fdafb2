"""Who sent the request that is being answered."""

from __future__ import annotations

from contextvars import ContextVar

ASKER: ContextVar[str] = ContextVar("asker", default="")
"""Whose request is being answered: the name of its key, or its address where no key is required."""

CLIENT: ContextVar[str] = ContextVar("client", default="")
"""Whom the request that is being answered counts to."""
