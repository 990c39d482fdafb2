"""A PostgreSQL connection whose server may fall silent, as a machine that hangs does."""

from __future__ import annotations

from typing import Any, TypeVar

import psycopg
from psycopg.abc import PQGen
from psycopg.errors import OperationalError, _WaitTimeout

Answer = TypeVar("Answer")

STATEMENT_TIMEOUT_S = 4.0
"""Time after which the server itself cancels a statement."""

_WAKE_S = 0.1  # how often a wait looks for signals
_ANSWER_TIMEOUT_S = 5.0  # later than the server's, so that a server that still works can say why


class AnswerTimeout(OperationalError):
    """The server did not answer a statement, not even by cancelling it."""


class BoundedConnection(psycopg.Connection[Any]):
    """Connection that waits for each answer for a bounded time. Neither TCP's nor the server's time-outs see to that:
    the system of a server that was stopped still acknowledges every packet."""

    def wait(self, gen: PQGen[Answer], interval: float = _WAKE_S, timeout: float | None = None) -> Answer:
        """Run the exchange ``gen`` with the server, as psycopg's own ``wait`` does.

        Raises:
            AnswerTimeout: no answer in time; the connection is closed.
        """
        if timeout is not None:
            return super().wait(gen, interval, timeout)
        try:
            return super().wait(gen, interval, _ANSWER_TIMEOUT_S)
        except _WaitTimeout:
            self.pgconn.finish()
            raise AnswerTimeout(f"no answer within {_ANSWER_TIMEOUT_S:g} s") from None
