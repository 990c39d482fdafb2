"""What keyframes see, and what the IMU and waypoints measured → the keyframes' poses. Runs in a child process."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from rholoc.errors import MappingFailed
from rholoc.features import FeatureSet
from rholoc.geometry import BoolArray, Camera, FloatArray, IntArray, Similarity, pose_matrix
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import GRAVITY, Imu, Waypoint
from rholoc.recordings.tables.waypoints import DEFAULT_SIGMA_M
from rholoc.trajectory.checks.agreement import Agreement, compare
from rholoc.trajectory.checks.blame import LeftOut, leave_out, worst
from rholoc.trajectory.frame.map_frame import (
    MapFrame,
    frame_of_first_camera,
    frame_of_waypoints,
    up_by_gravity,
    up_by_pictures,
)
from rholoc.trajectory.frame.upright import rotation_to_upright
from rholoc.trajectory.frame.waypoint_alignment import MAX_GAP_S
from rholoc.trajectory.inertial.gyroscope import GyroCalibration, camera_rotations
from rholoc.trajectory.initialization.global_positioning import global_positions
from rholoc.trajectory.initialization.inertial_start import InertialStart, inertial_start
from rholoc.trajectory.initialization.rotation_averaging import average_rotations
from rholoc.trajectory.optimization.adjustment import (
    GIVEN,
    GUESSED,
    Adjusted,
    CameraSigmas,
    Fix,
    InertialState,
    Problem,
    State,
    adjust,
    residuals_px,
    triangulate,
)
from rholoc.trajectory.optimization.loop_closure import PlacedFeatures, loop_pose, loops_in_reach, place_features
from rholoc.trajectory.optimization.pose_graph import RelativePose, bend
from rholoc.trajectory.visual.camera_guess import calibrate_by_flow, guess_camera
from rholoc.trajectory.visual.directions import PairDirection, direction_between
from rholoc.trajectory.visual.flow import Flow
from rholoc.trajectory.visual.matching import VerifiedPair, match_keyframes
from rholoc.trajectory.visual.rolling_shutter import RollingShutter
from rholoc.trajectory.visual.tracks import Observations, followed_corners, matched_features, pieces_of
from rholoc.trajectory.visual.two_view import PairRotation

_CORNERS_PER_KEYFRAME = 90
_FEATURES_PER_KEYFRAME = 150
_USUAL_KEYFRAMES = 1000
_CORNERS_APART = (1, 2, 4, 8)  # keyframes, between which corners show the direction of the way
_FEWEST_CORNERS = 15
_DIRECTION_TOLERANCE_PX = 2.0
_FOLLOWED = 60  # corners that neighbouring keyframes share, in the median, where pictures are close enough to follow
_ROUNDS = 2  # of adjusting and judging sightings anew …
_ROUNDS_OF_PICTURES = 3  # … without an IMU, from a start that is less near
_ITERATIONS = 12
_LAST_ITERATIONS = 8
_FEWEST_PX, _OUTLIER = 2.5, 5.0  # a sighting this far off is left out, or so many times the median
_LEAST_PIXEL_SIGMA_PX = 0.35
_MEDIAN_TO_SIGMA = 1 / 1.177  # of a coordinate, from the median length of a two-vector of normal errors
_SEEN = 12  # sightings that place a keyframe by itself
_CARRIED_SIGMA_M = 0.05  # up to which the IMU alone places a keyframe
_COVARIANCES = 60  # keyframes, spread over the walk, whose covariance is computed; between them it is interpolated …
_JUDGING = 12  # … and while loops are judged
_FAR_M = 0.15  # by which a walk is bent at most where an adjustment alone closes its loops, or meets its waypoints
_ACCELEROMETER_SCALE = 0.01  # from which it is corrected
_NOISE_PRIOR = 2.0  # coordinates that were off as much as assumed
_NOISE_FACTORS = (0.4, 2.0)
_MAX_MISTAKES = 0.34  # the share of the waypoints that may be found mistaken

_MODELLED_DISTORTION = 4  # coefficients: k1, k2, p1, p2

_ADVICE = "Walk slower, keep more texture in view."


@dataclass(frozen=True, eq=False)
class Sights:
    """What K keyframes see.

    Attributes:
        flow: corners followed through all frames.
        rows: (K,) the keyframes.
        features: of each, in pixels of the full image.
        camera: None where the intrinsics are unknown.
        shutter: how the image moves while it is read, or None. The features are corrected for it already.
    """

    flow: Flow
    rows: IntArray
    features: Sequence[FeatureSet]
    camera: Camera | None
    shutter: RollingShutter | None = None

    @property
    def times(self) -> FloatArray:
        """(K,) seconds."""
        return np.asarray(self.flow.times[self.rows])

    def take(self, some: IntArray) -> Sights:
        """The same of some of the keyframes."""
        shutter = None if self.shutter is None else self.shutter.take(some)
        return replace(self, rows=self.rows[some], features=[self.features[k] for k in some.tolist()], shutter=shutter)


@dataclass(frozen=True, eq=False)
class InertialFigures:
    """What the adjustment found out about the IMU.

    Attributes:
        gyro: how it relates to the camera.
        scale_sigma: of the walk's size, relative.
        accelerometer_bias: (3,) m/s², in the middle of the walk.
        lever_m: (3,) the IMU's place in the camera's axes.
        clock_s: to be added to the calibrated time offset.
        accelerometer_scale: what it reads for one m/s².
        residual: of the accelerations, in units of the noise expected.
        misfit: by how many times its noise the IMU disagrees with what the pictures alone say between keyframes.
    """

    gyro: GyroCalibration
    scale_sigma: float
    accelerometer_bias: FloatArray
    lever_m: FloatArray
    clock_s: float
    accelerometer_scale: float
    residual: float
    misfit: float


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Poses of K keyframes in the map frame, and what is known of them.

    Attributes:
        placed: (K,) bool, which keyframes have a pose.
        T_map_camera: (K, 4, 4); meaningless where a keyframe has none.
        covariances: (K, 6, 6), see :class:`rholoc.trajectory.Trajectory`.
        camera: the intrinsics.
        focal_sigma_px: of a focal length that was estimated, else None.
        frame: how the map's frame came about.
        imu: None where the IMU was not used.
        imu_reason: one line on why it was not, or empty.
        left_out: each waypoint, by its name, held against the walk without it.
        mistaken: the names of the waypoints that were left out.
        residual_px: the median over the sightings.
        landmarks: points that were used.
        loops: pairs of keyframes that show a place seen again.
        median_depth: of the points before the cameras that see them, in the map's unit.
        agreement: with a second reconstruction, where no IMU checks the pictures.
    """

    placed: BoolArray
    T_map_camera: FloatArray
    covariances: FloatArray
    camera: Camera
    focal_sigma_px: float | None
    frame: MapFrame
    imu: InertialFigures | None
    imu_reason: str
    left_out: dict[str, LeftOut]
    mistaken: tuple[str, ...]
    residual_px: float
    landmarks: int
    loops: int
    median_depth: float
    agreement: Agreement | None = None


@dataclass(frozen=True, eq=False)
class _Evidence:
    """What the pictures alone tell: corners that were followed, matches of neighbours, and of places seen again."""

    corners: Observations
    turned: list[PairRotation]
    sequential: list[VerifiedPair]
    loops: list[VerifiedPair]

    @property
    def rotations(self) -> list[PairRotation]:
        """Between pairs of keyframes."""
        return [*self.turned, *(pair.rotation for pair in (*self.sequential, *self.loops))]

    def observations(self, sights: Sights) -> Observations:
        """Of the points that corners and matches are of; in long walks fewer of each keyframe."""
        share = min(1.0, np.sqrt(_USUAL_KEYFRAMES / len(sights.rows)))
        places = [features.pixels.astype(np.float64) for features in sights.features]
        matched = matched_features(places, [*self.sequential, *self.loops])
        matched = matched.thinned(round(share * _FEATURES_PER_KEYFRAME))
        found = self.corners.thinned(round(share * _CORNERS_PER_KEYFRAME)).joined(matched)
        if len(found) == 0:
            raise MappingFailed("The pictures show nothing that could be followed from one to the next.", _ADVICE)
        return found


def reconstruct(
    sights: Sights,
    imu: Imu | None,
    waypoints: Sequence[tuple[Waypoint, ...]],
    progress: ProgressListener = silent,
) -> Reconstruction:
    """Poses from all that was measured.

    Args:
        sights: what the keyframes see.
        imu: None where there is none, or it is not to be used.
        waypoints: at their times; where those are not known, every way to tell them. None of them: empty.
        progress: hears of :data:`Stage.POSES`.

    Raises:
        MappingFailed: the pictures do not hang together, or the waypoints contradict them.
    """
    with threadpool_limits(1, "blas"):  # matrices are small: more threads only wait for each other
        return _reconstruct(sights, imu, waypoints, progress)


def _reconstruct(
    sights: Sights, imu: Imu | None, waypoints: Sequence[tuple[Waypoint, ...]], progress: ProgressListener
) -> Reconstruction:
    camera = sights.camera or guess_camera(sights.flow, imu)
    gyro, reason = (None, "") if imu is None else _calibrated(sights, camera, imu)
    felt = None if imu is None or gyro is None else camera_rotations(imu, gyro, sights.times)
    evidence = _look(sights, camera, felt, progress)
    steps = _Steps(progress)
    if imu is not None and gyro is not None and felt is not None:
        start = _start_with_imu(sights, camera, evidence, imu, gyro, felt)
        if start is not None:
            return _solve_with_imu(sights, imu, gyro, evidence, start, waypoints, steps)
        reason = "The pictures do not show enough of the walk for the accelerometer to measure it."
    found = _solve_from_pictures(sights, camera, evidence, waypoints, reason, steps)
    steps.step(0.95, 0.99, "checked by a second reconstruction")
    return replace(found, agreement=_agreement(found, sights))


def _agreement(found: Reconstruction, sights: Sights) -> Agreement:
    """Hold a reconstruction from pictures against another, from every other keyframe alone."""
    some = np.arange(0, len(sights.rows), 2)
    half = sights.take(some)
    try:
        other = _solve_from_pictures(
            half, found.camera, _look(half, found.camera, None, silent), (), "", _Steps(silent)
        )
    except MappingFailed:
        return Agreement(np.nan, np.nan, np.nan, 0, len(some))
    return compare(found.T_map_camera, found.placed, some, other.T_map_camera, other.placed, found.median_depth)


class _Steps:
    """Reports how far a chain of adjustments is."""

    def __init__(self, progress: ProgressListener) -> None:
        self._progress = progress
        self._from, self._to, self._what = 0.4, 0.45, ""

    def step(self, start: float, end: float, what: str) -> Callable[[float], None]:
        """The next one goes from one fraction to another."""
        self._from, self._to, self._what = start, end, what
        self(0.0)
        return self

    def __call__(self, fraction: float) -> None:
        done = self._from + (self._to - self._from) * fraction
        self._progress(Stage.POSES, min(done, 0.99), self._what)


def _calibrated(sights: Sights, camera: Camera, imu: Imu) -> tuple[GyroCalibration | None, str]:
    """The gyroscope against the pictures, or why it is of no use."""
    gyro = calibrate_by_flow(sights.flow, camera, imu)
    if gyro is None:
        return None, "IMU and video hardly overlap; the poses are from the pictures alone."
    if not gyro.fits:
        return None, (
            f"The gyroscope contradicts the pictures: moment by moment they turn {gyro.residual_deg:.1f}° apart. "
            "The poses are from the pictures alone."
        )
    if not gyro.mounting_is_known:
        return None, (
            "How the IMU is mounted is not known, and the camera hardly turns about two axes, which would show it. "
            "The poses are from the pictures alone."
        )
    if not imu.includes_gravity:
        return None, "The recorder took gravity out of the acceleration. The poses are from the pictures alone."
    return gyro, ""


def _look(sights: Sights, camera: Camera, felt: Rotation | None, progress: ProgressListener) -> _Evidence:
    """Sightings by followed corners and by matched features, and rotations between keyframes."""
    corners, rotations = followed_corners(sights.flow, sights.rows, camera, felt, sights.shutter)
    planes = [camera.undistort(features.pixels.astype(np.float64)) for features in sights.features]
    sequential, loops = match_keyframes(
        sights.features, planes, camera.focal, sights.times, felt, _is_followed(sights), progress
    )
    return _Evidence(corners, rotations, sequential, loops)


def _is_followed(sights: Sights) -> bool:
    rows = sights.rows.tolist()
    shared = [len(sights.flow.shared(a, b)[0]) for a, b in itertools.pairwise(rows)]
    return bool(np.median(shared) >= _FOLLOWED) if shared else False


def _start_with_imu(
    sights: Sights, camera: Camera, evidence: _Evidence, imu: Imu, gyro: GyroCalibration, felt: Rotation
) -> tuple[State, InertialStart] | None:
    """A metric, upright start from rotations, directions between neighbours, and the IMU."""
    count, times = len(sights.rows), sights.times
    R, _ = average_rotations(count, replace(evidence, loops=[]).rotations, times, felt)
    along = _directions(sights, camera, R, evidence.sequential)
    start = inertial_start(times, R, along, imu, gyro)
    if start is None:
        return None
    upright = rotation_to_upright(start.up)
    T_imu_camera = pose_matrix(gyro.R_camera_imu.T, np.zeros(3))
    biases = np.tile(np.concatenate([start.accelerometer_bias, gyro.bias]), (count, 1))
    inertial = InertialState(start.velocities @ upright.T, biases, T_imu_camera, 0.0, np.array([0.0, 0.0, -GRAVITY]))
    T = pose_matrix(upright @ R, start.positions @ upright.T)
    return State(T, np.zeros((0, 3)), camera, inertial), start


def _directions(sights: Sights, camera: Camera, R: FloatArray, pairs: Sequence[VerifiedPair]) -> list[PairDirection]:
    """Between keyframes a few apart, by followed corners, and between pairs whose features match."""
    found: list[PairDirection | None] = []
    rows = sights.rows.tolist()
    for apart in _CORNERS_APART:
        for k in range(len(rows) - apart):
            shared, a, b = sights.flow.shared(rows[k], rows[k + apart])
            if len(shared) >= _FEWEST_CORNERS:
                plane = camera.undistort(a), camera.undistort(b)
                found.append(direction_between(k, k + apart, R, plane, _DIRECTION_TOLERANCE_PX, camera.focal))
    found += [_direction_of(sights, camera, R, pair) for pair in pairs]
    return [one for one in found if one is not None]


def _direction_of(sights: Sights, camera: Camera, R: FloatArray, pair: VerifiedPair) -> PairDirection | None:
    a, b = (
        camera.undistort(sights.features[keyframe].pixels[pair.matches[:, side]].astype(np.float64))
        for side, keyframe in enumerate((pair.first, pair.second))
    )
    return direction_between(pair.first, pair.second, R, (a, b), _DIRECTION_TOLERANCE_PX, camera.focal)


def _positions_of(members: IntArray, R: FloatArray, observations: Observations, plane: FloatArray) -> FloatArray:
    """The positions (N, 3) of some keyframes from what they see together."""
    number = np.full(len(R), -1)
    number[members] = np.arange(len(members))
    within = number[observations.keyframes] >= 0
    tracks = observations.tracks[within]
    often = np.bincount(tracks, minlength=observations.points)[tracks] >= 2
    rows = np.flatnonzero(within)[often]
    _, tracks = np.unique(observations.tracks[rows], return_inverse=True)
    return global_positions(R[members], number[observations.keyframes[rows]], tracks, plane[rows])


def _solve_with_imu(
    sights: Sights,
    imu: Imu,
    gyro: GyroCalibration,
    evidence: _Evidence,
    start: tuple[State, InertialStart],
    waypoints: Sequence[tuple[Waypoint, ...]],
    steps: _Steps,
) -> Reconstruction:
    state, began = start
    steady = replace(evidence, loops=[])
    problem = Problem(sights.times, steady.observations(sights), imu, gyro, camera_sigmas=_camera_sigmas(sights.camera))
    problem, adjusted = _adjusted_in_rounds(problem, state, steps, (0.45, 0.6))
    misfit = adjusted.imu_misfit()
    if misfit > 1:
        problem = replace(problem, imu_noise=misfit)
        adjusted = adjust(problem, adjusted.state, _ITERATIONS, steps)
    evidence, problem, adjusted = _closed_loops(sights, evidence, problem, adjusted, steps)
    assert adjusted.state.inertial is not None
    read = float(np.linalg.norm(adjusted.state.inertial.gravity)) / GRAVITY
    if abs(read - 1) > _ACCELEROMETER_SCALE:
        imu = replace(imu, acceleration=imu.acceleration / read)
        problem = replace(problem, imu=imu)
        adjusted = adjust(problem, _of_corrected_scale(adjusted.state, read), _LAST_ITERATIONS, steps)
    else:
        read = 1.0
    scale_sigma = _scale_sigma(adjusted)
    left_out: dict[str, LeftOut] = {}
    mistaken: tuple[str, ...] = ()
    up, why_up = up_by_gravity()
    if waypoints:
        frame = frame_of_waypoints(sights.times, adjusted.state.T_map_camera, waypoints, up, why_up, scale_sigma)
        level = None if not frame.upright else problem.level_sigma_rad
        problem = replace(problem, level_sigma_rad=level)
        problem, adjusted, left_out, mistaken = _held_by_waypoints(
            problem, adjusted.state, sights.times, frame, evidence.loops, steps
        )
    else:
        depth = _median_depth(problem.observations, adjusted)
        frame = frame_of_first_camera(adjusted.state.T_map_camera, up, why_up, depth, scale_sigma)
    inertial = adjusted.state.inertial
    assert inertial is not None
    middle = len(sights.rows) // 2
    R_camera_imu = inertial.T_imu_camera[:3, :3].T
    figures = InertialFigures(
        gyro,
        scale_sigma,
        inertial.biases[middle, :3],
        -R_camera_imu @ inertial.T_imu_camera[:3, 3],
        inertial.clock_s,
        read,
        began.residual,
        misfit,
    )
    return _finished(sights, evidence, problem, adjusted, frame, waypoints, figures, "", left_out, mistaken)


def _closed_loops(
    sights: Sights, evidence: _Evidence, problem: Problem, adjusted: Adjusted, steps: _Steps
) -> tuple[_Evidence, Problem, Adjusted]:
    """Adjust with the loops that the walk without them allows; judged again once they have shown how it drifted."""
    if not evidence.loops:
        return evidence, problem, adjusted
    pixels = [features.pixels.astype(np.float64) for features in sights.features]
    for span, rounds in (((0.6, 0.65), 1), ((0.65, 0.75), _ROUNDS)):
        sigmas_m = np.sqrt(np.trace(_spread_covariances(adjusted, len(pixels), _JUDGING)[:, :3, :3], axis1=1, axis2=2))
        placed = place_features(evidence.sequential, pixels, adjusted.state)
        in_reach = loops_in_reach(evidence.loops, placed, sigmas_m)
        kept = [pair for pair, keep in zip(evidence.loops, in_reach, strict=True) if keep]
        problem = replace(problem, observations=replace(evidence, loops=kept).observations(sights))
        problem, adjusted = _adjusted_in_rounds(problem, _with_loops_met(kept, placed), steps, span, rounds)
    return replace(evidence, loops=kept), problem, adjusted


def _with_loops_met(loops: Sequence[VerifiedPair], placed: PlacedFeatures) -> State:
    """The walk, bent where its loops are too far from closing for an adjustment to close them."""
    poses = [pose for pair in loops if (pose := loop_pose(pair, placed)) is not None]
    bent = bend(placed.state, poses)
    moved_m = np.linalg.norm(bent.positions - placed.state.positions, axis=1)
    return bent if moved_m.max() > _FAR_M else placed.state


def _camera_sigmas(given: Camera | None) -> CameraSigmas | None:
    """How far the walk may correct the intrinsics: not at all where the adjustment's model could not hold them."""
    if given is None:
        return GUESSED
    return GIVEN if len(given.distortion) <= _MODELLED_DISTORTION else None


def _of_corrected_scale(state: State, read: float) -> State:
    """The state of a walk whose accelerometer read ``read`` times too much."""
    assert state.inertial is not None
    T = state.T_map_camera.copy()
    T[:, :3, 3] /= read
    inertial = replace(
        state.inertial, velocities=state.inertial.velocities / read, gravity=state.inertial.gravity / read
    )
    return replace(state, T_map_camera=T, points=state.points / read, inertial=inertial)


def _solve_from_pictures(
    sights: Sights,
    camera: Camera,
    evidence: _Evidence,
    waypoints: Sequence[tuple[Waypoint, ...]],
    reason: str,
    steps: _Steps,
) -> Reconstruction:
    whole = evidence.observations(sights)
    state, members = _start_from_pictures(sights, camera, evidence.rotations, whole)
    some = sights.take(members)
    number = np.full(len(sights.rows), -1)
    number[members] = np.arange(len(members))
    numbered = Observations(number[whole.keyframes], whole.tracks, whole.pixels)
    observations = numbered.take(numbered.keyframes >= 0)
    problem = Problem(some.times, observations, camera_sigmas=_camera_sigmas(sights.camera))
    problem, adjusted = _adjusted_in_rounds(problem, state, steps, (0.45, 0.75), _ROUNDS_OF_PICTURES)
    left_out: dict[str, LeftOut] = {}
    mistaken: tuple[str, ...] = ()
    depth = _median_depth(problem.observations, adjusted)
    up, why_up = up_by_pictures(adjusted.state.R_map_camera)
    if waypoints:
        frame = frame_of_waypoints(some.times, adjusted.state.T_map_camera, waypoints, up, why_up)
        problem, adjusted, left_out, mistaken = _held_by_waypoints(
            problem, adjusted.state, some.times, frame, (), steps
        )
    else:
        frame = frame_of_first_camera(adjusted.state.T_map_camera, up, why_up, depth, None)
    part = _finished(some, evidence, problem, adjusted, frame, waypoints, None, reason, left_out, mistaken)
    count = len(sights.rows)
    placed = np.zeros(count, dtype=np.bool_)
    placed[members] = part.placed
    T = np.tile(np.eye(4), (count, 1, 1))
    T[members] = part.T_map_camera
    covariances = np.zeros((count, 6, 6))
    covariances[members] = part.covariances
    return replace(part, placed=placed, T_map_camera=T, covariances=covariances)


def _start_from_pictures(
    sights: Sights, camera: Camera, rotations: Sequence[PairRotation], observations: Observations
) -> tuple[State, IntArray]:
    """The largest piece of the walk: its state in a frame of its own, and its keyframes."""
    count = len(sights.rows)
    R, component = average_rotations(count, rotations, sights.times, None)
    piece = pieces_of(count, observations)
    both = component * (count + 1) + piece
    both[piece < 0] = -1
    kinds, sizes = np.unique(both[both >= 0], return_counts=True)
    if len(kinds) == 0:
        raise MappingFailed("No two pictures overlap enough.", _ADVICE)
    members = np.flatnonzero(both == kinds[sizes.argmax()])
    positions = _positions_of(members, R, observations, camera.undistort(observations.pixels))
    return State(pose_matrix(R[members], positions), np.zeros((0, 3)), camera), members


def _adjusted_in_rounds(
    problem: Problem, state: State, steps: _Steps, span: tuple[float, float], rounds: int = _ROUNDS
) -> tuple[Problem, Adjusted]:
    """Adjust, and judge all sightings anew by what comes out; the problem with those that are right."""
    everything = problem.observations
    edges = np.linspace(*span, rounds + 1).tolist()
    step = steps.step(edges[0], edges[1], "all measurements adjusted together")
    adjusted = adjust(problem, state, _ITERATIONS, step, coarsely=True)
    for start, end in itertools.pairwise(edges[1:]):
        off = residuals_px(everything, adjusted.state, triangulate(everything, adjusted.state)[0])
        problem = _cleaned(problem, everything, off)
        again = steps.step(start, end, "adjusted anew")
        adjusted = adjust(problem, adjusted.state, _ITERATIONS, again, coarsely=end < span[1])
    return problem, adjusted


def _cleaned(problem: Problem, observations: Observations, off_px: FloatArray) -> Problem:
    typical = float(np.median(off_px[np.isfinite(off_px)]))
    kept = observations.take(off_px <= max(_FEWEST_PX, _OUTLIER * typical))
    sigma = max(_LEAST_PIXEL_SIGMA_PX, _MEDIAN_TO_SIGMA * typical)
    return replace(problem, observations=kept, pixel_sigma_px=sigma)


def _held_by_waypoints(
    problem: Problem,
    state: State,
    times: FloatArray,
    frame: MapFrame,
    loops: Sequence[VerifiedPair],
    steps: _Steps,
) -> tuple[Problem, Adjusted, dict[str, LeftOut], tuple[str, ...]]:
    """Adjust with the waypoints; those that all else contradicts are taken out, the furthest off first."""
    state = _moved(state, frame.similarity)
    nearest = {waypoint.name: int(np.abs(times - waypoint.time).argmin()) for waypoint in frame.waypoints}
    measured = {waypoint.name: waypoint for waypoint in frame.waypoints}
    names = [name for name in nearest if abs(times[nearest[name]] - measured[name].time) <= MAX_GAP_S]
    everywhere = tuple(Fix(nearest[name], measured[name].position, measured[name].sigma_m) for name in names)
    state = _with_waypoints_met(state, everywhere, loops)
    mistaken: list[str] = []
    outs: dict[str, LeftOut] = {}
    for attempt in range(1 + int(_MAX_MISTAKES * len(names)) + 1):
        trusted = [name for name in names if name not in mistaken]
        fixes = tuple(Fix(nearest[name], measured[name].position, measured[name].sigma_m) for name in trusted)
        problem = replace(problem, fixes=fixes)
        step = steps.step(0.75 + 0.05 * min(attempt, 2), 0.8 + 0.05 * min(attempt, 2), "adjusted to the waypoints")
        adjusted = adjust(problem, state, _ITERATIONS, step)
        state = adjusted.state
        covariances = adjusted.covariances([nearest[name] for name in names])[:, :3, :3]
        for name, covariance in zip(names, covariances, strict=True):
            place, point = state.positions[nearest[name]], np.array(measured[name].position)
            if name in mistaken:
                off = point - place
                expected = covariance + measured[name].sigma_m ** 2 * np.eye(3)
                outs[name] = LeftOut(off, float(np.sqrt(off @ np.linalg.solve(expected, off))))
            else:
                outs[name] = leave_out(point, place, covariance, measured[name].sigma_m)
        wrong = worst(trusted, [outs[name] for name in trusted])
        if wrong is None or len(trusted) <= 3 or len(mistaken) + 1 > _MAX_MISTAKES * len(names):
            break
        mistaken.append(trusted[wrong])
    factor = _noise_factor([outs[name].sigmas for name in trusted])
    fixes = tuple(
        replace(fix, sigma_m=factor * fix.sigma_m) if fix.sigma_m == DEFAULT_SIGMA_M else fix for fix in problem.fixes
    )
    problem = replace(problem, fixes=fixes)
    adjusted = adjust(problem, state, _LAST_ITERATIONS, steps.step(0.9, 0.95, "adjusted to the waypoints"))
    return problem, adjusted, outs, tuple(mistaken)


def _with_waypoints_met(state: State, fixes: tuple[Fix, ...], loops: Sequence[VerifiedPair]) -> State:
    """The walk, bent where it is too far from the waypoints for an adjustment to meet them."""
    missed_m = [np.linalg.norm(state.positions[fix.keyframe] - fix.position) for fix in fixes]
    if state.inertial is None or np.median(missed_m) <= _FAR_M:
        return state
    T = state.T_map_camera
    closed = [RelativePose(a, b, np.linalg.inv(T[a]) @ T[b]) for a, b in ((pair.first, pair.second) for pair in loops)]
    return bend(state, closed, fixes)


def _noise_factor(sigmas: Sequence[float]) -> float:
    """How much more or less than was assumed the waypoints are off, from how far they are off all else in sigmas.

    The mean square over three coordinates each, drawn to one by a prior, for waypoints are few.
    """
    squares = _NOISE_PRIOR + sum(value**2 for value in sigmas)
    return float(np.clip(np.sqrt(squares / (_NOISE_PRIOR + 3 * len(sigmas))), *_NOISE_FACTORS))


def _moved(state: State, similarity: Similarity) -> State:
    """The state in another frame."""
    inertial = state.inertial
    if inertial is not None:
        R, scale = similarity.rotation, similarity.scale
        inertial = replace(inertial, velocities=scale * inertial.velocities @ R.T, gravity=R @ inertial.gravity)
    T = similarity.poses(state.T_map_camera)
    return State(T, similarity.points(state.points), state.camera, inertial)


def _scale_sigma(adjusted: Adjusted) -> float:
    """How well the walk's size is known, relative: by the place of the keyframe that is furthest from the first."""
    away = adjusted.state.positions - adjusted.state.positions[0]
    far = int(np.argmax(np.linalg.norm(away, axis=1)))
    length = max(float(np.linalg.norm(away[far])), 1e-9)
    covariance = adjusted.covariances([far])[0, :3, :3]
    along = away[far] / length
    return float(np.sqrt(along @ covariance @ along)) / length


def _median_depth(observations: Observations, adjusted: Adjusted) -> float:
    state, used = adjusted.state, adjusted.used
    points, T = state.points[observations.tracks[used]], state.T_map_camera[observations.keyframes[used]]
    depths = np.einsum("ni,ni->n", points - T[:, :3, 3], T[:, :3, 2])
    return float(np.median(depths[depths > 0]))


def _finished(
    sights: Sights,
    evidence: _Evidence,
    problem: Problem,
    adjusted: Adjusted,
    frame: MapFrame,
    waypoints: Sequence[tuple[Waypoint, ...]],
    figures: InertialFigures | None,
    reason: str,
    left_out: dict[str, LeftOut],
    mistaken: tuple[str, ...],
) -> Reconstruction:
    """Covariances, what counts as placed, and the map's frame where waypoints have not given it."""
    covariances = _spread_covariances(adjusted, len(sights.rows), _COVARIANCES)
    state, scale = adjusted.state, 1.0
    if not waypoints:
        state, scale = _moved(state, frame.similarity), frame.similarity.scale
        turn = np.zeros((6, 6))
        turn[:3, :3] = scale * frame.similarity.rotation
        turn[3:, 3:] = frame.similarity.rotation
        covariances = turn @ covariances @ turn.T
    off = residuals_px(problem.observations, adjusted.state)
    right = adjusted.used & (off <= max(_FEWEST_PX, _OUTLIER * float(np.median(off))))
    seen = np.bincount(problem.observations.keyframes[right], minlength=len(sights.rows))
    placed = seen >= _SEEN
    if figures is not None:
        sigma_m = np.sqrt(np.trace(covariances[:, :3, :3], axis1=1, axis2=2))
        usual = float(np.median(sigma_m[placed])) if placed.any() else 0.0
        placed |= sigma_m <= max(_CARRIED_SIGMA_M, 2 * usual)
    focal_sigma = None if sights.camera is not None else float(adjusted.camera_sigmas()[0])
    return Reconstruction(
        placed,
        state.T_map_camera,
        covariances,
        state.camera,
        focal_sigma,
        frame,
        figures,
        reason,
        left_out,
        mistaken,
        float(np.median(off[adjusted.used])),
        len(np.unique(problem.observations.tracks[right])),
        len(evidence.loops),
        scale * _median_depth(problem.observations, adjusted),
    )


def _spread_covariances(adjusted: Adjusted, count: int, computed: int) -> FloatArray:
    """(K, 6, 6): of so many keyframes, and interpolated between them; a mixture of covariances is one."""
    some = np.unique(np.linspace(0, count - 1, min(computed, count)).round().astype(np.int64))
    found = adjusted.covariances(some.tolist())
    after = np.clip(np.searchsorted(some, np.arange(count)), 1, len(some) - 1)
    share = ((np.arange(count) - some[after - 1]) / (some[after] - some[after - 1]))[:, None, None]
    return np.asarray((1 - share) * found[after - 1] + share * found[after])
