"""Who is asking for poses, and where requests failed."""

import asyncio
import json
from collections.abc import AsyncIterator
from dataclasses import asdict
from functools import lru_cache

from fastapi import APIRouter, Request, Response
from pydantic import Field

from rholoc.errors import Busy, Conflict, InvalidMap, InvalidName, UnknownMap, UnknownPicture
from rholoc.localization import Cause
from rholoc.service.access.open_streams import EventStream, StreamKind
from rholoc.service.access.scopes import NEEDS_MAP, NEEDS_READ
from rholoc.service.frames.kept.live import Sighting
from rholoc.service.frames.kept.refusals import LikenessOut
from rholoc.service.http.models import AnswerModel
from rholoc.service.http.openapi import content, declared, event_stream
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


class RefusalOut(AnswerModel):
    """A picture that was refused."""

    number: int
    time: float = Field(description="s since the epoch")
    asker: str = Field(description="the name of the key, or the address where no key is required")
    cause: Cause
    message: str = Field(description="one sentence: what it looks like")
    hint: str = Field(description="one sentence: what to try")


class RefusalsOut(AnswerModel):
    """The refused pictures of the last day that are kept, the newest first."""

    refusals: list[RefusalOut]


router = APIRouter(prefix="/v1/maps", tags=["maps"])

_SHOWN = RefusalOut.model_fields
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
    service.frames.live.after(map_name, 0)  # raises Conflict before the stream begins
    stream = service.streams.admit(StreamKind.EVENTS, request.scope)
    return EventStream(_events(map_name, service), service.streams, stream)


async def _events(map_name: str, service: State) -> AsyncIterator[str]:
    live = service.frames.live
    found = live.after(map_name, 0)
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


@router.get(
    "/{map_name}/refusals", **declared(NEEDS_MAP, "Refused pictures of the last day", UnknownMap, InvalidName, Conflict)
)
async def list_refusals(map_name: str, service: Service) -> RefusalsOut:
    """The last pictures that this map refused, and why. Only if the setting `keep_refused` is above 0, and only since
    this server started."""
    await service.maps.stat(map_name)
    kept = [asdict(one) for one in service.frames.refusals.of_map(map_name)]
    return RefusalsOut.model_validate({"refusals": [{k: v for k, v in one.items() if k in _SHOWN} for one in kept]})


@router.get(
    "/{map_name}/refusals/{number}",
    **declared(
        NEEDS_MAP,
        "What a refused picture resembles",
        UnknownMap,
        InvalidName,
        InvalidMap,
        Conflict,
        UnknownPicture,
        Busy,
    ),
)
async def get_likeness(map_name: str, number: int, service: Service) -> LikenessOut:
    """The map's view that a refused picture resembles most, and the matches between the two."""
    return await service.frames.likeness(service.frames.refusals.get(map_name, number))


@router.get(
    "/{map_name}/refusals/{number}/picture.jpg",
    **declared(
        NEEDS_MAP, "A refused picture", UnknownMap, InvalidName, Conflict, UnknownPicture,
        also=content("A picture.", "image/jpeg"),
    ),
)  # fmt: skip
async def get_refused_picture(map_name: str, number: int, service: Service) -> Response:
    """A small copy of the picture that was refused."""
    return Response(service.frames.refusals.get(map_name, number).picture, media_type="image/jpeg")
