"""Localize several frames together. Runs in a compute thread."""

from __future__ import annotations

import base64
import binascii
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from rholoc.errors import InvalidImage, InvalidInput
from rholoc.geometry import Camera, Pose
from rholoc.localization import (
    AnyLocalizer,
    JointLocalization,
    Query,
    SeveralFrames,
    check_frame_count,
    localize_together,
)
from rholoc.service.frames.answer_models import FramePoseOut, LocalizationOut, PoseOut, answer_of, pose_out, too_late
from rholoc.service.frames.frame_features import FrameFeatures
from rholoc.service.frames.localizers import LocalizerSource
from rholoc.service.frames.map_choice import MapChoice, best_map, choose_candidates
from rholoc.service.frames.queries import Frame, camera_for, direction, finite, gravity_of, max_sigmas
from rholoc.service.frames.request_models import FrameIn, FramesQuery, LocalizeOptions
from rholoc.service.http.stopwatch import Stopwatch
from rholoc.service.settings import Settings

_UNIT_TOLERANCE = 1e-2


@dataclass(frozen=True, eq=False)
class Frames:
    """Several frames as they were sent."""

    query: FramesQuery
    frames: tuple[Frame, ...]

    @classmethod
    def of(cls, query: FramesQuery, images: dict[int, bytes], stored: dict[str, Camera]) -> Frames:
        """The frames of a request, with the pictures sent beside it by number, and the stored cameras by name.

        Raises:
            InvalidInput: too few or too many frames, a picture without a frame, or a frame with neither a picture nor
                features, or both.
            InvalidImage: a picture is not base64.
        """
        count = len(query.frames)
        check_frame_count(count)
        strange = sorted(set(images) - set(range(count)))
        if strange:
            raise InvalidInput(f"There is a picture image{strange[0]} but no such frame.", "Number them from 0.")
        return cls(query, tuple(_frame(query, number, one, images, stored) for number, one in enumerate(query.frames)))


def _frame(query: FramesQuery, number: int, one: FrameIn, images: dict[int, bytes], stored: dict[str, Camera]) -> Frame:
    """Frame ``number`` of the request, with the picture sent beside it and its camera. Raises as :meth:`Frames.of`."""
    image = images.get(number)
    if (image is not None) + (one.image is not None) + (one.features is not None) != 1:
        raise InvalidInput(
            f"Frame {number} has not exactly one of a picture and features.", "Send an image or features for each."
        )
    if one.image is not None:
        try:
            image = base64.b64decode(one.image, validate=True)
        except (binascii.Error, ValueError) as error:
            raise InvalidImage(f"The image of frame {number} is not base64.", "Encode the file's bytes.") from error
    camera = one.camera or query.camera
    options = LocalizeOptions(
        camera=camera,
        dof=query.dof,
        gravity=one.gravity,
        deadline_ms=query.deadline_ms,
        max_sigma_m=query.max_sigma_m,
        max_sigma_deg=query.max_sigma_deg,
    )
    return Frame(options, image, one.features, None if camera.name is None else stored[camera.name])


def localize_frames(
    frames: Frames,
    maps: MapChoice,
    localizers: LocalizerSource,
    settings: Settings,
    clock: Stopwatch,
    deadline_s: float,
) -> LocalizationOut:
    """The best answer of some maps for several frames; of over five maps, only of those most similar to the first
    frame.

    Its pose is the first frame's; ``frames`` has each one's, None without a joint pose. At the deadline there is none.

    Raises:
        UnknownMap, InvalidMap, InvalidImage, InvalidCamera, InvalidDescriptors, InvalidInput: what was sent is not
            valid; with several maps, only if none could be used.
        DeadlineExceeded, MapNotHereError: as :func:`rholoc.service.frames.single_frame.localize_frame` does.
    """
    clock.stages_ms["queue"] = 1000 * clock.elapsed_s
    features = []
    for number, frame in enumerate(frames.frames):
        with _naming(number):
            features.append(FrameFeatures(frame, settings, clock, deadline_s))
    name, localizer, joint = best_map(
        choose_candidates(maps, features[0].by, clock),
        localizers,
        lambda localizer: _localize(frames, localizer, features, deadline_s, clock),
        lambda found: (found.first.localized, found.first.recognized),
        clock,
    )
    answer = answer_of(name, localizer, joint.first, clock, with_matches=False)
    nowhere: list[PoseOut | None] = [None] * len(frames.frames)
    poses = [pose_out(pose) for pose in joint.poses] or nowhere
    inliers = joint.inliers or (0,) * len(frames.frames)
    each = [FramePoseOut(pose=pose, inliers=count) for pose, count in zip(poses, inliers, strict=True)]
    return answer.model_copy(update={"frames": each})


@contextmanager
def _naming(number: int) -> Iterator[None]:
    """Put the number of a frame, from 0, before the message of an InvalidInput raised inside."""
    try:
        yield
    except InvalidInput as error:
        raise type(error)(f"Frame {number}: {error.message}", error.hint) from error


def _localize(
    frames: Frames, localizer: AnyLocalizer, features: list[FrameFeatures], deadline_s: float, clock: Stopwatch
) -> JointLocalization:
    """Joint answer of one map; without a pose at the deadline [s of the clock]. Adds its timings to the clock."""
    queries = []
    for number, (frame, own) in enumerate(zip(frames.frames, features, strict=True)):
        if clock.elapsed_s >= deadline_s:
            return JointLocalization(too_late(), (), ())
        with _naming(number):
            camera = camera_for(frame, own.size, localizer.map.info.camera)
            found = own.by(localizer.extractor)
        max_sigma_m, max_sigma_rad = max_sigmas(frame.options)
        gravity = gravity_of(frame.options.gravity)
        queries.append(
            Query(
                found,
                camera,
                frame.options.dof,
                gravity=gravity,
                max_sigma_m=max_sigma_m,
                max_sigma_rad=max_sigma_rad,
            )
        )
    left_s = deadline_s - clock.elapsed_s
    if left_s <= 0:
        return JointLocalization(too_late(), (), ())
    asked = SeveralFrames(
        tuple(replace(query, deadline_s=left_s) for query in queries),
        np.array([_relative_pose(number, one) for number, one in enumerate(frames.query.frames)]),
        frames.query.sigma_m,
        math.radians(frames.query.sigma_deg),
    )
    answer = localize_together(localizer, asked)
    for stage, duration_ms in answer.first.timings_ms.items():
        clock.stages_ms[stage] = clock.stages_ms.get(stage, 0.0) + duration_ms
    return answer


def _relative_pose(number: int, one: FrameIn) -> np.ndarray:
    """A frame's T_common_camera (4, 4); ``number`` is for messages. Raises InvalidInput: a number is not finite,
    or the quaternion's length is more than 0.01 from 1.
    """
    position = finite(f"frames[{number}].position", one.position)
    quaternion = finite(f"frames[{number}].quaternion_xyzw", one.quaternion_xyzw)
    if abs(float(np.linalg.norm(quaternion)) - 1) > _UNIT_TOLERANCE:
        raise InvalidInput(
            f"The quaternion of frame {number} is not a rotation: its length is {np.linalg.norm(quaternion):.3g}.",
            "Send a unit quaternion, x, y, z, w.",
        )
    return Pose.from_quaternion(position, direction("quaternion_xyzw", quaternion.tolist())).T_map_camera
