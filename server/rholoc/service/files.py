"""Responses with files that may be replaced or deleted while they are sent."""

from __future__ import annotations

import os
from pathlib import Path

from starlette.responses import FileResponse
from starlette.types import Receive, Scope, Send


class OpenedFile(FileResponse):
    """A file as it was when it was opened: its length, its content and its tag are of one version.

    Raises:
        FileNotFoundError: the file does not exist.
    """

    def __init__(self, path: Path, headers: dict[str, str], media_type: str) -> None:
        self._descriptor = os.open(path, os.O_RDONLY)
        try:
            status = os.fstat(self._descriptor)
            # This name opens the same file again, even once its own name is gone.
            same = f"/proc/self/fd/{self._descriptor}"
            super().__init__(same, headers=headers, media_type=media_type, stat_result=status)
        except BaseException:
            os.close(self._descriptor)
            raise

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the file, and close it."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            os.close(self._descriptor)
