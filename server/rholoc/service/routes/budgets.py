"""Open streams and unfinished uploads of clients, for administrators."""

from fastapi import APIRouter
from pydantic import Field

from rholoc.errors import NotFound
from rholoc.service.access.open_streams import StreamKind
from rholoc.service.access.scopes import NEEDS_ADMIN
from rholoc.service.http.models import AnswerModel
from rholoc.service.http.openapi import declared
from rholoc.service.state import Service


class OpenStreamOut(AnswerModel):
    """An open stream."""

    id: str
    kind: StreamKind = Field(description="`frames`: a WebSocket; `events`: server-sent events")
    key: str | None = Field(description="the name of the key that it was opened with; null where none is needed")
    counted_to: str = Field(description="the first of the keys that handed that key on, or an address")
    path: str
    since: float = Field(description="s since the epoch")


class OpenStreamList(AnswerModel):
    """The open streams of a server, the oldest first."""

    streams: list[OpenStreamOut]


class UploadOut(AnswerModel):
    """An unfinished upload."""

    id: str = Field(description="of the upload, and of the recording that it becomes")
    map: str = Field(description="the map that it is for")
    size_bytes: int = Field(description="once it is complete; 0 where no key is needed")
    key: str | None = Field(description="the name of the key that began it; null where none is needed")
    counted_to: str | None = Field(description="the first of the keys that handed that key on, or the key itself")


class UploadList(AnswerModel):
    """The unfinished uploads."""

    uploads: list[UploadOut]


router = APIRouter(prefix="/v1", tags=["service"])


@router.get("/streams", **declared(NEEDS_ADMIN, "Open streams"))
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


@router.delete("/streams/{stream}", status_code=204, **declared(NEEDS_ADMIN, "End a stream", NotFound))
async def end_stream(stream: str, service: Service) -> None:
    """Ends the stream at once. Its client may open another; revoke its key to prevent that."""
    service.streams.end(stream)


@router.get("/uploads", **declared(NEEDS_ADMIN, "Unfinished uploads"))
async def list_uploads(service: Service) -> UploadList:
    """The resumable uploads that are not complete. `DELETE /v1/recordings/{recording}` abandons one by its id."""
    found = await service.quotas.uploads()
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
