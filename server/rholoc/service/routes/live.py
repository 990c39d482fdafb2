"""Who is asking for poses, and where requests failed."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from dataclasses import asdict

from fastapi import APIRouter, Response
from fastapi.responses import StreamingResponse

from rholoc.errors import Conflict, InvalidName, UnknownMap
from rholoc.service.access import NEEDS_READ
from rholoc.service.live import Sighting
from rholoc.service.openapi import failures
from rholoc.service.schemas import FailureOut, FailuresOut
from rholoc.service.state import Service, State

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
    dependencies=[NEEDS_READ],
    summary="Who asks for poses now",
    response_class=Response,
    responses={
        200: {
            "description": "Server-sent events.",
            "content": {"text/event-stream": {"schema": {"type": "string"}, "example": _EVENT}},
        },
        **failures(UnknownMap, InvalidName, Conflict),
    },
)
async def watch_poses(map_name: str, service: Service) -> Response:
    """Server-sent events `poses`, at most ten a second, each with the last answer to every client that was answered in
    this map since the event before: by the name of its key, or its address where no key is required. An answer without
    a pose has the client's last one, and `localized` false. Only if the setting `live` is on; nothing is stored."""
    service.library.stat(map_name)
    first = service.live.after(map_name, 0)
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(_events(map_name, first, service), headers=headers, media_type="text/event-stream")


async def _events(map_name: str, first: list[Sighting], service: State) -> AsyncIterator[str]:
    found, quiet_s = first, _QUIET_S
    while True:
        seen = service.live.number
        if found:
            yield f"event: poses\ndata: {json.dumps([_shown(one) for one in found])}\n\n"
            quiet_s = 0.0
        elif quiet_s >= _QUIET_S:
            yield ": still here\n\n"  # or a proxy would take the connection for dead
            quiet_s = 0.0
        await asyncio.sleep(_EVERY_S)
        quiet_s += _EVERY_S
        found = service.live.after(map_name, seen)


def _shown(sighting: Sighting) -> dict[str, object]:
    members = asdict(sighting)
    del members["number"], members["map"]
    return members


@router.get(
    "/{map_name}/failures",
    dependencies=[NEEDS_READ],
    summary="Where requests of the last day failed",
    responses=failures(UnknownMap, InvalidName, Conflict),
)
async def list_failures(map_name: str, service: Service) -> FailuresOut:
    """The requests that found no pose, or one of a confidence below 0.8: where that was, and nothing else. Without a
    pose, that is the position of the request's prior, or the client's last pose. Only if the setting `keep_failures` is
    on, and only since this server started."""
    service.library.stat(map_name)
    return FailuresOut(
        failures=[
            FailureOut(
                time=one.time,
                position=one.position,
                heading=one.heading,
                confidence=one.confidence,
                reason=one.reason,
            )
            for one in service.live.failures(map_name)
        ]
    )
