"""How many streams of frames are open."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rholoc.errors import Busy

_RETRY_AFTER_S = 5.0


class OpenStreams:
    """Counts the open streams, and limits them. Use it from the event loop's thread only."""

    def __init__(self, most: int) -> None:
        self._most = most
        self.count = 0

    @contextmanager
    def one_more(self) -> Iterator[None]:
        """Count a stream for as long as it is open.

        Raises:
            Busy: the limit is reached.
        """
        if self.count >= self._most:
            raise Busy(f"{self._most} streams are open, the most allowed.", "Try again later.", _RETRY_AFTER_S)
        self.count += 1
        try:
            yield
        finally:
            self.count -= 1
