"""Who changed what."""

from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import Field

from rholoc.errors import InvalidName
from rholoc.maps import check_map_name
from rholoc.service.access.scopes import NEEDS_ADMIN
from rholoc.service.http.models import AnswerModel
from rholoc.service.http.openapi import declared
from rholoc.service.state import Service


class ChangeOut(AnswerModel):
    """A request that changed something."""

    time: float = Field(description="s since the epoch")
    who: str = Field(description="the name of the API key, or the address where no key is needed")
    method: str
    path: str
    status: int = Field(description="of the answer")
    job: str = Field(description="the job that it began, empty where it began none")
    request_id: str


class ChangesOut(AnswerModel):
    """The last changes, the newest first."""

    changes: list[ChangeOut]


router = APIRouter(prefix="/v1/audit", tags=["service"])


@router.get("", **declared(NEEDS_ADMIN, "Who changed what", InvalidName))
async def list_changes(
    service: Service,
    limit: Annotated[int, Query(ge=1, le=1000, description="how many at most", examples=[100])] = 100,
    map: Annotated[str | None, Query(description="changes of this map alone", examples=["hall"])] = None,
) -> ChangesOut:
    """The last requests that changed something, the newest first: maps, sites, cameras, recordings, jobs, keys."""
    name = None if map is None else check_map_name(map)
    changes = await service.audit.changes(limit, name)
    return ChangesOut.model_validate({"changes": changes})
