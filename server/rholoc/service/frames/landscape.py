"""Landscape of the densities around a frame's pose. Runs in a compute thread."""

import numpy as np
from pydantic import Field

from rholoc.geometry import Pose
from rholoc.localization import Localizer, Query
from rholoc.paper.density_localizer import DensityLocalizer
from rholoc.paper.landscape import landscape_around
from rholoc.service.frames.answer_models import PoseOut, pose_out
from rholoc.service.frames.frame_features import FrameFeatures
from rholoc.service.frames.localizers import LocalizerSource
from rholoc.service.frames.queries import Frame, camera_for, gravity_of, prior_of
from rholoc.service.http.models import AnswerModel
from rholoc.service.http.stopwatch import Stopwatch, frame_deadline_s
from rholoc.service.settings import Settings
from rholoc.trajectory import Scale


class WayOut(AnswerModel):
    """The path of an ascent."""

    positions: list[list[float]] = Field(description="x, y, z of the camera, step by step, the start first")
    gain_nats: float = Field(description="what the densities say for its end, Σ log((ε + ρ) / ε)")


class LandscapeOut(AnswerModel):
    """The densities of the features that a frame shows, around its pose."""

    localized: bool = Field(description="whether the frame has a pose; without one it is the best optimum's landscape")
    map: str
    map_id: str
    map_version: int
    scale: Scale
    pose: PoseOut | None = Field(description="the pose; null where too little matches to climb by")
    origin: list[float] | None = Field(description="the position of the first value")
    spacing: float | None = Field(description="between neighbouring positions")
    values: list[list[float]] = Field(
        description="Σ log((ε + ρ) / ε), nats, of a camera at the pose's height that is turned as it is: rows of "
        "increasing y, in a row by increasing x"
    )
    tolerance_px: float | None = Field(description="how far a feature may be off and still count")
    ways: list[WayOut] = Field(description="from the places that most matches speak for, the best last")


def landscape_of(
    frame: Frame, name: str, localizers: LocalizerSource, settings: Settings, clock: Stopwatch
) -> LandscapeOut:
    """The landscape around a frame's pose, or around the best optimum if it has no pose.

    Raises:
        DeadlineExceeded: the deadline passed first. MapNotHereError: the map is not on this machine.
        UnknownMap, InvalidMap, InvalidImage, InvalidCamera, InvalidDescriptors, InvalidInput: the request is not valid.
    """
    deadline_s = frame_deadline_s(frame.options.deadline_ms, settings)
    localizer = localizers.get(name)
    features = FrameFeatures(frame, settings, clock, deadline_s)
    info, options = localizer.map.info, frame.options
    camera = camera_for(frame, features.size, info.camera)
    found = features.by(localizer.extractor)
    left_s = max(deadline_s - clock.elapsed_s, 0.0)
    prior, gravity = prior_of(options.prior), gravity_of(options.gravity)
    answer = localizer.localize(Query(found, camera, options.dof, prior, gravity, left_s, options.intrinsics))
    pose = answer.pose if answer.localized else None
    around = localizer if isinstance(localizer, Localizer) else localizer.around([found])[1]
    seen = landscape_around(
        DensityLocalizer(around.map, index=around.index),
        found,
        answer.camera or camera,
        None if pose is None else pose.T_map_camera,
        lambda: clock.check(deadline_s),
    )
    return LandscapeOut(
        localized=answer.localized,
        map=name,
        map_id=info.id,
        map_version=info.version,
        scale=Scale.METRIC if info.metric else Scale.ARBITRARY,
        pose=None if seen is None else pose_out(Pose(seen.T_map_camera)),
        origin=None if seen is None else np.round(seen.grid.origin, 4).tolist(),
        spacing=None if seen is None else seen.grid.spacing_m,
        values=[] if seen is None else seen.values.round(1).tolist(),
        tolerance_px=None if seen is None else seen.tolerance_px,
        ways=[]
        if seen is None
        else [
            WayOut(positions=ascent.positions.round(4).tolist(), gain_nats=ascent.optimum.value)
            for ascent in seen.ascents
        ],
    )
