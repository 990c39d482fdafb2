"""Choose the reconstruction method by the available measurements. Runs in a child process."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from rholoc.errors import MappingFailed
from rholoc.progress import ProgressListener, silent
from rholoc.recordings import Imu, Waypoint
from rholoc.trajectory.checks.agreement import Agreement, compare
from rholoc.trajectory.inertial.gyroscope import camera_rotations
from rholoc.trajectory.optimization.rounds import AdjustmentProgress
from rholoc.trajectory.reconstruction.from_imu import calibrated, solve_with_imu, start_with_imu
from rholoc.trajectory.reconstruction.from_pictures import solve_from_pictures, solve_from_set
from rholoc.trajectory.reconstruction.outcome import WELL_PLACED, Reconstruction
from rholoc.trajectory.reconstruction.part import Pictured
from rholoc.trajectory.reconstruction.sights import ADVICE, Evidence, Sights, gather_evidence
from rholoc.trajectory.visual.focal_guess import camera_by_matches, guess_camera, zoom_by_matches
from rholoc.trajectory.visual.matching import with_poses_anew
from rholoc.trajectory.visual.tracks import followed_corners
from rholoc.trajectory.visual.unzooming import unzoomed_features

_SAME_VIEW = (
    "Pictures of several sizes came without focal lengths, and were assumed to show the same angle of view: "
    "keep the EXIF data of the originals, or map each camera's pictures alone."
)
_AS_SET = "What was followed from frame to frame left it open; the keyframes were matched as a set of pictures."


def reconstruct(
    sights: Sights,
    imu: Imu | None,
    waypoints: Sequence[tuple[Waypoint, ...]],
    progress: ProgressListener = silent,
) -> Reconstruction:
    """Reconstruct keyframe poses from all measurements.

    Args:
        sights: sightings of the keyframes.
        imu: None if there is none or it is not to be used.
        waypoints: assignments of times to the waypoints; a single one if times are known. Empty without waypoints.
        progress: listener for :data:`Stage.POSES`.

    Raises:
        MappingFailed: no pictures overlap enough, the camera only turned, or the waypoints contradict the pictures.
    """
    with threadpool_limits(1, "blas"):  # small matrices: more threads cost more than they save
        return _reconstruct(sights, imu, waypoints, progress)


def _reconstruct(
    sights: Sights, imu: Imu | None, waypoints: Sequence[tuple[Waypoint, ...]], progress: ProgressListener
) -> Reconstruction:
    camera = sights.camera or guess_camera(sights.flow, imu, sights.focal_px, sights.is_film)
    gyro, reason = (None, "") if imu is None else calibrated(sights, camera, imu)
    evidence: Evidence | None = None
    if imu is not None and gyro is None and not sights.is_film:
        evidence = gather_evidence(sights, camera, None, progress)
        gyro, reason = calibrated(sights, camera, imu, evidence)
    by_gyroscope = None if imu is None or gyro is None else camera_rotations(imu, gyro, sights.times)
    if evidence is None or by_gyroscope is not None:
        evidence = gather_evidence(sights, camera, by_gyroscope, progress)
    steps = AdjustmentProgress(progress)
    if imu is not None and gyro is not None and by_gyroscope is not None:
        start = start_with_imu(sights, camera, evidence, imu, gyro, by_gyroscope)
        if start is not None:
            return _judged(sights, solve_with_imu(sights, imu, gyro, evidence, start, waypoints, steps))
        reason = "The pictures do not show enough of the walk for the accelerometer to measure it."
    if sights.is_film:
        return _judged(sights, _from_film(Pictured(sights, camera, evidence, waypoints, reason), steps))
    if by_gyroscope is not None:  # pairs that a wrong gyroscope contradicts were left out
        evidence = gather_evidence(sights, camera, None, progress)
    walk = _with_camera_by_matches(Pictured(sights, camera, evidence, waypoints, reason))
    walk = _with_lenses_by_matches(walk, progress)
    return _judged(walk.sights, solve_from_set(walk, steps))


def _judged(sights: Sights, found: Reconstruction) -> Reconstruction:
    """The reconstruction with a doubt, if several lenses took the pictures and their focal lengths are unknown."""
    if sights.lenses is None:
        return found
    return replace(found, frame=replace(found.frame, doubts=(_SAME_VIEW, *found.frame.doubts)))


def _with_camera_by_matches(walk: Pictured) -> Pictured:
    """The set of pictures with a camera estimated from its matches; of lens 0 if several lenses took it.

    Unchanged if the camera is known, EXIF states the focal length, or the pairs of pictures disagree on it.
    """
    sights = walk.sights
    if sights.camera is not None or sights.focal_px is not None:
        return walk
    camera = camera_by_matches(walk.matched(0, 0), sights.flow.size)
    if camera is None:
        return walk
    evidence, rays = walk.evidence, [camera.rays(found.pixels.astype(np.float64)) for found in sights.features]
    sequential, weak = (with_poses_anew(some, rays, camera.focal) for some in (evidence.sequential, evidence.weak))
    return replace(walk, camera=camera, evidence=replace(evidence, sequential=sequential, weak=weak))


def _with_lenses_by_matches(walk: Pictured, progress: ProgressListener) -> Pictured:
    """The set of pictures with those of other lenses converted to lens 0, and matched again.

    A lens's zoom relative to lens 0 is estimated from pairs of pictures by both. Lenses without a clear estimate stay.
    """
    sights = walk.sights
    if sights.lenses is None:
        return walk
    lenses, zooms = sights.lenses.copy(), np.ones(len(sights.rows))
    for lens in np.setdiff1d(sights.lenses, [0]).tolist():
        zoom = zoom_by_matches(walk.camera, walk.matched(0, lens))
        if zoom is not None:
            zooms[sights.lenses == lens], lenses[sights.lenses == lens] = zoom, 0
    if (lenses == sights.lenses).all():
        return walk
    features = [unzoomed_features(one, zoom, walk.camera) for one, zoom in zip(sights.features, zooms, strict=True)]
    sights = replace(sights, features=features, lenses=lenses if lenses.any() else None, zooms=zooms)
    return replace(walk, sights=sights, evidence=gather_evidence(sights, walk.camera, None, progress))


def _from_film(walk: Pictured, steps: AdjustmentProgress) -> Reconstruction:
    """Reconstruct a film from tracked corners. If that leaves out more than 10 %, contradicts itself or fails, also
    as a set of pictures. Returns the reconstruction that places more keyframes; that of the set if the first one
    contradicts itself. Raises MappingFailed if neither works.
    """
    found: Reconstruction | None = None
    failure = MappingFailed("No two pictures overlap enough.", ADVICE)
    try:
        found = solve_from_pictures(walk, steps)
        steps.step(0.95, 0.99, "checked by a second reconstruction")
        found = replace(found, agreement=_agreement(found, walk.sights))
    except MappingFailed as error:
        failure = error
    contradicted = found is not None and found.agreement is not None and found.agreement.contradicts
    if found is not None and not contradicted and found.placed.mean() >= WELL_PLACED:
        return found
    as_set = replace(walk.sights, is_film=False)
    try:
        evidence = gather_evidence(as_set, walk.camera, None, silent)
        corners, turned = followed_corners(as_set.flow, as_set.rows, walk.camera, None, as_set.shutter)
        evidence = replace(evidence, corners=corners, turned=turned)
        other = solve_from_set(replace(walk, sights=as_set, evidence=evidence), steps)
    except MappingFailed as error:
        if found is None or contradicted:
            raise (failure if found is None else error) from None
        return found
    better = found is None or contradicted or other.placed.sum() > found.placed.sum()
    return replace(other, note=f"{_AS_SET} {other.note}".strip()) if better or found is None else found


def _agreement(found: Reconstruction, sights: Sights) -> Agreement:
    """Compare a reconstruction from pictures with another from every second keyframe; NaN if that one fails."""
    some = np.arange(0, len(sights.rows), 2)
    half = sights.take(some)
    try:
        evidence = gather_evidence(half, found.camera, None, silent)
        other = solve_from_pictures(Pictured(half, found.camera, evidence), AdjustmentProgress(silent))
    except MappingFailed:
        return Agreement(np.nan, np.nan, np.nan, 0, len(some))
    return compare(found.T_map_camera, found.placed, some, other.T_map_camera, other.placed, found.median_depth)
