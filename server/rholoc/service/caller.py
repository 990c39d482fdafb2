"""Who sent the request that is being answered."""

from contextvars import ContextVar

ASKER: ContextVar[str] = ContextVar("asker", default="")
"""Sender of the current request: the name of its key, or its address where no key is required."""

CLIENT: ContextVar[str] = ContextVar("client", default="")
"""Client that the current request counts to: the name of its key's root, or its address where no key is required."""
