"""Headers of tus 1.0, the protocol of resumable uploads (tus.io/protocols/resumable-upload).

:class:`rholoc.jobs.UploadStore` keeps the uploads themselves.
"""

import base64
import hashlib
import hmac
from email.utils import formatdate

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rholoc.jobs import Upload
from rholoc.service.errors import TUS_VERSION, ChecksumMismatch, InvalidRequest, UnsupportedVersion

RESUMABLE = "Tus-Resumable"
JOB_HEADER = "Rholoc-Job"
PATCH_TYPE = "application/offset+octet-stream"
_EXTENSIONS = "creation,expiration,checksum,termination"
_CHECKSUMS = ("sha256", "sha1", "md5")
_OVERRIDE = "X-HTTP-Method-Override"


class Tus:
    """ASGI middleware for the protocol's requirements on every request and answer, method override included."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request; requests that do not speak tus pass unchanged. Raises UnsupportedVersion: the client
        speaks another version.
        """
        headers = Headers(scope=scope) if scope["type"] == "http" else {}
        if RESUMABLE not in headers:
            await self._app(scope, receive, send)
            return

        async def send_as_tus(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message)[RESUMABLE] = TUS_VERSION
            await send(message)

        if headers[RESUMABLE] != TUS_VERSION and scope["method"] != "OPTIONS":
            raise UnsupportedVersion(f"Tus {headers[RESUMABLE]} is not supported.", f"Use tus {TUS_VERSION}.")
        if scope["method"] == "POST" and headers.get(_OVERRIDE) in ("PATCH", "DELETE"):
            scope["method"] = headers[_OVERRIDE]
        await self._app(scope, receive, send_as_tus)


def abilities(max_bytes: int) -> dict[str, str]:
    """Headers with the server's capabilities; ``max_bytes`` is the largest upload."""
    return {
        RESUMABLE: TUS_VERSION,
        "Tus-Version": TUS_VERSION,
        "Tus-Extension": _EXTENSIONS,
        "Tus-Max-Size": str(max_bytes),
        "Tus-Checksum-Algorithm": ",".join(_CHECKSUMS),
    }


def standing(upload: Upload) -> dict[str, str]:
    """Headers with an upload's offset, length and expiry, and its job's id once there is one."""
    headers = {"Upload-Offset": str(upload.offset), "Upload-Length": str(upload.length), "Cache-Control": "no-store"}
    if upload.expires is not None:
        headers["Upload-Expires"] = formatdate(upload.expires, usegmt=True)
    if upload.job is not None:
        headers[JOB_HEADER] = upload.job.id
    return headers


def number(name: str, text: str | None) -> int:
    """The value of the header ``name``, a number of bytes. Raises InvalidRequest if it is missing or no such number."""
    if text is None or not text.isascii() or not text.isdigit() or len(text) > 18:
        raise InvalidRequest(f"{name} is missing or not a number of bytes.", "Send it as tus 1.0 requires.")
    return int(text)


def read_metadata(text: str) -> dict[str, str]:
    """``Upload-Metadata``: keys, each with its value, decoded from base64; empty without one.

    Raises:
        InvalidRequest: it is malformed.
    """
    pairs: dict[str, str] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        key, _, value = part.partition(" ")
        try:
            pairs[key] = base64.b64decode(value, validate=True).decode("utf-8")
        except ValueError as error:  # binascii.Error and UnicodeDecodeError, too
            raise InvalidRequest(
                f"Upload-Metadata: {key[:64]!r} is not base64 of UTF-8.", "Encode each value."
            ) from error
    return pairs


def check_checksum(text: str, data: bytes) -> None:
    """Compare bytes with their ``Upload-Checksum``.

    Raises:
        InvalidRequest: it is malformed, or of an algorithm that is not offered.
        ChecksumMismatch: the bytes are others.
    """
    algorithm, _, encoded = text.strip().partition(" ")
    if algorithm not in _CHECKSUMS:
        raise InvalidRequest(f"There is no checksum {algorithm[:32]!r} here.", f"Use one of {', '.join(_CHECKSUMS)}.")
    try:
        expected = base64.b64decode(encoded, validate=True)
    except ValueError as error:
        raise InvalidRequest("Upload-Checksum is not base64.", "Send the algorithm, a space, and base64.") from error
    if not hmac.compare_digest(hashlib.new(algorithm, data, usedforsecurity=False).digest(), expected):
        raise ChecksumMismatch("The bytes received do not match the checksum.", "Send them again.")
