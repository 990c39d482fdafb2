"""What clients hold open: streams and unfinished uploads, for administrators."""

from __future__ import annotations

from fastapi import APIRouter

from rholoc.errors import NotFound
from rholoc.service.access.scopes import NEEDS_ADMIN
from rholoc.service.errors import InvalidRequest
from rholoc.service.http.openapi import failures
from rholoc.service.schemas import OpenStreamList, OpenStreamOut, UploadList, UploadOut
from rholoc.service.state import Service

router = APIRouter(prefix="/v1", tags=["service"])


@router.get("/streams", dependencies=[NEEDS_ADMIN], summary="Open streams")
async def list_streams(service: Service) -> OpenStreamList:
    """The streams that are open to this server, the oldest first."""
    return OpenStreamList(
        streams=[
            OpenStreamOut(
                id=one.id,
                kind=one.kind,
                key=None if one.key is None else one.key.name,
                counted_to=one.client,
                path=one.path,
                since=one.since,
            )
            for one in service.streams.all()
        ]
    )


@router.delete(
    "/streams/{stream}",
    dependencies=[NEEDS_ADMIN],
    status_code=204,
    summary="End a stream",
    responses=failures(NotFound, InvalidRequest),
)
async def end_stream(stream: str, service: Service) -> None:
    """At once. Its client may open another; revoke its key to prevent that."""
    service.streams.end(stream)


@router.get("/uploads", dependencies=[NEEDS_ADMIN], summary="Unfinished uploads")
async def list_uploads(service: Service) -> UploadList:
    """The resumable uploads that are not complete. `DELETE /v1/recordings/{recording}` abandons one by its id."""
    found = await service.threads.database(service.quotas.uploads)
    return UploadList(
        uploads=[
            UploadOut(
                id=one.id,
                map=one.map,
                size_bytes=one.size_bytes,
                key=one.key or None,
                counted_to=one.holder or one.key or None,
            )
            for one in found
        ]
    )
