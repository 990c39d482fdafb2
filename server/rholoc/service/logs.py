"""The service's log: one JSON object a line, on the standard error."""

from __future__ import annotations

import sys

import structlog


def configure_logs() -> None:
    """Let every structlog logger of this process write JSON lines with level, UTC time and plain tracebacks."""
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            structlog.processors.JSONRenderer(),
        ],
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
    )
