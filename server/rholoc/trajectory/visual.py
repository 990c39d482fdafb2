"""Keyframe features → a reconstruction, and whether to trust it. Runs in a child process."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import pycolmap

from rholoc.errors import MappingFailed
from rholoc.features import FeatureSet
from rholoc.geometry import Camera, FloatArray, IntArray
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.trajectory.alignment import align_poses, rotation_angles_deg
from rholoc.trajectory.gyro_guard import GyroGuard
from rholoc.trajectory.loops import Pair, loop_candidates, sequential_pairs, supported_loops
from rholoc.trajectory.self_calibration import SelfCalibration, guessed_cameras, self_calibration
from rholoc.trajectory.structure_from_motion import Reconstruction, reconstruct
from rholoc.trajectory.two_view import VerifiedPair, verify

_OVERLAP = 8  # keyframes that each is matched with in sequence
_LOOPS_EACH = 4
_SEQUENTIAL_INLIERS = 20
_LOOP_INLIERS = 50
_THREADS = 2
MIN_PLACED = 0.7  # the share of the keyframes that must be placed
_MAX_DISAGREEMENT = 0.02  # of the median depth, between two reconstructions that count as the same …
_MAX_DISAGREEMENT_OF_MOST = 0.04  # … and of nine in ten of their keyframes: a part may be wrong, the rest right
_MAX_DISAGREEMENT_DEG = 2.0
_PAIRS_SHARE = 0.4  # of the time that matching takes, for honest fractions
_SEEDS = (1, 2)

_ADVICE = "Walk slower, keep more texture in view."


@dataclass(frozen=True, eq=False)
class VisualPoses:
    """What structure from motion found.

    Attributes:
        reconstruction: the keyframes' poses.
        camera: given, or estimated where it was not.
        calibration: how well it is known where it was estimated, else None.
        loops: how many pairs of keyframes were found to show a place seen again.
        contradicted: how many pairs of keyframes were dropped, because the gyroscope contradicts their rotation.
        trusted: whether a second reconstruction, from every other keyframe, agrees.
        why: one line on that.
        disagreement: the median distance between the two, as a share of the median depth; NaN without a second.
        disagreement_deg: the median angle between the two.
    """

    reconstruction: Reconstruction
    camera: Camera
    calibration: SelfCalibration | None
    loops: int
    contradicted: int
    trusted: bool
    why: str
    disagreement: float
    disagreement_deg: float


def structure_from_motion(
    features: Sequence[FeatureSet],
    camera: Camera | None,
    size: tuple[int, int],
    guard: GyroGuard | None = None,
    progress: ProgressListener = silent,
) -> VisualPoses:
    """Poses of keyframes from their features.

    A reconstruction can look perfect and be wrong, so there are two, from different keyframes, seeds and starting
    pairs: the second is from every other keyframe.

    Args:
        features: SIFT features of each keyframe, in the order of time, pixels of the full image.
        camera: the intrinsics, or None to estimate them.
        size: of the images, width and height in pixels.
        guard: the gyroscope, where there is one; pairs of keyframes that it contradicts are not used.
        progress: hears of :data:`Stage.POSES`.

    Raises:
        MappingFailed: fewer than 70 % of the keyframes could be placed.
    """
    pycolmap.logging.minloglevel = 3  # what fails is told by the error raised
    pycolmap.set_random_seed(_SEEDS[0])
    if len(features) < 2:
        raise MappingFailed("The camera did not move.", "Walk through the room while recording.")
    models, places = _colmap_cameras(features, camera, size)
    sequential, loops = _match(features, places, models[0], progress)
    matched = len(sequential) + len(loops)
    if guard is not None:
        sequential, loops = guard.keep(sequential, loops)

    def told(placed: int) -> None:
        tried = min(placed, len(features))
        share = (tried / len(features)) ** 2  # the later ones take longer
        fraction = _PAIRS_SHARE + (0.99 - _PAIRS_SHARE) * share
        progress(Stage.POSES, fraction, f"{tried} of {len(features)} keyframes tried")

    alternate = np.arange(0, len(features), 2)
    pairs = [*sequential, *loops]
    for model in models:
        with ThreadPoolExecutor(2) as pool:
            first = pool.submit(reconstruct, model, camera is not None, places, pairs, _SEEDS[0], told)
            second = pool.submit(_reconstruct_some, model, camera is not None, places, pairs, alternate)
            full, half = first.result(), second.result()
        placed = 0 if full is None else len(full.placed)
        if placed >= MIN_PLACED * len(features):
            break
    if full is None or placed < MIN_PLACED * len(features):
        raise MappingFailed(f"{placed} of {len(features)} keyframes could be placed.", _ADVICE)
    trusted, why, distance, angle_deg = agreement(full, half, alternate)
    calibration = None
    if camera is None:
        other_focal = None if half is None else float(half.parameters[0])
        calibration = self_calibration(full.parameters, full.sigmas, other_focal, size)
        camera = calibration.camera
    return VisualPoses(full, camera, calibration, len(loops), matched - len(pairs), trusted, why, distance, angle_deg)


def _match(
    features: Sequence[FeatureSet],
    places: Sequence[FloatArray],
    camera: pycolmap.Camera,
    progress: ProgressListener,
) -> tuple[list[VerifiedPair], list[VerifiedPair]]:
    sequential = sequential_pairs(len(features), _OVERLAP)
    candidates = loop_candidates(features, 2 * _OVERLAP + 1, _LOOPS_EACH)
    total = len(sequential) + len(candidates)
    done = 0

    def verified(pair: Pair, fewest: int) -> VerifiedPair | None:
        i, j = pair
        return verify(pair, features[i], features[j], camera, (places[i], places[j]), fewest)

    def run(pairs: list[Pair], fewest: int) -> list[VerifiedPair]:
        nonlocal done
        kept = []
        for found in pool.map(lambda pair: verified(pair, fewest), pairs):
            done += 1
            progress(Stage.POSES, _PAIRS_SHARE * done / total, f"{done} of {total} pairs of keyframes matched")
            if found is not None:
                kept.append(found)
        return kept

    with ThreadPoolExecutor(_THREADS) as pool:
        return run(sequential, _SEQUENTIAL_INLIERS), supported_loops(run(candidates, _LOOP_INLIERS))


def _reconstruct_some(
    camera: pycolmap.Camera,
    camera_is_known: bool,
    places: Sequence[FloatArray],
    pairs: Sequence[VerifiedPair],
    some: IntArray,
) -> Reconstruction | None:
    number = {int(keyframe): i for i, keyframe in enumerate(some)}
    kept = [
        replace(p, first=number[p.first], second=number[p.second])
        for p in pairs
        if p.first in number and p.second in number
    ]
    return reconstruct(camera, camera_is_known, [places[i] for i in some], kept, _SEEDS[1])


def agreement(full: Reconstruction, half: Reconstruction | None, alternate: IntArray) -> tuple[bool, str, float, float]:
    """Whether a reconstruction and one from the ``alternate`` keyframes alone are the same, but for frame and scale.

    Also one line on it, the median distance as a share of the median depth, and the median angle in degrees.
    """
    both = np.zeros(0, np.int64) if half is None else np.intersect1d(full.placed, alternate[half.placed])
    if half is None or len(both) < max(3, MIN_PLACED * len(alternate)):
        return False, f"Only {len(both)} of {len(alternate)} keyframes could be checked.", float("nan"), float("nan")
    a = full.T_world_camera[np.searchsorted(full.placed, both)]
    b = half.T_world_camera[np.searchsorted(alternate[half.placed], both)]
    aligned = align_poses(b, a).poses(b)
    apart = np.linalg.norm(aligned[:, :3, 3] - a[:, :3, 3], axis=1) / full.median_depth
    distance, of_most = float(np.median(apart)), float(np.percentile(apart, 90))
    turned = np.swapaxes(aligned[:, :3, :3], 1, 2) @ a[:, :3, :3]
    angle_deg = float(np.median(rotation_angles_deg(turned)))
    close = distance <= _MAX_DISAGREEMENT and of_most <= _MAX_DISAGREEMENT_OF_MOST
    trusted = close and angle_deg <= _MAX_DISAGREEMENT_DEG
    verb = "agree" if trusted else "disagree"
    why = (
        f"Two reconstructions {verb}: {distance:.1%} of the median depth and {angle_deg:.1f}° apart, "
        f"nine in ten keyframes within {of_most:.1%}."
    )
    return trusted, why, distance, angle_deg


def _colmap_cameras(
    features: Sequence[FeatureSet], camera: Camera | None, size: tuple[int, int]
) -> tuple[list[pycolmap.Camera], list[FloatArray]]:
    """COLMAP's camera, or those to try where it is unknown, and the features' places: its top-left pixel's centre is
    (0.5, 0.5), ours (0, 0).

    Known distortion is taken out of the places, so that one pinhole model serves.
    """
    if camera is None:
        return guessed_cameras(size), [f.pixels.astype(np.float64) + 0.5 for f in features]
    parameters = [camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5]
    model = pycolmap.Camera(model="PINHOLE", width=size[0], height=size[1], params=parameters)
    model.has_prior_focal_length = True  # else COLMAP tries other focal lengths when it places an image
    centre, focal_px = np.array(parameters[2:]), np.array(parameters[:2])
    return [model], [camera.undistort(f.pixels) * focal_px + centre for f in features]
