"""Request bodies: read with a limit, streamed, multipart split into its parts."""

from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from email.message import Message
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request

from rholoc.errors import Busy, TooLarge
from rholoc.service.errors import InvalidRequest

_MAX_FIELD_BYTES = 2**16
_MAX_FIELDS = 100
_MAX_PART_HEADER_BYTES = 8192
_FRAME_BYTES = 2**20
_RETRY_AFTER_S = 2.0

FileSink = Callable[[str, str, bytes], None]
PieceListener = Callable[[bytes], None]


def media_type(request: Request) -> str:
    """The body's content type without parameters, lower case; empty if none is given."""
    message = Message()
    message["content-type"] = request.headers.get("content-type", "")
    return message.get_content_type() if request.headers.get("content-type") else ""


def declared_length(request: Request) -> int:
    """The body's length [bytes] by its header; 0 if there is none or it is no number."""
    declared = request.headers.get("content-length", "")
    return int(declared) if declared.isdecimal() else 0


async def limited_stream(request: Request, max_bytes: int) -> AsyncIterator[bytes]:
    """Iterate over the body's chunks.

    Raises:
        TooLarge: the body's length or declared length exceeds ``max_bytes``.
        ClientDisconnect: the sender broke off.
    """
    too_large = TooLarge(f"The body is longer than {max_bytes} bytes.", "Send less, or raise the service's limit.")
    if declared_length(request) > max_bytes:
        raise too_large
    received = 0
    async for chunk in request.stream():
        received += len(chunk)
        if received > max_bytes:
            raise too_large
        if chunk:
            yield chunk


class HeldBodies:
    """Limits the memory that the bodies of all requests in progress take together.

    Args:
        max_bytes: limit on the total size of all bodies beyond ``free_bytes`` each.
        free_bytes: part of each body that does not count: about the size of a camera's frame.
    """

    def __init__(self, max_bytes: int, free_bytes: int = _FRAME_BYTES) -> None:
        self._left = max_bytes
        self._free_bytes = free_bytes

    @contextmanager
    def hold(self) -> Iterator[PieceListener]:
        """Count one body within the block, beyond its first ``free_bytes``. Call the yielded function with each piece.

        Raises:
            Busy: raised by that function, if all bodies together exceed ``max_bytes``.
        """
        length = taken = 0

        def count(piece: bytes) -> None:
            nonlocal length, taken
            length += len(piece)
            more = max(0, length - self._free_bytes) - taken
            if more > self._left:
                raise Busy("Too many large requests are in progress.", "Try again after Retry-After.", _RETRY_AFTER_S)
            self._left -= more
            taken += more

        try:
            yield count
        finally:
            self._left += taken


async def read_body(request: Request, max_bytes: int, on_piece: PieceListener = lambda _: None) -> bytes:
    """The whole body; calls ``on_piece`` with each piece as it arrives. Raises the errors of ``on_piece``, TooLarge
    over ``max_bytes``, and ClientDisconnect.
    """
    chunks = []
    async for chunk in limited_stream(request, max_bytes):
        on_piece(chunk)
        chunks.append(chunk)
    return b"".join(chunks)


@dataclass(frozen=True)
class SavedBody:
    """A body in a file."""

    path: Path
    size_bytes: int


@asynccontextmanager
async def saved_body(request: Request, folder: Path, max_bytes: int) -> AsyncIterator[SavedBody]:
    """The body in a new file of a folder, made if missing; the file is removed at the end of the block.

    Raises:
        TooLarge: it is longer than ``max_bytes``. ClientDisconnect: the sender broke off.
        OSError: it cannot be written.
    """
    path, size_bytes = folder / uuid4().hex, 0

    def open_file() -> BinaryIO:
        folder.mkdir(parents=True, exist_ok=True)
        return path.open("xb")

    file = await run_in_threadpool(open_file)
    try:
        async for chunk in limited_stream(request, max_bytes):
            size_bytes += await run_in_threadpool(file.write, chunk)
        await run_in_threadpool(file.close)
        yield SavedBody(path, size_bytes)
    finally:
        await run_in_threadpool(file.close)
        await run_in_threadpool(path.unlink, missing_ok=True)


@dataclass
class _Part:
    name: str = ""
    filename: str | None = None
    headers: dict[bytes, bytes] = field(default_factory=dict)


@dataclass
class _Event:
    """An event of the parser: the start of a part (no data), or some of its data."""

    part: _Part
    data: bytes


class _Parts:
    """The callbacks of python-multipart, turned into a list of events."""

    def __init__(self, boundary: bytes, max_parts: int) -> None:
        self.events: list[_Event] = []
        self.ended = False
        self._parts_left = max_parts
        self._fields_left = _MAX_FIELDS
        self._header_bytes = 0
        self._part = _Part()
        self._header = b""
        self._value = b""
        self._parser = MultipartParser(
            boundary,
            {
                "on_part_begin": self._begin,
                "on_header_field": self._header_field,
                "on_header_value": self._header_value,
                "on_header_end": self._header_end,
                "on_headers_finished": self._headers_finished,
                "on_part_data": self._data,
                "on_end": self._end,
            },
        )

    def feed(self, chunk: bytes) -> list[_Event]:
        """Events in the next piece of the body. Raises InvalidRequest, TooLarge."""
        self.events = []
        try:
            self._parser.write(chunk)
        except FormParserError as error:
            raise InvalidRequest("The multipart body is malformed.", "Let an HTTP library write it.") from error
        return self.events

    def _begin(self) -> None:
        """Begin a part. Raises TooLarge if there are too many."""
        self._part = _Part()
        self._header_bytes = 0
        self._parts_left -= 1
        if self._parts_left < 0:
            raise TooLarge("The multipart body has too many parts.", "Send fewer, or pack the files into one ZIP file.")

    def _header_field(self, data: bytes, start: int, end: int) -> None:
        """Add ``data[start:end]`` to the name of the present header."""
        self._header += self._of_header(data[start:end])

    def _header_value(self, data: bytes, start: int, end: int) -> None:
        """Add ``data[start:end]`` to the value of the present header."""
        self._value += self._of_header(data[start:end])

    def _of_header(self, data: bytes) -> bytes:
        """``data`` itself, counted. Raises InvalidRequest if a part's header is too long."""
        self._header_bytes += len(data)
        if self._header_bytes > _MAX_PART_HEADER_BYTES:
            raise InvalidRequest("A part of the multipart body has too long a header.", "Let an HTTP library write it.")
        return data

    def _header_end(self) -> None:
        """Store the present header by its name in lower case."""
        self._part.headers[self._header.lower()] = self._value
        self._header = self._value = b""

    def _headers_finished(self) -> None:
        """Take the part's name and filename, and add its first event. Raises InvalidRequest: no name, many fields."""
        _, options = parse_options_header(self._part.headers.get(b"content-disposition", b""))
        if b"name" not in options:
            raise InvalidRequest("A part of the multipart body has no name.", "Let an HTTP library write it.")
        self._part.name = options[b"name"].decode("utf-8", "replace")
        filename = options.get(b"filename")
        if filename is None:
            self._fields_left -= 1
        if self._fields_left < 0:
            raise InvalidRequest(f"The form has more than {_MAX_FIELDS} text fields.", "Send files with a filename.")
        self._part.filename = None if filename is None else filename.decode("utf-8", "replace")
        self.events.append(_Event(self._part, b""))

    def _data(self, data: bytes, start: int, end: int) -> None:
        """Add an event with ``data[start:end]`` of the part's content, if not empty."""
        if end > start:
            self.events.append(_Event(self._part, data[start:end]))

    def _end(self) -> None:
        """Note that the body is complete."""
        self.ended = True


async def read_multipart(
    request: Request, max_bytes: int, max_files: int, write: FileSink, on_piece: PieceListener = lambda _: None
) -> dict[str, str]:
    """Read a multipart body: passes files to ``write`` as they arrive, and returns the text fields.

    ``write`` takes a part's name, its filename and its next piece, the first of which is empty. It runs in a thread.
    ``on_piece`` is called with each piece of the body.

    Raises:
        InvalidRequest: the body is malformed, incomplete, or has over 100 text fields, or one over 64 KiB or not UTF-8.
        TooLarge: it has more than ``max_files`` + 100 parts, or is longer than ``max_bytes``.
        ClientDisconnect: the sender broke off.
    """
    _, options = parse_options_header(request.headers.get("content-type", ""))
    boundary = options.get(b"boundary", b"")
    if not 1 <= len(boundary) <= 200:
        raise InvalidRequest("The multipart body has no boundary.", "Let an HTTP library set the content type.")
    parts = _Parts(boundary, max_files + _MAX_FIELDS)
    fields: dict[str, bytearray] = {}
    async for chunk in limited_stream(request, max_bytes):
        on_piece(chunk)
        events = await run_in_threadpool(parts.feed, chunk)  # many small parts take a while
        files = [event for event in events if event.part.filename is not None]
        if files:
            await run_in_threadpool(_write_all, write, files)
        for event in events:
            if event.part.filename is None:
                fields.setdefault(event.part.name, bytearray()).extend(event.data)
                _check_fields(fields, event.part.name)
    if not parts.ended:
        raise InvalidRequest("The multipart body ends too early.", "Send it again.")
    try:
        return {name: value.decode("utf-8") for name, value in fields.items()}
    except UnicodeDecodeError as error:
        raise InvalidRequest("A text field is not UTF-8.", "Send text as UTF-8.") from error


def _write_all(write: FileSink, events: list[_Event]) -> None:
    """Pass the files' pieces to ``write``, in order."""
    for event in events:
        write(event.part.name, event.part.filename or "", event.data)


def _check_fields(fields: dict[str, bytearray], name: str) -> None:
    """Raise InvalidRequest for too many text fields, or if the field ``name`` is too long."""
    if len(fields) > _MAX_FIELDS or len(fields[name]) > _MAX_FIELD_BYTES:
        raise InvalidRequest(
            f"More than {_MAX_FIELDS} text fields, or one longer than {_MAX_FIELD_BYTES} bytes.",
            "Send pictures and files as file parts, with a filename.",
        )
