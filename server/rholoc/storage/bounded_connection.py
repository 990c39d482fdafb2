"""A PostgreSQL connection with a timeout for every answer, in case the server's machine hangs."""

from typing import Any, TypeVar

import psycopg
from psycopg.abc import PQGen
from psycopg.errors import OperationalError, _WaitTimeout

Answer = TypeVar("Answer")

STATEMENT_TIMEOUT_S = 4.0
"""Time after which the server itself cancels a statement."""

_WAKE_S = 0.1  # interval at which a wait checks for signals
_ANSWER_TIMEOUT_S = 5.0  # longer than the server's own, whose message says why


class AnswerTimeout(OperationalError):
    """The server did not answer a statement, not even by cancelling it."""


class BoundedConnection(psycopg.Connection[Any]):
    """Connection with a timeout for each answer. TCP's and the server's own timeouts do not suffice: the operating
    system of a stopped server still acknowledges packets."""

    def wait(self, gen: PQGen[Answer], interval: float = _WAKE_S, timeout: float | None = None) -> Answer:
        """Run the exchange ``gen`` with the server, as psycopg's own ``wait`` does; ``timeout`` None stands for 5 s.

        Raises:
            AnswerTimeout: no answer in these 5 s; the connection is closed.
        """
        if timeout is not None:
            return super().wait(gen, interval, timeout)
        try:
            return super().wait(gen, interval, _ANSWER_TIMEOUT_S)
        except _WaitTimeout:
            self.pgconn.finish()
            raise AnswerTimeout(f"no answer within {_ANSWER_TIMEOUT_S:g} s") from None
