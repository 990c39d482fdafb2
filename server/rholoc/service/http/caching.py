"""Answers that a browser may keep, and asks about again."""

from __future__ import annotations

from fastapi import Request, Response


def caching_headers(etag: str) -> dict[str, str]:
    """A browser may cache the answer, and revalidates it before each use."""
    return {"ETag": etag, "Cache-Control": "private, no-cache"}


def is_kept(request: Request, etag: str) -> bool:
    """Whether the browser already has this version."""
    kept = {tag.strip().removeprefix("W/") for tag in request.headers.get("if-none-match", "").split(",")}
    return etag in kept or "*" in kept


def unchanged(etag: str) -> Response:
    return Response(status_code=304, headers=caching_headers(etag))
