"""A stream of frames over a WebSocket → a pose for each. Its state lives as long as the connection."""

import asyncio
import logging
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np
from fastapi import APIRouter
from pydantic import BaseModel
from pydantic_core import from_json
from starlette.websockets import WebSocket, WebSocketDisconnect

from rholoc.errors import Busy, DeadlineExceeded, InvalidInput, RholocError
from rholoc.geometry import Camera
from rholoc.localization import AnyLocalizer
from rholoc.recordings.frames.image_decoding import SENT_FORMATS, decode_image
from rholoc.service.access.open_streams import StreamKind
from rholoc.service.access.scopes import STREAM_NEEDS_LOCALIZE, STREAM_PROTOCOL
from rholoc.service.errors import Internal, InvalidRequest, RequestTimeout, as_rholoc_error, error_body
from rholoc.service.frames.answer_models import LocalizationOut, PoseOut
from rholoc.service.frames.map_choice import MapChoice
from rholoc.service.frames.queries import Frame, camera_for, effort_of
from rholoc.service.frames.request_models import LocalizeOptions, PriorIn
from rholoc.service.http.json_bodies import JsonLimits, check_json
from rholoc.service.http.stopwatch import Stopwatch
from rholoc.service.routes.frames.track_messages import Begin, Begun, FrameMessage, StreamError, TrackedOut
from rholoc.service.state import State
from rholoc.trajectory import Scale
from rholoc_client import Camera as ClientCamera
from rholoc_client import OdometryNoise, Tracked, TrackOptions
from rholoc_client.errors import InvalidTrack
from rholoc_client.models import parse_localization
from rholoc_client.tracking import Answer, AnsweredMatches, FollowedTrack, Question
from rholoc_client.tracking.rigid import FloatArray, from_quaternion

_FRAMES_PER_S = 100.0  # messages are read no faster
_BURST = 30
_FOLLOWED_PIXELS = 1_000_000  # larger pictures are localized, but not followed from frame to frame
_ENDED_BY_ERROR = 1008  # a WebSocket's "policy violation": what was sent cannot be used
_ENDED_BY_FAILURE = 1011


@dataclass
class _Pace:
    """How fast messages are read: a short burst, then no faster than ``_FRAMES_PER_S``."""

    left: float = _BURST
    last_s: float = 0.0

    def wait_s(self) -> float:
        """Seconds to wait before reading the next message, which is counted: 0 for 30 at once, then 100 a second."""
        now_s = time.monotonic()
        self.left = min(_BURST, self.left + (now_s - self.last_s) * _FRAMES_PER_S)
        self.last_s = now_s
        self.left -= 1
        return max(0.0, -self.left / _FRAMES_PER_S)


class Stream:
    """One connection.

    Args:
        socket: accepted.
        name: the map's.
        service: the parts of the service.
    """

    def __init__(self, socket: WebSocket, name: str, service: State) -> None:
        self._socket, self._name, self._service = socket, name, service
        self._pending: asyncio.Task[LocalizationOut] | None = None
        self._pace = _Pace()

    async def run(self) -> None:
        """Answer messages until the client leaves or errs: first a Begin, then frames.

        Raises:
            RholocError: what was sent cannot be used, or nothing was sent for long.
            WebSocketDisconnect: the client has left.
        """
        begin = await self._receive(Begin)
        localizer = await self._service.frames.localizer(self._name)
        stored = None
        if begin.camera.name is not None:
            stored = (await self._service.cameras.get(begin.camera.name)).camera
        options = TrackOptions(odometry=OdometryNoise(**begin.odometry.model_dump()))
        self._track = _ServedTrack(begin, stored, localizer, options)
        info = localizer.map.info
        scale = Scale.METRIC if info.metric else Scale.ARBITRARY
        await self._send(Begun(map=self._name, map_id=info.id, map_version=info.version, scale=scale))
        incoming: asyncio.Task[FrameMessage] | None = None
        try:
            while True:
                incoming = incoming or asyncio.create_task(self._receive(FrameMessage))
                waiting = {incoming} if self._pending is None else {incoming, self._pending}
                await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
                if self._pending is not None and self._pending.done():
                    await self._take_answer()
                if incoming.done():
                    message, incoming = incoming.result(), None
                    await self._take_frame(message)
        finally:
            for task in (incoming, self._pending):
                if task is not None:
                    task.cancel()
            await asyncio.gather(*filter(None, (incoming, self._pending)), return_exceptions=True)

    async def _take_frame(self, message: FrameMessage) -> None:
        picture = await self._receive_picture() if message.picture else None
        follow = picture is not None and message.odometry is None
        image = await self._service.frames.compute.run(lambda: self._decoded(picture or b"")) if follow else None
        tracked = await self._service.frames.compute.run(lambda: self._track.frame(message, image))
        if picture is not None and self._pending is None and self._track.wants_answer:
            frame = self._track.ask(picture)
            self._pending = asyncio.create_task(
                self._service.frames.localize(frame, MapChoice([self._name]), Stopwatch())
            )
        await self._tell(tracked)

    async def _take_answer(self) -> None:
        assert self._pending is not None
        pending, self._pending = self._pending, None
        try:
            answer = pending.result()
        except (Busy, DeadlineExceeded):  # the next question may find room, and time
            self._track.unanswered()
            return
        await self._service.frames.compute.run(lambda: self._track.answered(answer))
        await self._tell(self._track.now(), answer.model_copy(update={"agreeing": None}))

    async def _tell(self, tracked: Tracked, answer: LocalizationOut | None = None) -> None:
        values = {name: getattr(tracked, name) for name in Tracked.__dataclass_fields__}
        pose = None if tracked.pose is None else PoseOut(**asdict(tracked.pose))
        wants = self._pending is None and self._track.wants_answer
        await self._send(TrackedOut(**{**values, "pose": pose}, wants_picture=wants, answer=answer))

    async def _send(self, message: BaseModel) -> None:
        await self._socket.send_text(message.model_dump_json())

    async def _receive(self, kind: type[Any]) -> Any:
        message = await self._next_message()
        text = message.get("text")
        if text is None:
            raise InvalidRequest("A picture arrived that no frame announced.", "Send a frame with picture: true first.")
        limits = JsonLimits.of_options(self._service.settings.max_json_bytes)
        body = text.encode()
        check_json(body, limits)
        return kind.model_validate(from_json(body))

    async def _receive_picture(self) -> bytes:
        content = (await self._next_message()).get("bytes")
        if content is None:
            raise InvalidRequest(
                "A frame announced a picture, but text followed.", "Send the picture as a binary message."
            )
        return bytes(content)

    async def _next_message(self) -> dict[str, Any]:
        await asyncio.sleep(self._pace.wait_s())
        silence_s = self._service.settings.slow_client_timeout_s
        try:
            async with asyncio.timeout(silence_s):
                message = dict(await self._socket.receive())
        except TimeoutError:
            raise RequestTimeout(f"Nothing was sent for {silence_s:g} s.", "Open another stream.") from None
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message.get("code", 1005))
        return message

    def _decoded(self, picture: bytes) -> np.ndarray | None:
        """A picture (H, W) in grey; None above a megapixel, which is not followed. Raises InvalidImage."""
        image = decode_image(picture, self._service.settings.max_image_pixels, SENT_FORMATS)
        if image.shape[0] * image.shape[1] > _FOLLOWED_PIXELS:
            return None
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))


class _ServedTrack:
    """The client's own track, asking the service from within."""

    def __init__(self, begin: Begin, stored: Camera | None, localizer: AnyLocalizer, options: TrackOptions) -> None:
        self._begin, self._stored, self._localizer, self._options = begin, stored, localizer, options
        self._track: FollowedTrack | None = None

    def frame(self, message: FrameMessage, image: np.ndarray | None) -> Tracked:
        """Take in a frame, its IMU readings first, and return where the camera was; ``image`` (H, W) grey is followed.

        Raises:
            InvalidInput: times go backward, a pose is not a rigid motion, a reading is not finite.
        """
        with _as_service_errors():
            if self._track is None:
                self._track = FollowedTrack(self._options, None if image is None else self._camera(image))
            for time_s, *values in message.imu:
                self._track.imu(time_s, np.array(values[:3]), np.array(values[3:]))
            return self._track.frame(message.time_s, _odometry(message), image)

    def now(self) -> Tracked:
        """Where the camera was at the last frame; after :meth:`frame`."""
        assert self._track is not None
        return self._track.now()

    @property
    def wants_answer(self) -> bool:
        """Whether the track wants the last frame localized; False before the first."""
        return self._track is not None and self._track.wants_answer

    def ask(self, picture: bytes) -> Frame:
        """The frame to localize for the track's current question, with its prior; the question is open from then on."""
        assert self._track is not None
        question: Question = self._track.ask()
        prior = None if question.prior is None else PriorIn(**_lists(question.prior.as_sent()))
        options = LocalizeOptions(
            camera=self._begin.camera, dof=self._begin.dof, prior=prior, with_matches=self._track.follows_pictures
        )
        return Frame(options, image=picture, stored=self._stored, effort=effort_of(picture))

    def unanswered(self) -> None:
        """Tell the track that its question is not answered."""
        assert self._track is not None
        self._track.unanswered()

    def answered(self, answer: LocalizationOut) -> None:
        """Take in the answer to the open question. Raises InvalidInput."""
        assert self._track is not None
        found = parse_localization(answer.model_dump(mode="json"))
        matches = found.agreeing
        with _as_service_errors():
            self._track.answered(
                Answer.of(found), None if matches is None else AnsweredMatches(matches.pixels, matches.landmarks)
            )

    def _camera(self, image: np.ndarray) -> ClientCamera:
        size = (image.shape[1], image.shape[0])
        frame = Frame(LocalizeOptions(camera=self._begin.camera), stored=self._stored)
        return ClientCamera(**camera_for(frame, size, self._localizer.map.info.camera).to_dict())


def _odometry(message: FrameMessage) -> FloatArray | None:
    if message.odometry is None:
        return None
    try:
        return from_quaternion(message.odometry.position, message.odometry.quaternion_xyzw)
    except ValueError as error:
        raise InvalidInput(f"Odometry: {error}", "Send a finite position and a unit quaternion, x, y, z, w.") from error


def _lists(values: dict[str, Any]) -> dict[str, Any]:
    """The values with lists in place of tuples."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}


@contextmanager
def _as_service_errors() -> Iterator[None]:
    """Within the block, turn the track's InvalidTrack into InvalidInput."""
    try:
        yield
    except InvalidTrack as error:
        raise InvalidInput(str(error), "Send frames and readings in the order of their times.") from error


router = APIRouter(prefix="/v1", tags=["localization"])

_log = logging.getLogger("rholoc.service")


@router.websocket("/maps/{map_name}/track", dependencies=[STREAM_NEEDS_LOCALIZE])
async def track(socket: WebSocket, map_name: str) -> None:
    """Frames, odometry and IMU readings come in; poses go out. See the README of the service for the messages."""
    service: State = socket.app.state.rholoc
    offered = socket.scope.get("subprotocols") or []
    await socket.accept(STREAM_PROTOCOL if STREAM_PROTOCOL in offered else None)
    request_id = uuid.uuid4().hex

    try:
        await service.frames.check_known([map_name])
        async with service.streams.serving(service.streams.admit(StreamKind.FRAMES, socket.scope)):
            await Stream(socket, map_name, service).run()
    except WebSocketDisconnect:
        return
    except Exception as error:
        known = as_rholoc_error(error)
        if known is None:
            _log.exception("internal_error", extra={"request_id": request_id, "path": socket.url.path})
            known = Internal("The service failed.", f"Its log has the details under the request id {request_id}.")
        await _end(socket, known, request_id)


async def _end(socket: WebSocket, error: RholocError, request_id: str) -> None:
    """Send the error with the request's id, and close the WebSocket; does nothing if the client has left."""
    code = _ENDED_BY_FAILURE if isinstance(error, Internal) else _ENDED_BY_ERROR
    with suppress(RuntimeError, WebSocketDisconnect):  # the client has left
        await socket.send_text(StreamError.model_validate(error_body(error, request_id)).model_dump_json())
        await socket.close(code, error.code)
