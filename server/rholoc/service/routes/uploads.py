"""Resumable uploads of recordings: tus 1.0, beside the plain upload at the same path."""

import math
from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Header, Request, Response
from starlette.requests import ClientDisconnect

from rholoc.errors import Conflict, InvalidRecording, StorageFull, TooLarge, UnknownRecording
from rholoc.service.access.scopes import NEEDS_MAP, NEEDS_READ, request_key
from rholoc.service.errors import ChecksumMismatch, InvalidRequest, UnsupportedMediaType, UnsupportedVersion
from rholoc.service.http import tus
from rholoc.service.http.bodies import limited_stream, media_type, read_body
from rholoc.service.http.openapi import BINARY, declared, request_body
from rholoc.service.routes.intake import RecordingFields, checked_options
from rholoc.service.state import Service, State
from rholoc.storage.holdings_table import Kind

router = APIRouter(prefix="/v1/recordings", tags=["recordings"])

_PIECE_BYTES = 2**20  # written at once
_FILE_NAME = "filename"


@router.options("", status_code=204, **declared(NEEDS_MAP, "What resumable uploads can do here"))
@router.options("/{recording}", dependencies=[NEEDS_READ], status_code=204, include_in_schema=False)
async def upload_abilities(service: Service) -> Response:
    """What uploads may be: tus 1.0's version, extensions, checksums, and the largest upload, in headers."""
    return Response(status_code=204, headers=tus.abilities(service.settings.max_upload_bytes))


async def begin_upload(request: Request, service: State) -> Response:
    """Create a resumable upload by the request's headers; the answer is 201 with its address.

    Raises:
        InvalidRequest, TooLarge, QuotaExceeded: no length or a wrong one, or more than there is room for.
        InvalidRecording, InvalidName, InvalidInput, UnknownCamera, UnknownMap, InvalidMap: the fields are not valid.
    """
    length = tus.number("Upload-Length", request.headers.get("upload-length"))
    limit = service.settings.max_upload_bytes
    if length > limit:
        raise TooLarge(f"{length} bytes are more than the {limit} that are allowed.", "Record a shorter walk.")
    metadata = tus.read_metadata(request.headers.get("upload-metadata", ""))
    known = {name: value for name, value in metadata.items() if name in RecordingFields.model_fields}
    fields = RecordingFields.model_validate(known)
    if _FILE_NAME not in metadata:
        raise InvalidRequest("Upload-Metadata has no filename.", "Send filename and map, each with base64.")
    options = await checked_options(fields, service)
    key, quotas = request_key(request.scope), service.quotas
    async with quotas.counting(key):
        await quotas.check_upload(key, math.ceil(service.settings.max_unfinished_uploads / 4))
        await quotas.check(key, None, length, fields.map)
        upload = await service.recordings.begin_upload(metadata[_FILE_NAME], length, fields.map, options)
        await quotas.hold(key, Kind.RECORDING, upload.id, length)
        await quotas.hold_job(key, upload.id, fields.map)
    headers = {"Location": f"{router.prefix}/{upload.id}", **tus.standing(upload)}
    return Response(status_code=201, headers=headers)


@router.head(
    "/{recording}",
    response_class=Response,
    **declared(
        NEEDS_READ,
        "Where an upload stands",
        InvalidRecording,
        UnknownRecording,
        TooLarge,
        StorageFull,
        UnsupportedVersion,
    ),
)
async def upload_standing(recording: str, service: Service) -> Response:
    """How far an upload is, in headers: `Upload-Offset`, `Upload-Length`, `Upload-Expires`; once it is whole, its
    mapping job's id in `Rholoc-Job`.
    """
    upload = await service.recordings.upload(recording)
    return Response(headers=tus.standing(upload))


@router.patch(
    "/{recording}",
    status_code=204,
    openapi_extra=request_body({tus.PATCH_TYPE: {"schema": BINARY}}),
    **declared(
        NEEDS_MAP,
        "Go on with an upload",
        InvalidRecording,
        UnknownRecording,
        Conflict,
        TooLarge,
        StorageFull,
        UnsupportedMediaType,
        UnsupportedVersion,
        ChecksumMismatch,
    ),
)
async def continue_upload(
    recording: str,
    request: Request,
    service: Service,
    upload_offset: Annotated[str | None, Header(description="where the body's first byte belongs")] = None,
    upload_checksum: Annotated[
        str | None, Header(description="algorithm and base64; the body is kept if right")
    ] = None,
) -> Response:
    """Appends the next bytes of an upload. What arrived before a connection broke is kept, and `HEAD` says how much
    that is; a body with `Upload-Checksum` is kept whole or not at all. The last byte completes the recording, and
    starts its job.
    """
    if media_type(request) != tus.PATCH_TYPE:
        raise UnsupportedMediaType(
            "The bytes of an upload must be sent as " + tus.PATCH_TYPE + ".", "Use a tus client."
        )
    offset = tus.number("Upload-Offset", upload_offset)
    # Errors are raised before the bytes arrive.
    upload = await service.recordings.append(recording, offset, b"")
    left = upload.length - offset
    if upload_checksum is None:
        pieces = _pieces(request, left)
    else:
        pieces = _checked(request, min(left, service.settings.max_request_bytes), upload_checksum)
    async for piece in pieces:
        upload = await service.recordings.append(recording, offset, piece)
        offset += len(piece)
    return Response(status_code=204, headers=tus.standing(upload))


@router.delete(
    "/{recording}",
    status_code=204,
    **declared(NEEDS_MAP, "Delete a recording, or give up its upload", UnknownRecording, Conflict, UnsupportedVersion),
)
async def delete_recording(recording: str, service: Service) -> Response:
    """Deletes a recording or an unfinished upload for good, unless a job is waiting for it or working on it. Maps made
    from it stay.
    """
    await service.recordings.delete(recording)
    return Response(status_code=204)


async def _pieces(request: Request, max_bytes: int) -> AsyncIterator[bytes]:
    """Iterate over the body in pieces of at least 1 MiB, then the rest. If the sender breaks off, yields the rest that
    arrived and raises ClientDisconnect.
    """
    piece = bytearray()
    try:
        async for chunk in limited_stream(request, max_bytes):
            piece += chunk
            if len(piece) >= _PIECE_BYTES:
                yield bytes(piece)
                piece.clear()
    except ClientDisconnect:
        yield bytes(piece)
        raise
    yield bytes(piece)


async def _checked(request: Request, max_bytes: int, checksum: str) -> AsyncIterator[bytes]:
    """Yield the whole body, if it matches its checksum. Raises InvalidRequest, ChecksumMismatch, TooLarge."""
    body = await read_body(request, max_bytes)
    tus.check_checksum(checksum, body)
    yield body
