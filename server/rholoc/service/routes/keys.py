"""Temporary keys to hand on, to a phone or to someone who is to see a map, and QR codes for their links."""

import time
from dataclasses import asdict
from typing import Any

from fastapi import APIRouter, Request, Response
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from rholoc.errors import Busy, Conflict, InvalidInput, InvalidName, NotFound, StorageFull
from rholoc.service.access.keys import ApiKey, KeyLimits, Scope
from rholoc.service.access.scopes import NEEDS_ADMIN, NEEDS_MAP, NEEDS_READ, forbidden, granted_key, request_key
from rholoc.service.errors import QuotaExceeded
from rholoc.service.http.models import AnswerModel, Number, RequestModel
from rholoc.service.http.openapi import declared
from rholoc.service.qr_code import qr_svg
from rholoc.service.state import Service, State


class KeyLimitsIn(RequestModel):
    """How much a key allows, with all keys that it handed on; what is null or missing is not limited."""

    requests_per_s: Number | None = Field(
        default=None, ge=0.001, le=1e6, description="requests a second, to each server"
    )
    burst: int | None = Field(
        default=None, ge=1, le=10**6, description="how many requests may come at once; default: those of a second"
    )
    maps: int | None = Field(default=None, ge=0, le=10**9, description="maps, with those that its jobs will publish")
    stored_bytes: int | None = Field(default=None, ge=0, le=2**53, description="bytes of maps and recordings")
    jobs: int | None = Field(default=None, ge=0, le=10**9, description="jobs that are queued or running")


class KeyLimitsOut(KeyLimitsIn):
    """How much a key allows; null: not limited."""


class KeyUsageOut(AnswerModel):
    """What a key holds, with all keys that it handed on."""

    maps: int = Field(description="with those that its jobs will publish")
    stored_bytes: int = Field(description="of maps and recordings; an unfinished upload counts whole")
    jobs: int = Field(description="queued or running, or to come with an unfinished upload")


class KeyIn(RequestModel):
    """A key to hand on."""

    scope: Scope = Field(default=Scope.READ, description="what it allows; no more than the request's own key")
    lifetime_s: Number = Field(
        default=86400, ge=60, le=31 * 86400, description="how long it is valid, s: a minute to 31 days"
    )
    name: str | None = Field(
        default=None, max_length=50, description="what its name ends in, after `handed-`; null: a random one"
    )
    site: str | None = Field(
        default=None, max_length=100, description="the only site that a key of scope `visit` is for; null: any"
    )
    limits: KeyLimitsIn = Field(
        default_factory=KeyLimitsIn, description="how much it allows; never more than the request's own key"
    )


class KeyOut(AnswerModel):
    """A key's name, and what it allows."""

    name: str
    scope: Scope
    created: float = Field(description="s since the epoch")
    expires: float | None = Field(description="s since the epoch; null: never")
    limits: KeyLimitsOut = Field(description="how much it allows")
    site: str | None = Field(default=None, description="the only site that it is for; null: any")
    handed_on_by: str | None = Field(default=None, description="the name of the key that handed it on; null: none did")


class KeyDetail(KeyOut):
    """A key, and what it holds."""

    used: KeyUsageOut


class KeyList(AnswerModel):
    """All keys, the oldest first."""

    keys: list[KeyOut]


class HandedKeyOut(AnswerModel):
    """A key that was handed on."""

    key: str | None = Field(description="the key; null where the server requires none")
    name: str | None = Field(description="the name to revoke it by")
    scope: Scope
    expires: float | None = Field(description="s since the epoch")


class QrIn(RequestModel):
    """A text for a QR code."""

    text: str = Field(min_length=1, max_length=1000)


router = APIRouter(prefix="/v1", tags=["keys"])

_SVG = "image/svg+xml"


@router.post(
    "/keys",
    status_code=201,
    **declared(NEEDS_MAP, "Hand on a key that expires", InvalidName, Conflict, QuotaExceeded, Busy, StorageFull),
)
async def hand_on_key(wanted: KeyIn, request: Request, service: Service) -> HandedKeyOut:
    """A new key, which allows no more than the key of the request and expires no later. It is shown only once. Where
    the server requires no keys, `key` is null."""
    held, expires, needed = granted_key(request)
    if not held.allows(wanted.scope):
        raise forbidden(held, wanted.scope)
    if not needed:
        return HandedKeyOut(key=None, name=None, scope=wanted.scope, expires=None)
    lifetime_s = wanted.lifetime_s if expires is None else min(wanted.lifetime_s, expires - time.time())
    by = request_key(request.scope)
    limits, site = _limits(wanted.limits), wanted.site or ""
    name, key = await service.keys.hand_on(wanted.scope, lifetime_s, limits, by, site, wanted.name or "")
    return HandedKeyOut(key=key, name=name, scope=wanted.scope, expires=time.time() + lifetime_s)


@router.get("/keys", **declared(NEEDS_ADMIN, "All keys"))
async def list_keys(service: Service) -> KeyList:
    """Their names, scopes, limits and expiry, the oldest first, and who handed them on; never the keys, which are only
    hashes here.
    """
    return KeyList(keys=[KeyOut(**_fields(key, service)) for key in await service.keys.list()])


@router.get("/keys/{name}", **declared(NEEDS_ADMIN, "One key", NotFound))
async def get_key(name: str, service: Service) -> KeyDetail:
    """How much the key allows, and what it holds: maps, recordings and jobs."""
    return await _detail(service, name)


@router.put("/keys/{name}/limits", **declared(NEEDS_ADMIN, "Limit a key", NotFound, StorageFull))
async def limit_key(name: str, wanted: KeyLimitsIn, service: Service) -> KeyDetail:
    """Sets all limits of the key, from the next request on; those that are missing are lifted. What it holds stays,
    even where it is more than it may.
    """
    await service.keys.limit(name, _limits(wanted))
    return await _detail(service, name)


@router.delete("/keys/{name}", status_code=204, **declared(NEEDS_ADMIN, "Revoke a key", NotFound))
async def revoke_key(name: str, service: Service) -> None:
    """Revokes the key and all keys that it handed on. They are refused from the next request on, their streams end
    within a second, and their unfinished uploads are abandoned.
    """
    await service.keys.revoke(name)
    service.streams.end_invalid()
    await service.keys.abandon_uploads()


@router.post(
    "/qr",
    **declared(
        NEEDS_READ,
        "A text as a QR code",
        InvalidInput,
        also={
            200: {
                "description": "A picture.",
                "content": {_SVG: {"schema": {"type": "string"}, "example": "<svg …></svg>"}},
            }
        },
    ),
)
async def draw_qr(wanted: QrIn) -> Response:
    """A QR code of a text, for links that a phone is to open; in black on white, whatever the page's colours are."""
    return Response(await run_in_threadpool(qr_svg, wanted.text), media_type=_SVG)


async def _detail(service: State, name: str) -> KeyDetail:
    key, used = await service.keys.get(name)
    return KeyDetail(**_fields(key, service), used=KeyUsageOut(**asdict(used)))


def _fields(key: ApiKey, service: State) -> dict[str, Any]:
    return {
        "name": key.name,
        "scope": key.scope,
        "created": key.created,
        "expires": key.expires,
        "limits": KeyLimitsOut(**asdict(key.limits)),
        "site": key.site or None,
        "handed_on_by": next((one.name for one in service.keys.chain(key)[1:]), None),
    }


def _limits(wanted: KeyLimitsIn) -> KeyLimits:
    return KeyLimits(**wanted.model_dump())
