"""Maps that learn from their users: what is kept of their queries, and the jobs that learn from it."""

from dataclasses import asdict
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from pydantic import Field

from rholoc.errors import (
    Conflict,
    InvalidInput,
    InvalidMap,
    InvalidName,
    StorageFull,
    StorageUnavailable,
    UnknownMap,
)
from rholoc.mapping.learn.from_queries import MIN_QUERIES
from rholoc.reports import LearningReport
from rholoc.service.access.scopes import NEEDS_MAP, NEEDS_READ, request_key
from rholoc.service.http.models import AnswerModel
from rholoc.service.http.openapi import declared
from rholoc.service.maps.job_events import JobOut, begun, job_out
from rholoc.service.state import Service


class LearningOut(AnswerModel):
    """What is kept for a map to learn from, and what it last learned."""

    map: str
    learns: bool = Field(description="whether this server keeps queries for its maps to learn from")
    queries: int = Field(description="how many are kept for this map")
    size_bytes: int
    askers: int = Field(description="how many asked them")
    oldest: float | None = Field(description="s since the epoch")
    newest: float | None = Field(description="s since the epoch")
    fewest: int = Field(description="how many a map learns from at least")
    last: LearningReport | None = Field(description="what the map last learned from its users")
    job: str | None = Field(description="the id of the job by which it is learning now, or will be")
    latest: JobOut | None = Field(
        description="the job by which it last learned from its users, or could not: its `error` says why; null where "
        "there was none, or it was deleted"
    )


class DeletedQueries(AnswerModel):
    """How many queries were deleted."""

    deleted: int


router = APIRouter(prefix="/v1/maps", tags=["maps"])
_FAILURES = (UnknownMap, InvalidName, InvalidMap)


@router.post(
    "/{map_name}/learn",
    status_code=202,
    **declared(NEEDS_MAP, "Let a map learn from its users", *_FAILURES, InvalidInput, Conflict, StorageFull),
)
async def learn_from_users(map_name: str, request: Request, service: Service, response: Response) -> JobOut:
    """A job learns from the queries that are kept for the map: it adds views and landmarks that were seen often, and
    removes landmarks that many should have seen and did not. `Location` names the job. The map's next version replaces
    the present one, unless it localizes queries that were held back worse; then the job fails and says by how much. If
    the setting `learn` is on, maps learn by themselves each night."""
    key = request_key(request.scope)
    job = await service.jobs.begin(key, map_name, lambda _: service.learning.submit(map_name))
    return begun(job, response)


@router.get(
    "/{map_name}/learning",
    **declared(NEEDS_READ, "What is kept for a map to learn from", *_FAILURES, StorageUnavailable),
)
async def get_learning(map_name: str, service: Service) -> LearningOut:
    """How many queries are kept, of how many askers, what the map last learned from its users, and when."""
    found = await service.learning.get(map_name)
    from_users = [report for report in found.info.report.learned if report.queries is not None]
    return LearningOut(
        map=map_name,
        learns=service.learning.listens,
        **asdict(found.kept),
        fewest=MIN_QUERIES,
        last=from_users[-1] if from_users else None,
        job=None if found.job is None else found.job.id,
        latest=None if found.latest is None else job_out(found.latest),
    )


@router.delete("/{map_name}/learning", **declared(NEEDS_MAP, "Delete what is kept for a map to learn from", *_FAILURES))
async def delete_learning(
    map_name: str,
    service: Service,
    asker: Annotated[
        str | None,
        Query(description="only what one asked: the name of a key, or an address where none is asked for"),
    ] = None,
) -> DeletedQueries:
    """Deletes the kept queries of a map for good. What the map has learned already stays: restore a version before, or
    forget the source `queries`.
    """
    return DeletedQueries(deleted=await service.learning.delete(map_name, asker))
