"""Learn a further recording of the same place into a map."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from rholoc.errors import Conflict, InvalidCamera, MappingFailed
from rholoc.features import get_extractor, widened
from rholoc.geometry import CAMERA_WRITTEN, Camera, FloatArray, IntArray, evenly
from rholoc.localization import Localizer
from rholoc.mapping.build.assembly import assemble
from rholoc.mapping.build.density_fitting import ray_form
from rholoc.mapping.build.frame_features import FrameFeatures, Shown
from rholoc.mapping.build.job_advice import coaching_report
from rholoc.mapping.build.recursive_densities import check_forgetting
from rholoc.mapping.build.stored_observations import recording_id
from rholoc.mapping.build.tracks import Views
from rholoc.mapping.build.view_choice import choose_views
from rholoc.mapping.build.view_covariance import uncertainty_in
from rholoc.mapping.edit.sources import join
from rholoc.mapping.edit.versions import as_learned
from rholoc.mapping.learn.recognition import recognize, seen_landmarks
from rholoc.mapping.learn.registration import (
    LEARNING_RECOGNIZED,
    MIN_FOUND,
    align_to_found,
    alignment_report,
    find_frames,
    without_jumps,
)
from rholoc.maps import Map, MapInfo, Source, check_memory
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import Recording, look_through
from rholoc.reports import LearningReport
from rholoc.trajectory import PoseMethod, Scale
from rholoc.trajectory.estimate import estimate_trajectory, rolling_shutter_of

_VIEW_STEP = 0.1  # wider than while building: most of what is seen is known already
_FRAMES_PER_S = 5.0
_MAX_FRAMES = 240
_MAX_LOCALIZED = 24  # of a recording with a trajectory of its own
_LOCALIZED_M, _LOCALIZED_RAD = 0.01, np.deg2rad(0.3)  # standard deviations of a frame that is localized in a map


@dataclass(frozen=True)
class UpdateOptions:
    """Options for learning a recording.

    Attributes:
        poses: source of its frame poses, which are then aligned with the map; None: its own if it has any, else each
            frame is localized in the map, and frames outside the map are dropped.
        forgetting: update ``observed`` densities recursively with this factor; None: fit all densities again.
        pictures: whether to keep a small picture of each new view for display.
    """

    poses: PoseMethod | None = None
    forgetting: float | None = None
    pictures: bool = False


@dataclass(frozen=True, eq=False)
class _Walk:
    """Frames of a recording to learn from: camera, rows (K,) among its frames, times (K,), T_map_camera (K, 4, 4),
    features.

    ``residual`` is the standard deviation of a pose relative to the map [m, rad]. ``figures`` is the report so far.
    """

    camera: Camera
    rows: IntArray
    times: FloatArray
    T_map_camera: FloatArray
    shown: list[Shown]
    poses: str
    figures: LearningReport
    residual: tuple[float, float]


def update_map(
    map_: Map, recording: Recording, options: UpdateOptions | None = None, progress: ProgressListener = silent
) -> Map:
    """Localize a further recording in a map and learn it: more observations of known features, and new features.

    The given map is not modified.

    Raises:
        InvalidInput: the map does not remember its observations, or its densities cannot forget as requested.
        Conflict: the map has already learned this recording.
        InvalidRecording, InvalidCamera, InvalidWaypoints: the recording cannot be read, or has no usable poses.
        MappingFailed: it shows another place, or contradicts the map; says by how much.
        Cancelled: ``progress`` asked to stop.
    """
    options = options or UpdateOptions()
    check_memory(map_, "The map")
    if options.forgetting is not None:
        check_forgetting(map_, options.forgetting)
    id_ = recording_id(recording)
    if any(source.id == id_ for source in map_.info.sources):
        raise Conflict(f"The map has already learned {recording.name}.", "Forget it first to learn it again.")
    known = ray_form(map_)
    localizer = Localizer(known, min_recognized=LEARNING_RECOGNIZED)
    method = options.poses or (PoseMethod.GIVEN if recording.poses is not None else None)
    if method is None:
        walk = _localized_walk(localizer, recording, options.pictures, progress)
    else:
        walk = _aligned_walk(localizer, recording, method, options.pictures, progress)
    features = [one.features for one in walk.shown]
    views = Views.from_features([walk.camera] * len(walk.times), walk.T_map_camera, walk.times, features)
    labels, new, cloud = recognize(localizer, views, progress)
    source = Source(
        id=id_,
        name=recording.name,
        camera=walk.camera,
        frames=len(recording.frames.times),
        views=len(views),
        poses=walk.poses,
    )
    seen, landmarks = seen_landmarks(known, labels, new)
    info = replace(known.info, sources=(source,), waypoints=())
    learned = assemble(info, views, landmarks, np.zeros(len(views), dtype=np.int64), localizer.extractor.metric)
    pictures = tuple(one.picture for one in walk.shown) if options.pictures else None
    spread = None
    if known.views.covariances is not None:
        spread = uncertainty_in(known, learned.views.T_map_camera, *walk.residual)
    remembered = replace(learned.views, covariances=spread, pictures=pictures)
    learned = replace(learned, views=remembered, cloud=cloud)
    joined = join(known, learned, seen)
    progress(Stage.DENSITIES, 0.9, f"{len(joined)} features, {len(known)} of them known before")
    report = replace(
        walk.figures,
        version=map_.info.version + 1,
        source=id_,
        views=len(views),
        features_seen_again=int((seen >= 0).sum()),
        features_new=int((seen < 0).sum()),
        coaching=coaching_report(recording, look_through(recording.frames), walk.times, walk.T_map_camera),
    )
    return as_learned(map_, joined, report, progress, options.forgetting)


def _localized_walk(localizer: Localizer, recording: Recording, pictures: bool, progress: ProgressListener) -> _Walk:
    """Views of a recording, chosen from frames that are localized one by one.

    Tries five frames per second, or all of an untimed recording, evenly spread, at least five and at most 240. Drops
    frames that jump (if timed) and frames less than 0.1 (metres plus radians) from the view before.

    Raises:
        InvalidCamera: the intrinsics are unknown.
        InvalidRecording: a frame is damaged.
        MappingFailed: fewer than five frames, or fewer than a tenth of those tried, are found.
    """
    camera = _camera_of(recording, localizer.map.info)
    times = recording.frames.times
    wanted = (times[-1] - times[0]) * _FRAMES_PER_S if recording.frames.timed else len(times)
    count = int(np.clip(wanted, MIN_FOUND, _MAX_FRAMES))
    rows = evenly(len(times), count)
    shutter = rolling_shutter_of(recording, rows, progress)
    shown = _collected(_frame_features(localizer, recording, camera, pictures).of(rows.tolist()), len(rows), progress)
    if shutter is not None:
        shown = [one._replace(features=shutter.at_once(k, one.features)) for k, one in enumerate(shown)]
    frames = [(camera, one.features) for one in shown]
    found = find_frames(localizer, frames, np.arange(len(rows)), recording.name, progress)
    if recording.frames.timed:
        found = without_jumps(found, times[rows], recording.name)
    views = found.rows[choose_views(found.T_map_camera[found.rows], hold_out=False, step=_VIEW_STEP)[0]]
    figures = LearningReport(0, frames_tried=found.tried, frames_found=len(found.rows))
    return _Walk(
        camera,
        rows[views],
        times[rows[views]],
        found.T_map_camera[views],
        [shown[view] for view in views],
        "localized",
        figures,
        (_LOCALIZED_M, _LOCALIZED_RAD),
    )


def _aligned_walk(
    localizer: Localizer, recording: Recording, method: PoseMethod, pictures: bool, progress: ProgressListener
) -> _Walk:
    """Views of the recording's own trajectory, aligned with the map by localizing at most 24 of them. Raises
    MappingFailed for fewer than five views or frames found, or if the two disagree; InvalidRecording.
    """
    frame_features = _frame_features(localizer, recording, recording.camera, pictures)
    trajectory = estimate_trajectory(recording, method, progress, frame_features.show)
    views, _ = choose_views(trajectory.T_map_camera, hold_out=False, step=_VIEW_STEP)
    if len(views) < MIN_FOUND:
        raise MappingFailed(
            f"Only {len(views)} frames of {recording.name} with different views have a pose.", "Record a longer walk."
        )
    shown = _collected(frame_features.of_keyframes(trajectory, views), len(views), progress)
    frames = [(trajectory.camera, one.features) for one in shown]
    tried = evenly(len(views), _MAX_LOCALIZED)
    found = find_frames(localizer, frames, tried, recording.name, progress)
    metric = localizer.map.info.metric and trajectory.scale is Scale.METRIC
    own = trajectory.T_map_camera[views]
    alignment = align_to_found(own, found, metric, recording.name)
    figures = replace(alignment_report(alignment, found), trusted=trajectory.report.trusted, why=trajectory.report.why)
    return _Walk(
        trajectory.camera,
        trajectory.rows[views],
        trajectory.times[views],
        alignment.similarity.poses(own),
        shown,
        str(method),
        figures,
        (alignment.residual_m, alignment.residual_rad),
    )


def _frame_features(localizer: Localizer, recording: Recording, camera: Camera | None, pictures: bool) -> FrameFeatures:
    """Features of a recording's frames, by the map's extractor; with small JPEGs if ``pictures``."""
    extractor = widened(get_extractor(localizer.map.info.features), camera)
    return FrameFeatures(recording.frames, extractor, pictures)


def _collected(frames: Iterable[Shown], count: int, progress: ProgressListener) -> list[Shown]:
    """The ``count`` frames as a list, with progress."""
    shown: list[Shown] = []
    for one in frames:
        shown.append(one)
        progress(Stage.FEATURES, len(shown) / count, f"features of {len(shown)} of {count} frames")
    return shown


def _camera_of(recording: Recording, info: MapInfo) -> Camera:
    """The recording's camera, else the map's if frames have its size. Raises InvalidCamera if they do not."""
    if recording.camera is not None:
        return recording.camera
    if recording.frames.size == (info.camera.width, info.camera.height):
        return info.camera
    raise InvalidCamera(
        "The recording's intrinsics are unknown, and its frames are not of the size of the map's.",
        f"Give the camera as {CAMERA_WRITTEN}.",
    )
