"""Recording → map: the pipeline."""

import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from rholoc.density.tensor import DEGREES
from rholoc.errors import InvalidInput, MappingFailed
from rholoc.features import DEFAULT_FEATURES, Extractor, FeatureSet, get_extractor, widened
from rholoc.geometry import BoolArray, Camera, FloatArray, IntArray
from rholoc.geometry.earth import enu_of
from rholoc.mapping.build.assembly import assemble
from rholoc.mapping.build.density_fitting import DEFAULT_DEGREE, fit_densities
from rholoc.mapping.build.frame_features import FrameFeatures
from rholoc.mapping.build.job_advice import advice_line, coaching_report, with_advice
from rholoc.mapping.build.landmarks import (
    Landmarks,
    are_stable,
    extend_and_merge,
    triangulate,
    with_ranged,
)
from rholoc.mapping.build.reconstruction_cloud import cloud_of
from rholoc.mapping.build.self_report import Frame, map_report
from rholoc.mapping.build.stored_observations import recording_id, with_landmarks
from rholoc.mapping.build.tracks import Views, link_observations
from rholoc.mapping.build.view_choice import choose_views
from rholoc.mapping.build.view_covariance import storable_covariances
from rholoc.maps import DensityKind, Map, MapInfo, MapWaypoint, SiteOnEarth, Source
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import Look, Recording, Waypoint
from rholoc.trajectory import PoseMethod, Scale, Trajectory
from rholoc.trajectory.estimate import estimate_trajectory

_FEATURES_PER_VIEW = 400
_EXTENSION_ROUNDS = 2
_MIN_VIEWS = 3
_MIN_FEATURES = 60


@dataclass(frozen=True)
class BuildOptions:
    """Options of a build.

    Attributes:
        density: form of the densities.
        features: name of the extractor.
        poses: source of the frame poses.
        report: whether to hold out frames and localize them for the report, which takes time.
        degree: P of ``tensor`` densities, 1 to 3. With 1 they have no peak, so nothing can be localized.
        pictures: whether to keep a small picture of each view for display.
    """

    density: DensityKind = DensityKind.RAY
    features: str = DEFAULT_FEATURES
    poses: PoseMethod = PoseMethod.AUTO
    report: bool = True
    degree: int = DEFAULT_DEGREE
    pictures: bool = False


@dataclass(frozen=True, eq=False)
class _Walk:
    """One recording, its trajectory, and the trajectory's rows that become views or are held out."""

    recording: Recording
    features: FrameFeatures
    trajectory: Trajectory
    views: IntArray
    held_out: IntArray


def build_map(
    recordings: Sequence[Recording], options: BuildOptions | None = None, progress: ProgressListener = silent
) -> Map:
    """Build a map from one or more recordings of a place.

    Several recordings must share a frame: by given poses, or each by its own waypoints.

    Raises:
        InvalidInput: no recording, a degree other than 1 to 3, or features or a density that do not exist.
        InvalidRecording, InvalidCamera: a recording cannot be read or used.
        InvalidWaypoints: its waypoints do not fix a frame.
        MappingFailed: a walk has fewer than three views, the recordings share no frame, or fewer than 60 features are
            stable.
        Cancelled: ``progress`` asked to stop.
    """
    options = options or BuildOptions()
    extractor = get_extractor(options.features)
    if options.degree not in DEGREES:
        raise InvalidInput(f"A density of degree {options.degree} cannot be fitted.", "Use 1, 2 or 3.")
    recordings = _in_one_frame(recordings)
    walks = [_walk(recording, extractor, options, progress) for recording in recordings]
    _check_common_frame(walks)
    views, held_out, looks, pictures = _look(walks, options, progress)
    walk_of_view = np.repeat(np.arange(len(walks)), [len(walk.views) for walk in walks])
    reconstructed, stable = reconstruct(views, extractor, progress, walk_of_view)
    landmarks = reconstructed.keep(stable)
    progress(Stage.DENSITIES, 0.6, f"{len(landmarks)} stable features")
    map_ = _assemble(walks, views, walk_of_view, landmarks, extractor, options)
    cloud = cloud_of(views, reconstructed, stable, walk_of_view)
    map_ = replace(map_, views=replace(map_.views, pictures=pictures), cloud=cloud)
    map_ = fit_densities(map_, options.density, options.degree, progress)
    progress(Stage.DENSITIES, 1.0, f"{len(map_.descriptors)} descriptors")
    report = replace(
        map_report(map_, held_out, progress),
        trajectories=tuple(walk.trajectory.report for walk in walks),
        coaching=tuple(
            coaching_report(walk.recording, seen, walk.trajectory.times, walk.trajectory.T_map_camera)
            for walk, seen in zip(walks, looks, strict=True)
        ),
    )
    if line := advice_line(report.coaching):
        progress(Stage.REPORT, 1.0, line)
    return replace(map_, info=replace(map_.info, report=report))


def _walk(recording: Recording, extractor: Extractor, options: BuildOptions, progress: ProgressListener) -> _Walk:
    """Trajectory and views of a recording. Raises MappingFailed, also for fewer than three views."""
    features = FrameFeatures(recording.frames, widened(extractor, recording.camera), options.pictures)
    try:
        trajectory = estimate_trajectory(recording, options.poses, progress, features.show)
    except MappingFailed as failure:
        raise with_advice(failure, recording) from failure
    views, held_out = choose_views(trajectory.T_map_camera, hold_out=options.report)
    if len(views) < _MIN_VIEWS:
        raise MappingFailed(
            f"Only {len(views)} frames with different views have a pose; a map needs at least {_MIN_VIEWS}.",
            "Record a longer walk, or give poses for more frames.",
        )
    return _Walk(recording, features, trajectory, views, held_out)


def _check_common_frame(walks: Sequence[_Walk]) -> None:
    """Raise MappingFailed if one of several walks has an arbitrary scale, InvalidInput without any walk."""
    if not walks:
        raise InvalidInput("There is no recording to build a map from.", "Name at least one.")
    if len(walks) > 1 and any(walk.trajectory.scale is Scale.ARBITRARY for walk in walks):
        raise MappingFailed(
            "The recordings do not share a frame: at least one has neither poses nor waypoints.",
            "Give each recording waypoints measured in the same frame, or build from one.",
        )


def _look(
    walks: Sequence[_Walk], options: BuildOptions, progress: ProgressListener
) -> tuple[Views, list[Frame], list[list[Look]], tuple[bytes, ...] | None]:
    """Features of all views and of the held-out frames, appearance of the frames of each walk, and the views' pictures
    (None if not kept). Features of views are freed from rolling shutter; those held out are not.
    """
    cameras: list[Camera] = []
    poses: list[FloatArray] = []
    times: list[float] = []
    features: list[FeatureSet] = []
    ranges_m: list[FloatArray] = []
    held: list[Frame] = []
    looks: list[list[Look]] = []
    pictures: list[bytes] = []
    total, done = sum(len(walk.views) + len(walk.held_out) for walk in walks), 0
    for walk in walks:
        trajectory, is_view = walk.trajectory, set(walk.views.tolist())
        chosen = np.sort(np.concatenate([walk.views, walk.held_out]))
        looks.append([])
        shown = walk.features.of(trajectory.rows[chosen].tolist())
        for row, (found, look, picture) in zip(chosen.tolist(), shown, strict=True):
            looks[-1].append(look)
            if row in is_view:
                pictures.append(picture)
                cameras.append(trajectory.camera)
                poses.append(trajectory.T_map_camera[row])
                times.append(float(trajectory.times[row]))
                features.append(trajectory.at_once(row, found))
                ranges_m.append(_ranges(walk, row, features[-1]))
            else:
                held.append((trajectory.camera, trajectory.T_map_camera[row], found))
            done += 1
            progress(Stage.OBSERVATIONS, 0.3 * done / total, f"features of {done} of {total} frames")
    views = Views.from_features(cameras, np.array(poses), np.array(times), features, np.concatenate(ranges_m))
    return views, held, looks, tuple(pictures) if options.pictures else None


def _ranges(walk: _Walk, row: int, features: FeatureSet) -> FloatArray:
    """Distances (F,) [m] of features in the trajectory's ``row`` by its depth image; NaN if unknown or not metric."""
    depth, camera = walk.recording.depth, walk.trajectory.camera
    image = (
        None
        if depth is None or walk.trajectory.scale is not Scale.METRIC
        else depth.of_frame(int(walk.trajectory.rows[row]), camera)
    )
    if image is None:
        return np.full(len(features), np.nan)
    rays = camera.rays(features.pixels)
    return np.asarray(image.at(rays) / rays[:, 2])


def reconstruct(
    views: Views, extractor: Extractor, progress: ProgressListener, walk_of_view: IntArray | None = None
) -> tuple[Landmarks, BoolArray]:
    """Reconstruct points from views: link tracks, triangulate, extend twice, select (400 landmarks per ordinary view).

    Args:
        views: K views.
        extractor: extractor of their features.
        progress: called with the share done and a line about it.
        walk_of_view: (K,) number of the walk that each view belongs to.

    Returns:
        All F points, and the mask (F,) of those that become landmarks of the map.

    Raises:
        MappingFailed: fewer than 60 landmarks are stable.
        Cancelled: ``progress`` asked to stop.
    """
    labels = link_observations(views, extractor.metric, progress)
    progress(Stage.DENSITIES, 0.0, f"{int(labels.max(initial=-1)) + 1} tracks")
    landmarks = triangulate(views, with_ranged(views, labels))
    for round_ in range(_EXTENSION_ROUNDS):
        landmarks = extend_and_merge(views, landmarks, extractor.metric)
        progress(Stage.DENSITIES, 0.2 * (round_ + 1), f"{len(landmarks)} features")
    per_view = round(_FEATURES_PER_VIEW * max(camera.breadth for camera in views.cameras))
    stable = are_stable(views, landmarks, per_view, walk_of_view)
    count = int(stable.sum())
    if count < _MIN_FEATURES:
        raise MappingFailed(
            f"Too few points have a well-known position: {count} of the {_MIN_FEATURES} that a map needs.",
            "Walk slowly, farther and sideways rather than turning on the spot, with more light and texture in view.",
        )
    return landmarks, stable


def _assemble(
    walks: Sequence[_Walk],
    views: Views,
    walk_of_view: IntArray,
    landmarks: Landmarks,
    extractor: Extractor,
    options: BuildOptions,
) -> Map:
    """Map of version 1 with ``ray`` densities, whose sources are the walks. Triangulates the landmarks again."""
    info = MapInfo(
        id=uuid.uuid4().hex,
        version=1,
        density=DensityKind.RAY,
        features=extractor.name,
        metric=all(walk.trajectory.scale is Scale.METRIC for walk in walks),
        upright=all(walk.trajectory.upright for walk in walks),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        camera=walks[0].trajectory.camera,
        sources=tuple(_source(walk, options) for walk in walks),
        waypoints=tuple(_waypoint(waypoint, walk) for walk in walks for waypoint in walk.recording.waypoints),
        earth=_earth([waypoint for walk in walks for waypoint in walk.recording.waypoints]),
    )
    map_ = assemble(info, views, landmarks, walk_of_view, extractor.metric)
    checked = replace(map_.views, covariances=_view_covariances(walks), second_positions=_second_positions(walks))
    return with_landmarks(replace(map_, views=checked))


def _in_one_frame(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings, waypoints on Earth converted to metres east, north and up of the first such waypoint."""
    places = [waypoint.earth for recording in recordings for waypoint in recording.waypoints if waypoint.earth]
    return [
        replace(
            recording,
            waypoints=tuple(
                replace(waypoint, position=tuple(enu_of(waypoint.earth, places[0]).tolist()))
                if waypoint.earth
                else waypoint
                for waypoint in recording.waypoints
            ),
        )
        for recording in recordings
    ]


def _earth(waypoints: Sequence[Waypoint]) -> SiteOnEarth | None:
    """Pose on Earth of a map whose frame its waypoints fixed; None unless all of them (at least one) are on Earth."""
    places = [waypoint.earth for waypoint in waypoints if waypoint.earth is not None]
    if not places or len(places) < len(waypoints):
        return None
    positions = np.array([waypoint.position for waypoint in waypoints])
    return SiteOnEarth.through(positions, places)[0]


def _view_covariances(walks: Sequence[_Walk]) -> FloatArray | None:
    """Covariances (K, 6, 6) of all views, NaN if a trajectory has none; None if no trajectory has any."""
    found = _of_views(walks, lambda trajectory: trajectory.covariances, (6, 6))
    return None if found is None else storable_covariances(found)


def _second_positions(walks: Sequence[_Walk]) -> FloatArray | None:
    """Positions (K, 3) float32 of all views in second reconstructions; NaN where one is missing, None if all are."""
    found = _of_views(walks, lambda trajectory: trajectory.second_positions, (3,))
    return None if found is None else found.astype(np.float32)


def _of_views(
    walks: Sequence[_Walk], column: Callable[[Trajectory], FloatArray | None], shape: tuple[int, ...]
) -> FloatArray | None:
    """The views' rows (K, *shape) of a column of their trajectories; NaN where one has none, None if all have none."""
    columns = [column(walk.trajectory) for walk in walks]
    if all(one is None for one in columns):
        return None
    return np.concatenate(
        [
            np.full((len(walk.views), *shape), np.nan) if one is None else one[walk.views]
            for walk, one in zip(walks, columns, strict=True)
        ]
    )


def _source(walk: _Walk, options: BuildOptions) -> Source:
    """Description of a walk's recording, with its numbers of frames, poses, views and held-out frames."""
    return Source(
        id=recording_id(walk.recording),
        name=walk.recording.name,
        camera=walk.trajectory.camera,
        frames=len(walk.recording.frames.times),
        posed=len(walk.trajectory.rows),
        views=len(walk.views),
        held_out=len(walk.held_out),
        poses=str(options.poses),
    )


def _waypoint(waypoint: Waypoint, walk: _Walk) -> MapWaypoint:
    """A walk's waypoint with its residual against the trajectory [m]; None if the trajectory reports none."""
    residuals = walk.trajectory.report.waypoint_residuals_m or {}
    return MapWaypoint(waypoint.name, waypoint.position, residuals.get(waypoint.name))
