"""Logs: one JSON object a line, on the standard error."""

import json
import logging
from datetime import UTC, datetime

_OF_EVERY_RECORD = vars(logging.makeLogRecord({})).keys() | {"message", "taskName"}


class _JsonLines(logging.Formatter):
    """Records as JSON: event, logger, level, UTC time, a plain traceback, and what ``extra`` says."""

    def format(self, record: logging.LogRecord) -> str:
        """The record as one line of JSON."""
        line = {name: value for name, value in vars(record).items() if name not in _OF_EVERY_RECORD}
        line |= {"event": record.getMessage(), "logger": record.name, "level": record.levelname.lower()}
        line["timestamp"] = datetime.fromtimestamp(record.created, UTC).isoformat().replace("+00:00", "Z")
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, default=repr)


def configure_logs() -> None:
    """Write the lines of rholoc's own loggers (level INFO), unless the process that runs them writes lines already."""
    own = logging.getLogger("rholoc")
    own.setLevel(logging.INFO)
    own.handlers = [] if logging.getLogger().handlers else [_handler()]


def configure_process_logs() -> None:
    """Write the lines of all loggers (level INFO), those of libraries included: for a process that is all ours."""
    root = logging.getLogger()
    root.setLevel(logging.INFO)
    root.handlers = [_handler()]


def _handler() -> logging.Handler:
    """Handler that writes JSON lines to standard error."""
    handler = logging.StreamHandler()
    handler.setFormatter(_JsonLines())
    return handler
