"""A track that makes its own odometry from pictures where the caller has none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from rholoc_client.errors import InvalidTrack
from rholoc_client.models import Camera
from rholoc_client.tracking.belief import Step
from rholoc_client.tracking.rigid import FloatArray, inverse
from rholoc_client.tracking.track import Answer, Question, Track, Tracked, TrackOptions

if TYPE_CHECKING:
    from rholoc_client.tracking.pictures import PictureMotion

_SAME_SHAPE = 0.01  # of two aspect ratios


@dataclass(frozen=True, eq=False)
class AnsweredMatches:
    """The matches that agree with an answer: pixels (M, 2) and the landmarks (M, 3) that they show, map frame."""

    pixels: Sequence[Sequence[float]]
    landmarks: Sequence[Sequence[float]]


class FollowedTrack:
    """A :class:`Track` that follows its pictures where the caller has no odometry.

    Args:
        options: how it is kept.
        camera: the intrinsics of the pictures; None: pictures are not followed.
    """

    def __init__(self, options: TrackOptions | None = None, camera: Camera | None = None) -> None:
        self._options = options or TrackOptions()
        self._camera = camera
        self._track = Track(self._options)
        self._motion: PictureMotion | None = None
        self._with_odometry = False

    @property
    def follows_pictures(self) -> bool:
        """Whether every picture is used, not only those sent to the service; answers then need their matches."""
        return self._motion is not None

    def imu(self, time_s: float, acceleration_m_s2: FloatArray, rate_rad_s: FloatArray) -> None:
        """As :meth:`Track.imu`."""
        self._track.imu(time_s, acceleration_m_s2, rate_rad_s)

    def frame(
        self,
        time_s: float,
        T_odom_camera: FloatArray | None = None,
        picture: Any = None,
        camera: Camera | None = None,
    ) -> Tracked:
        """Take in a frame, and say where the camera is.

        Args:
            time_s: when it was taken.
            T_odom_camera: (4, 4) by odometry, or None.
            picture: (H, W, 3) BGR or (H, W) grey of uint8, followed if there is never any odometry; or None.
            camera: this picture's intrinsics, where autofocus changes them; None: the track's.

        Raises:
            InvalidTrack: as :meth:`Track.frame`.
        """
        if T_odom_camera is not None and self._motion is not None:
            raise InvalidTrack("This track began without odometry. Begin another to use it.")
        self._with_odometry = self._with_odometry or T_odom_camera is not None
        camera = camera or self._camera
        if picture is not None and camera is not None and not self._with_odometry:
            if self._motion is None:
                self._begin_to_follow()
            if self._motion is not None:
                self._track.check_time(time_s)
                height, width = picture.shape[:2]
                T_odom_camera = self._motion.follow(time_s, picture, fitted(camera, width, height))
        return self._track.frame(time_s, T_odom_camera)

    def now(self) -> Tracked:
        """As :meth:`Track.now`."""
        return self._track.now()

    @property
    def wants_answer(self) -> bool:
        """Whether asking for the last frame pays."""
        return self._track.wants_answer or (self._motion is not None and self._motion.is_short_of_points and self._may)

    @property
    def _may(self) -> bool:
        return self._track.may_ask

    def ask(self) -> Question:
        """Record that the last frame is being asked about."""
        if self._motion is not None:
            self._motion.keep()
        return self._track.ask()

    def unanswered(self) -> None:
        """Record that the question got no answer."""
        if self._motion is not None:
            self._motion.unanswered()
        self._track.unanswered()

    def answered(self, answer: Answer | None, matches: AnsweredMatches | None = None) -> None:
        """Take in the answer to the question; None where there is no pose."""
        if answer is None:
            self.unanswered()
            return
        if self._motion is None or matches is None or not answer.localized:
            if self._motion is not None:
                self._motion.unanswered()
            self._track.answered(answer)
            return
        way = self._motion.answered(answer.T_map_camera, matches.pixels, matches.landmarks)
        steps = [
            Step(now_s - before_s, None if before is None or now is None else inverse(before) @ now)
            for (before_s, before), (now_s, now) in pairwise(way)
        ]
        self._track.answered(answer, steps, way[-1][1] if way else None)

    def _begin_to_follow(self) -> None:
        try:
            from rholoc_client.tracking.pictures import PICTURE_NOISE, PictureMotion
        except ImportError:  # OpenCV is an extra: without it, motion comes from the IMU or is guessed
            return
        self._motion = PictureMotion()
        self._track.options = replace(self._options, odometry=PICTURE_NOISE)


def fitted(camera: Camera, width: int, height: int) -> Camera:
    """A camera for pictures of ``width`` × ``height`` px: scaled, if it belongs to another size of the same shape.

    Raises:
        InvalidTrack: it belongs to another shape.
    """
    own_width, own_height = camera.width or width, camera.height or height
    if abs(own_width * height / (own_height * width) - 1) > _SAME_SHAPE:
        raise InvalidTrack(f"The camera is for images of {own_width}×{own_height} pixels, not {width}×{height}.")
    x, y = width / own_width, height / own_height
    return replace(
        camera,
        fx=camera.fx * x,
        fy=camera.fy * y,
        cx=(camera.cx + 0.5) * x - 0.5,
        cy=(camera.cy + 0.5) * y - 0.5,
        width=width,
        height=height,
    )
