"""First guess of unknown intrinsics: focal length by the gyroscope, or by the pictures alone."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import poselib

from rholoc.geometry import Camera, FloatArray, on_plane
from rholoc.recordings import Imu
from rholoc.trajectory.inertial.gyroscope import GyroCalibration, calibrate_gyro, spaced_rows
from rholoc.trajectory.visual.flow import Flow
from rholoc.trajectory.visual.two_view import UNIT_CAMERA, relative_pose

_THREADS = 2
_FOCALS = np.arange(0.6, 1.31, 0.1)  # times the longer side of the image: phones and webcams have 0.7 to 1.25
_FINE = np.array([-0.05, 0.05])
_USUAL_FOCAL = 0.85
_INTERVAL_S = 0.2
_MAX_PAIRS = 200  # of frames compared with the gyroscope for one focal length
_TOLERANCE_PX = 1.5
_MIN_SHARED = 15
_CLEARLY = 0.9  # maximum ratio of best to worst residual, for a conclusive result
_PICTURE_PAIRS = 60
_PICTURE_MOTION = 0.08  # image motion between the pictures of a pair, as a share of the longer side
_PLAUSIBLE = (0.5, 2.0)
_MATCHED_PAIRS, _MATCHES = 40, 150  # of pictures, and about so many matches of each, to estimate a focal length
_COMPARED_PAIRS = 12  # of them, by which lenses are compared
_SHARES = (0.5, 0.6, 0.7, 0.85, 1.0, 1.2, 1.5)  # focal lengths of these, in longer sides
_BARRELS = ((0.0, 0.0, 0.0, 0.0), (-0.15, 0.02, 0.0, 0.0), (-0.3, 0.09, 0.0, 0.0))  # and distortions
_MUCH_BETTER = 0.75  # of the misfit without distortion, below which there is some
_ZOOMS = np.geomspace(0.4, 2.5, 24)  # focal lengths of a second lens, in those of the first
_FINE_ZOOMS = np.geomspace(0.94, 1 / 0.94, 9)
_ANOTHER_ZOOM, _TOLD = 1.25, 1.15  # a zoom that must fit worse, and by how much
_MAX_SPREAD = 2.0  # of the upper to the lower quartile of pairs' focal lengths that agree


def centred_camera(size: tuple[int, int], focal_px: float) -> Camera:
    """Camera without distortion, with its principal point in the centre of images of ``size`` (width, height)."""
    width, height = size
    return Camera(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2)


def calibrate_by_flow(flow: Flow, camera: Camera, imu: Imu, most_pairs: int | None = None) -> GyroCalibration | None:
    """Calibrate the gyroscope to camera rotations by optical flow between frames 0.2 s apart.

    ``most_pairs`` limits it to that many frames in the middle. None if :func:`calibrate_gyro`
    finds fewer than seven intervals that IMU and frames share.
    """
    rows = spaced_rows(flow.times, _INTERVAL_S)
    if most_pairs is not None and len(rows) > most_pairs:
        first = (len(rows) - most_pairs) // 2
        rows = rows[first : first + most_pairs]
    R = np.tile(np.eye(3), (len(rows), 1, 1))
    for k in range(1, len(rows)):
        shared, a, b = flow.shared(int(rows[k - 1]), int(rows[k]))
        R[k] = R[k - 1]
        if len(shared) >= _MIN_SHARED:
            view = relative_pose(camera.rays(a), camera.rays(b), _TOLERANCE_PX / camera.focal)
            R[k] = R[k - 1] @ view.R_second_first.T
    return calibrate_gyro(flow.times[rows], R, imu)


def guess_camera(flow: Flow, imu: Imu | None, focal_px: float | None = None, is_film: bool = True) -> Camera:
    """Undistorted camera with the focal length that fits the gyroscope best.

    Without a gyroscope, or if the camera hardly turns, ``focal_px`` if given; else the median over pairs of pictures
    of a film; else 0.85 × the longer side.
    """
    longer = max(flow.size)
    stated = None if focal_px is None else focal_px / longer
    focal = None if imu is None else _focal_by_gyroscope(flow, imu)
    followed = _focal_by_pictures(flow) if is_film and not (focal or stated) else None
    return centred_camera(flow.size, longer * (focal or stated or followed or _USUAL_FOCAL))


def _focal_by_gyroscope(flow: Flow, imu: Imu) -> float | None:
    """Focal length as a share of the longer side; None if inconclusive."""
    residuals: dict[float, float] = {}

    def residual(share: float) -> float:
        share = round(float(share), 3)
        if share not in residuals:
            found = calibrate_by_flow(flow, centred_camera(flow.size, share * max(flow.size)), imu, _MAX_PAIRS)
            residuals[share] = np.inf if found is None or not found.fits else found.residual_deg
        return residuals[share]

    for share in _FOCALS:
        residual(share)
    best = min(residuals, key=lambda share: residuals[share])
    finite = [value for value in residuals.values() if np.isfinite(value)]
    if not finite or residuals[best] > _CLEARLY * max(finite):
        return None
    for step in _FINE:
        residual(best + step)
    best = min(residuals, key=lambda share: residuals[share])
    below, above = residual(best - abs(_FINE[0])), residual(best + abs(_FINE[0]))
    bend = below + above - 2 * residuals[best]
    if not np.isfinite(bend) or bend <= 0:
        return best
    return float(best + 0.5 * abs(_FINE[0]) * (below - above) / bend)


def _focal_by_pictures(flow: Flow) -> float | None:
    """Median over pairs of pictures of the focal length with most inliers (six-point solver), as a share of the longer
    side. None if fewer than ten pairs give a plausible one (0.5 to 2).
    """
    path = np.cumsum(flow.motion)
    starts = np.linspace(0, max(path[-1] - _PICTURE_MOTION, 0.0), _PICTURE_PAIRS)
    first = np.searchsorted(path, starts)
    second = np.minimum(np.searchsorted(path, starts + _PICTURE_MOTION), len(path) - 1)
    centre = (np.array(flow.size, dtype=np.float64) - 1) / 2
    found = []
    for a, b in zip(first.tolist(), second.tolist(), strict=True):
        shared, in_a, in_b = flow.shared(a, b)
        if len(shared) < 2 * _MIN_SHARED:
            continue
        focal, agreeing = _shared_focal(in_a - centre, in_b - centre)
        share = focal / max(flow.size)
        if agreeing > 0.7 * len(shared) and _PLAUSIBLE[0] < share < _PLAUSIBLE[1]:
            found.append(share)
    return float(np.median(found)) if len(found) >= _PICTURE_PAIRS // 6 else None


def camera_by_matches(matched: Sequence[tuple[FloatArray, FloatArray]], size: tuple[int, int]) -> Camera | None:
    """Camera by the pairs of pictures with most matches: one with barrel distortion if it fits them clearly better,
    else one with the median of their focal lengths. None if these do not agree, or are implausible.

    Args:
        matched: pixels (M, 2) of a pair's matches in either picture.
        size: of the images, width and height in pixels.
    """
    thinned = _best_matched(matched)
    if not thinned:
        return None
    cameras = [replace(centred_camera(size, share * max(size)), distortion=k) for share in _SHARES for k in _BARRELS]
    with ThreadPoolExecutor(_THREADS) as pool:
        found = pool.map(lambda camera: _epipolar_misfit(camera, camera, thinned[:_COMPARED_PAIRS]), cameras)
        misfits = dict(zip(cameras, found, strict=True))
    fittest = min(cameras, key=misfits.__getitem__)
    straight = min(misfits[camera] for camera in cameras if not any(camera.distortion))
    if misfits[fittest] < _MUCH_BETTER * straight:
        return fittest
    centre, longer = (np.array(size, dtype=np.float64) - 1) / 2, max(size)
    focal = focal_by_matches([(a - centre, b - centre) for a, b in thinned])
    is_plausible = focal is not None and _PLAUSIBLE[0] * longer < focal < _PLAUSIBLE[1] * longer
    return centred_camera(size, focal) if focal is not None and is_plausible else None


def focal_by_matches(matched: Sequence[tuple[FloatArray, FloatArray]]) -> float | None:
    """Median of the focal lengths [px] of pairs of undistorted pictures by one lens (six-point solver); None if those
    of the middle half of the pairs differ by more than a factor of two, or without pairs.

    Args:
        matched: places (M, 2) of a pair's matches in either picture, relative to the principal point [px].
    """
    with ThreadPoolExecutor(_THREADS) as pool:
        found = [focal for focal, _ in pool.map(lambda pair: _shared_focal(*pair), _best_matched(matched))]
    if not found:
        return None
    low, middle, high = np.quantile(found, (0.25, 0.5, 0.75))
    return float(middle) if high <= _MAX_SPREAD * low else None


def zoom_by_matches(camera: Camera, matched: Sequence[tuple[FloatArray, FloatArray]]) -> float | None:
    """Focal length of a second lens as a multiple of the camera's, 0.4 to 2.5, by pictures that both took of a place;
    None if the pairs do not tell it from one that is 25 % longer or shorter.

    Args:
        camera: that took the first picture of each pair.
        matched: pixels (M, 2) of a pair's matches in either picture.
    """
    pairs = _best_matched(matched)[: 2 * _COMPARED_PAIRS]
    if not pairs:
        return None

    def misfit(zoom: float) -> float:
        return _epipolar_misfit(camera, replace(camera, fx=zoom * camera.fx, fy=zoom * camera.fy), pairs)

    coarse = min(_ZOOMS, key=misfit)
    found = min((coarse * fine for fine in _FINE_ZOOMS), key=misfit)
    if min(misfit(found / _ANOTHER_ZOOM), misfit(found * _ANOTHER_ZOOM)) < _TOLD * misfit(found):
        return None
    return float(found)


def _best_matched(matched: Sequence[tuple[FloatArray, FloatArray]]) -> list[tuple[FloatArray, FloatArray]]:
    """At most 40 pairs, those with most matches, at least 30 each. Of 300 or more matches, every n-th: 150 to 299."""
    best = sorted(matched, key=lambda pair: len(pair[0]), reverse=True)[:_MATCHED_PAIRS]
    steps = [max(1, len(a) // _MATCHES) for a, _ in best]
    return [(a[::step], b[::step]) for (a, b), step in zip(best, steps, strict=True) if len(a) >= 2 * _MIN_SHARED]


def _epipolar_misfit(first: Camera, second: Camera, matched: Sequence[tuple[FloatArray, FloatArray]]) -> float:
    """Mean over pairs of the truncated squared epipolar error [px²] of the best relative pose, by the cameras of their
    first and second pictures.
    """
    focal = float(np.sqrt(2 / (first.focal**-2 + second.focal**-2)))  # pixels of both pictures count alike
    options = {"max_epipolar_error": 1 / focal, "min_iterations": 50, "max_iterations": 200, "seed": 1}
    score = 0.0
    for a, b in matched:
        rays = on_plane(first.rays(a)), on_plane(second.rays(b))
        _, info = poselib.estimate_relative_pose(*rays, UNIT_CAMERA, UNIT_CAMERA, options, {})
        score += info["model_score"] * focal**2 / len(a)
    return score / len(matched)


def _shared_focal(a: FloatArray, b: FloatArray) -> tuple[float, int]:
    """Focal length [px] by the six-point solver, and its inliers, of matches (M, 2) about the principal point."""
    options = {"max_epipolar_error": _TOLERANCE_PX, "max_iterations": 200, "seed": 1}
    pair, info = poselib.estimate_shared_focal_relative_pose(a, b, np.zeros(2), options, {})
    return float(pair.camera1.focal()), int(np.sum(info["inliers"]))
