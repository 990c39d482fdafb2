"""Cacheable responses, and responses with files that may be replaced or deleted while they are sent."""

import os
import re
from pathlib import Path

from fastapi import Request, Response
from starlette.responses import FileResponse
from starlette.types import Receive, Scope, Send

_SPAN = re.compile(r"\s*(?:(\d{1,18})-(\d{1,18})?|-\d{1,18})\s*")


class OpenedFile(FileResponse):
    """A file as it was when it was opened: its length, its content and its tag are of one version.

    A ``Range`` that is not understood is ignored (RFC 9110, section 14.2), and all of it sent.

    Raises:
        FileNotFoundError: the file does not exist.
    """

    def __init__(self, path: Path, headers: dict[str, str], media_type: str) -> None:
        self._descriptor = os.open(path, os.O_RDONLY)
        try:
            status = os.fstat(self._descriptor)
            # This name opens the same file even after it was deleted.
            same = f"/proc/self/fd/{self._descriptor}"
            super().__init__(same, headers=headers, media_type=media_type, stat_result=status)
        except BaseException:
            os.close(self._descriptor)
            raise

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the file, and close it."""
        headers = [
            (name, value) for name, value in scope["headers"] if name != b"range" or _is_range(value.decode("latin-1"))
        ]
        try:
            await super().__call__({**scope, "headers": headers}, receive, send)
        finally:
            os.close(self._descriptor)


def _is_range(value: str) -> bool:
    """Whether a ``Range`` header holds spans of bytes, none of which ends before it begins."""
    unit, _, spans = value.partition("=")
    found = [_SPAN.fullmatch(span) for span in spans.split(",")]
    return unit.strip().lower() == "bytes" and all(
        span is not None and (span[1] is None or span[2] is None or int(span[1]) <= int(span[2])) for span in found
    )


def caching_headers(etag: str) -> dict[str, str]:
    """Headers that let a browser cache the answer of this tag, and make it revalidate that before each use."""
    return {"ETag": etag, "Cache-Control": "private, no-cache"}


def is_kept(request: Request, etag: str) -> bool:
    """Whether the browser has this version already: its ``If-None-Match`` names the tag, or "*"."""
    kept = {tag.strip().removeprefix("W/") for tag in request.headers.get("if-none-match", "").split(",")}
    return etag in kept or "*" in kept


def unchanged(etag: str) -> Response:
    """The answer 304 to a browser that has this version already."""
    return Response(status_code=304, headers=caching_headers(etag))
