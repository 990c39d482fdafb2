"""The link between two maps: their relative pose, from the maps themselves."""

import numpy as np

from rholoc.errors import InvalidInput, MappingFailed
from rholoc.geometry import FloatArray, evenly, kabsch, pose_matrix
from rholoc.localization import Localizer
from rholoc.mapping.build.density_fitting import ray_form
from rholoc.mapping.learn.merging import check_alike, remembered_frames
from rholoc.mapping.learn.registration import LEARNING_RECOGNIZED, align_to_found, find_frames
from rholoc.maps import FramePose, LinkOrigin, Map, SiteLink
from rholoc.progress import ProgressListener, silent

_MIN_SIGMA_M, _MIN_SIGMA_DEG = 0.02, 0.3  # of a link that was found: the maps themselves are no better
_MIN_SHARED = 3
_MIN_SPREAD_M = 0.3  # of shared points across their main direction, below which they leave a rotation open
_MAX_OFF_M = 0.3  # of a shared point
_MAX_LOCALIZED = 60


def find_link(first: str, a: Map, second: str, b: Map, progress: ProgressListener = silent) -> SiteLink:
    """The pose between two maps: by measured points of the same names, else by views of ``b`` localized in ``a``.

    Raises:
        InvalidInput: a map has no metric scale; or they share no three points, and their features or densities differ.
        MappingFailed: they do not overlap, or disagree; says by how much.
        Cancelled: ``progress`` asked to stop.
    """
    for name, map_ in ((first, a), (second, b)):
        if not map_.info.metric:
            raise InvalidInput(
                f"The map {name} has no metric scale.", "Map it with an IMU or waypoints, or correct its scale."
            )
    by_points = _link_by_points(first, a, second, b)
    return by_points or _link_by_overlap(first, a, second, b, progress)


def _link_by_points(first: str, a: Map, second: str, b: Map) -> SiteLink | None:
    """Link by waypoints and named points with the same names in both maps.

    None for fewer than three points, or if they are collinear: the second singular value of their centred positions is
    below 0.3 m. Raises MappingFailed if a point's residual exceeds 0.3 m.
    """
    of_a, of_b = _points(a), _points(b)
    shared = sorted(of_a.keys() & of_b.keys())
    if len(shared) < _MIN_SHARED:
        return None
    there, here = np.array([of_a[name] for name in shared]), np.array([of_b[name] for name in shared])
    if np.linalg.svd(here - here.mean(axis=0), compute_uv=False)[1] < _MIN_SPREAD_M:
        return None
    similarity = kabsch(here, there)
    off_m = np.linalg.norm(similarity.points(here) - there, axis=1)
    if off_m.max() > _MAX_OFF_M:
        name = shared[int(off_m.argmax())]
        raise MappingFailed(
            f"The points that {first} and {second} share disagree: {name} by {off_m.max():.2f} m.",
            "Correct the point's name or position in one of the maps.",
        )
    rms_m = float(np.sqrt(np.mean(off_m**2)))
    reach_m = float(np.sqrt(np.mean(np.sum((here - here.mean(axis=0)) ** 2, axis=1))))
    sigma_m = max(rms_m, _MIN_SIGMA_M)
    sigma_deg = max(float(np.degrees(sigma_m / reach_m)), _MIN_SIGMA_DEG)
    T = pose_matrix(similarity.rotation, similarity.translation)
    return SiteLink(first, second, FramePose.of(T), sigma_m, sigma_deg, LinkOrigin.WAYPOINTS, _middle(here))


def _middle(positions: FloatArray) -> tuple[float, float, float]:
    """Mean of positions (N, 3)."""
    x, y, z = positions.mean(axis=0).tolist()
    return x, y, z


def _points(map_: Map) -> dict[str, tuple[float, float, float]]:
    """Positions [m] of named points and waypoints by name; of the same name, the waypoint's."""
    named = {point.name: point.position for point in map_.info.names.points}
    return named | {waypoint.name: waypoint.position for waypoint in map_.info.waypoints}


def _link_by_overlap(first: str, a: Map, second: str, b: Map, progress: ProgressListener) -> SiteLink:
    """Link by localizing views of ``b`` in ``a``. Raises MappingFailed and InvalidInput as :func:`find_link`."""
    check_alike(a, b)
    localizer = Localizer(ray_form(a), min_recognized=LEARNING_RECOGNIZED)
    frames = remembered_frames(b)
    tried = evenly(len(frames), _MAX_LOCALIZED)
    found = find_frames(localizer, frames, tried, f"The map {second}", progress)
    alignment = align_to_found(b.views.T_map_camera, found, True, f"The map {second}")
    similarity = alignment.similarity
    T = pose_matrix(similarity.rotation, similarity.translation)
    sigma_m = max(alignment.residual_m, _MIN_SIGMA_M)
    sigma_deg = max(float(np.degrees(alignment.residual_rad)), _MIN_SIGMA_DEG)
    at = _middle(b.views.positions[found.rows])
    return SiteLink(first, second, FramePose.of(T), sigma_m, sigma_deg, LinkOrigin.OVERLAP, at)
