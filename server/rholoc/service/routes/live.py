"""Who is asking for poses, and where requests failed."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from dataclasses import asdict
from functools import lru_cache

from fastapi import APIRouter, Request, Response
from pydantic import Field

from rholoc.errors import Conflict, InvalidName, UnknownMap
from rholoc.service.access.open_streams import EventStream, StreamKind
from rholoc.service.access.scopes import NEEDS_READ
from rholoc.service.frames.live import Sighting
from rholoc.service.http.models import AnswerModel
from rholoc.service.http.openapi import declared, event_stream
from rholoc.service.state import Service, State


class FailureOut(AnswerModel):
    """A request that found no pose, or an unsure one."""

    time: float = Field(description="s since the epoch")
    position: list[float] | None = Field(description="m; null where it is not known")
    heading: list[float] | None = Field(description="where the camera looked; null where that is not known")
    confidence: float
    reason: str | None = Field(description="why there is no pose; null where there is an unsure one")


class FailuresOut(AnswerModel):
    """The failures of the last day, the oldest first."""

    failures: list[FailureOut]


router = APIRouter(prefix="/v1/maps", tags=["maps"])

_EVERY_S = 0.1  # answers in between are sent together
_QUIET_S = 15.0
_EVENT = (
    'event: poses\ndata: [{"asker": "robot-7", "time": 1767607200.0, "localized": true, "reason": null, '
    '"confidence": 0.97, "sigma_m": 0.011, "position": [1.2, 0.4, 1.5], "heading": [1, 0, 0], '
    '"T_map_camera": [[0, 0, 1, 1.2], [-1, 0, 0, 0.4], [0, -1, 0, 1.5], [0, 0, 0, 1]]}]\n\n'
)


@router.get(
    "/{map_name}/live",
    **declared(
        NEEDS_READ,
        "Who asks for poses now",
        UnknownMap,
        InvalidName,
        Conflict,
        also=event_stream(_EVENT),
    ),
)
async def watch_poses(map_name: str, request: Request, service: Service) -> Response:
    """Server-sent events `poses`, at most ten a second, each with the last answer to every client that was answered in
    this map since the event before: by the name of its key, or its address where no key is required. An answer without
    a pose has no position, and `localized` false. Only if the setting `live` is on; nothing is stored."""
    await service.maps.stat(map_name)
    first = service.frames.live.after(map_name, 0)
    stream = service.streams.admit(StreamKind.EVENTS, request.scope)
    return EventStream(_events(map_name, first, service), service.streams, stream)


async def _events(map_name: str, first: list[Sighting], service: State) -> AsyncIterator[str]:
    live, found = service.frames.live, first
    while True:
        seen, changed = live.number, live.changed
        # A proxy would take a connection on which nothing comes for dead.
        yield _event(tuple(found)) if found else ": still here\n\n"
        while not (found := live.after(map_name, seen)):
            seen, changed = live.number, live.changed
            try:
                async with asyncio.timeout(_QUIET_S):
                    await changed.wait()
            except TimeoutError:
                break
            await asyncio.sleep(_EVERY_S)


@lru_cache(maxsize=8)  # all who watch a map are sent the same
def _event(sightings: tuple[Sighting, ...]) -> str:
    return f"event: poses\ndata: {json.dumps([_shown(one) for one in sightings])}\n\n"


def _shown(sighting: Sighting) -> dict[str, object]:
    members = asdict(sighting)
    del members["number"], members["map"]
    return members


@router.get(
    "/{map_name}/failures",
    **declared(NEEDS_READ, "Where requests of the last day failed", UnknownMap, InvalidName, Conflict),
)
async def list_failures(map_name: str, service: Service) -> FailuresOut:
    """The requests that found no pose, or one of a confidence below 0.8: where that was, and nothing else. Without a
    pose, that is the position of the request's prior, or null. Only if the setting `keep_failures` is on, and only
    since this server started."""
    await service.maps.stat(map_name)
    return FailuresOut.model_validate({"failures": service.frames.live.failures(map_name)})
