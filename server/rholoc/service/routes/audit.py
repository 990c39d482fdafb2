"""Who changed what."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from rholoc.errors import InvalidName
from rholoc.maps import check_map_name
from rholoc.service.access.scopes import NEEDS_ADMIN
from rholoc.service.http.openapi import failures
from rholoc.service.schemas import ChangeOut, ChangesOut
from rholoc.service.state import Service

router = APIRouter(prefix="/v1/audit", tags=["service"])


@router.get("", dependencies=[NEEDS_ADMIN], summary="Who changed what", responses=failures(InvalidName))
async def list_changes(
    service: Service,
    limit: Annotated[int, Query(ge=1, le=1000, description="how many at most", examples=[100])] = 100,
    map: Annotated[str | None, Query(description="changes of this map alone", examples=["hall"])] = None,
) -> ChangesOut:
    """The last requests that changed something, the newest first: maps, sites, cameras, recordings, jobs, keys."""
    name = None if map is None else check_map_name(map)
    changes = await service.threads.database(service.audit.changes, limit, name)
    return ChangesOut(changes=[ChangeOut.model_validate(one, from_attributes=True) for one in changes])
