"""The trackers: a :class:`FollowedTrack` whose questions the service answers in the background."""

from __future__ import annotations

import asyncio
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, TypeVar

import numpy as np

from rholoc_client._async.client import AsyncClient
from rholoc_client._images import ImageLike
from rholoc_client._sync.client import Client
from rholoc_client.errors import (
    Busy,
    ConnectionFailed,
    DeadlineExceeded,
    Internal,
    InvalidTrack,
    RequestTimeout,
    RholocClientError,
    StorageUnavailable,
)
from rholoc_client.models import Camera, Localization, Prior
from rholoc_client.tracking.following import AnsweredMatches, FollowedTrack
from rholoc_client.tracking.rigid import FloatArray
from rholoc_client.tracking.track import Answer, Question, Tracked, TrackOptions

_TEMPORARY = (Busy, ConnectionFailed, DeadlineExceeded, Internal, RequestTimeout, StorageUnavailable)
_JPEG_QUALITY = 92


_Pending = TypeVar("_Pending", Future[Localization], asyncio.Task[Localization])


class _Tracking(Generic[_Pending]):
    """What both trackers share: a track, and how it takes in answers."""

    def __init__(self, map_name: str, camera: Camera | None, options: TrackOptions | None) -> None:
        self.map_name = map_name
        self.last_error: RholocClientError | None = None
        """Why the last question was not answered, if the cause is temporary: the service is busy, or out of reach."""
        self._camera = self._last_camera = camera
        self._track = FollowedTrack(options, camera)
        self._expected: Prior | None = None
        self._pending: _Pending | None = None

    def imu(self, time_s: float, acceleration_m_s2: FloatArray, rate_rad_s: FloatArray) -> None:
        """Take in a reading of an IMU, in the camera's axes (x right, y down, z forward), on the frames' clock.

        Args:
            time_s: when it was read; readings may run ahead of frames.
            acceleration_m_s2: (3,); at rest the reaction to gravity, 9.81 upwards.
            rate_rad_s: (3,) the angular velocity.

        Raises:
            InvalidTrack: its time is not after the last reading's, or a vector is not three finite numbers.
        """
        self._track.imu(time_s, acceleration_m_s2, rate_rad_s)

    def expect(self, prior: Prior | None) -> None:
        """Send ``prior`` with the questions for which the track itself expects no pose; None: send none with them."""
        self._expected = prior

    def _frame(
        self, time_s: float, picture: ImageLike | None, T_odom_camera: FloatArray | None, camera: Camera | None
    ) -> Tracked:
        self._last_camera = camera or self._camera
        return self._track.frame(time_s, T_odom_camera, _decoded(picture) if T_odom_camera is None else None, camera)

    def _asking(self, question: Question) -> dict[str, Any]:
        """The options of a question's request."""
        prior = question.prior or self._expected
        return {"camera": self._last_camera, "prior": prior, "with_matches": self._track.follows_pictures}

    def _collect(self) -> None:
        """Take in the answer to the open question, if it has arrived."""
        pending = self._pending
        if pending is None or not pending.done():
            return
        self._pending = None
        failed = pending.exception()
        if failed is not None and not isinstance(failed, RholocClientError):
            self._track.unanswered()
            raise failed
        self._came(None if failed is not None else pending.result(), failed)

    def _came(self, answer: Localization | None, error: RholocClientError | None) -> None:
        """Take in the outcome of a question.

        Raises:
            ServiceError: one that is not temporary.
        """
        self.last_error = error
        if answer is None:
            self._track.unanswered()
            if error is not None and not isinstance(error, _TEMPORARY):
                raise error
            return
        matches = answer.agreeing
        self._track.answered(
            Answer.of(answer), None if matches is None else AnsweredMatches(matches.pixels, matches.landmarks)
        )


class Tracker(_Tracking[Future[Localization]]):
    """Keeps track of a camera in a map: give it every frame, it asks the service when that pays.

    ::

        with Client("http://localhost:8080") as client, Tracker(client, "testsite", camera) as tracker:
            for time_s, picture, T_odom_camera in robot:
                tracked = tracker.track(time_s, picture, T_odom_camera)
                if tracked.status is TrackStatus.TRACKING:
                    print(tracked.pose.position, tracked.reset_counter)

    A background thread asks the questions, so that :meth:`track` does not wait for the service. Not safe to share
    between threads.

    Args:
        client: the service.
        map_name: the map.
        camera: the pictures' intrinsics; None: the map's own, and pictures are not followed.
        options: how the track is kept.
    """

    def __init__(
        self, client: Client, map_name: str, camera: Camera | None = None, options: TrackOptions | None = None
    ) -> None:
        super().__init__(map_name, camera, options)
        self._client = client
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="rholoc-tracker")

    def __enter__(self) -> Tracker:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop asking, and wait for the open question."""
        self._thread.shutdown(cancel_futures=True)

    def track(
        self,
        time_s: float,
        picture: ImageLike | None,
        T_odom_camera: FloatArray | None = None,
        camera: Camera | None = None,
    ) -> Tracked:
        """Where the camera is at a frame.

        Args:
            time_s: when it was taken, seconds on any one clock.
            picture: as for :meth:`Client.localize`; None for a frame without one, which odometry alone places.
            T_odom_camera: (4, 4) the camera's pose by odometry: ARKit's, ARCore's, wheels', VIO's, in its own frame.
                None: motion comes from the pictures (where OpenCV is installed), else from the IMU.
            camera: this picture's intrinsics, where autofocus changes them; None: the tracker's.

        Raises:
            InvalidTrack: the time is not after the last frame's, or the pose is not a rigid motion.
            ServiceError: the service refused, and would again: there is no such map, the key is not valid.
        """
        self._collect()
        tracked = self._frame(time_s, picture, T_odom_camera, camera)
        if picture is not None and self._pending is None and self._track.wants_answer:
            asked = self._asking(self._track.ask())
            self._pending = self._thread.submit(
                lambda: self._client.localize(self.map_name, _encoded(picture), **asked)
            )
        return tracked

    def wait(self, timeout_s: float | None = None) -> Tracked:
        """Wait for the answer to the open question; then say where the camera was at the last frame.

        Raises:
            TimeoutError: it took longer.
            ServiceError: as :meth:`track`.
        """
        if self._pending is not None:
            self._pending.exception(timeout_s)
        self._collect()
        return self._track.now()


class AsyncTracker(_Tracking[asyncio.Task[Localization]]):
    """As :class:`Tracker`, for programs on asyncio."""

    def __init__(
        self, client: AsyncClient, map_name: str, camera: Camera | None = None, options: TrackOptions | None = None
    ) -> None:
        super().__init__(map_name, camera, options)
        self._client = client

    async def __aenter__(self) -> AsyncTracker:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Stop asking."""
        if self._pending is not None:
            self._pending.cancel()
            await asyncio.gather(self._pending, return_exceptions=True)

    async def track(
        self,
        time_s: float,
        picture: ImageLike | None,
        T_odom_camera: FloatArray | None = None,
        camera: Camera | None = None,
    ) -> Tracked:
        """As :meth:`Tracker.track`."""
        self._collect()
        tracked = self._frame(time_s, picture, T_odom_camera, camera)
        if picture is not None and self._pending is None and self._track.wants_answer:
            asked = self._asking(self._track.ask())
            self._pending = asyncio.create_task(self._client.localize(self.map_name, _encoded(picture), **asked))
        return tracked

    async def wait(self, timeout_s: float | None = None) -> Tracked:
        """As :meth:`Tracker.wait`."""
        if self._pending is not None:
            done, _ = await asyncio.wait({self._pending}, timeout=timeout_s)
            if not done:
                raise TimeoutError
        self._collect()
        return self._track.now()


def _decoded(picture: ImageLike | None) -> Any:
    """A picture as an array; None without a picture, or without OpenCV to decode it."""
    if picture is None or not isinstance(picture, bytes | Path):
        return picture
    try:
        import cv2
    except ImportError:
        return None
    content = picture.read_bytes() if isinstance(picture, Path) else picture
    decoded = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_GRAYSCALE) if content else None
    if decoded is None:
        raise InvalidTrack("This is not an image that can be read.")
    return decoded


def _encoded(picture: ImageLike) -> ImageLike:
    """A picture as it is sent: an array as JPEG, where OpenCV is installed."""
    if isinstance(picture, bytes | Path):
        return picture
    try:
        import cv2
    except ImportError:
        return picture
    found, jpeg = cv2.imencode(".jpg", np.asarray(picture), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return jpeg.tobytes() if found else picture
