"""The observations that a map remembers: as rays, and the landmarks triangulated from them."""

import contextlib
import hashlib
from dataclasses import dataclass, replace

import numpy as np

from rholoc.density.ray import landmarks_from_information
from rholoc.errors import InvalidRecording
from rholoc.geometry import BoolArray, FloatArray, IntArray
from rholoc.mapping.build.landmarks import enough_observations, estimate_information
from rholoc.maps import Map, check_memory, source_cameras, validate_map
from rholoc.recordings import Recording


@dataclass(frozen=True, eq=False)
class ObservedRays:
    """V observations of a map's features as rays, in the map's order.

    Attributes:
        features: (V,) rows of the map's features.
        views: (V,) rows of its views.
        pixels: (V, 2) u and v.
        bearings: (V, 3) unit vectors in the map frame.
        positions: (V, 3) of the camera [m].
        focal_px: (V,) focal length of the camera.
        ranges_m: (V,) measured distances from the camera, NaN where unknown.
    """

    features: IntArray
    views: IntArray
    pixels: FloatArray
    bearings: FloatArray
    positions: FloatArray
    focal_px: FloatArray
    ranges_m: FloatArray


def recording_id(recording: Recording) -> str:
    """Identifier of a recording, independent of its name: 16 hex digits of a hash of its times and, if it decodes, its
    first frame.
    """
    digest = hashlib.blake2b(recording.frames.times.tobytes(), digest_size=8)
    with contextlib.suppress(InvalidRecording):  # a damaged frame is no matter as long as nobody needs it
        digest.update(next(iter(recording.frames.images([0]))).tobytes())
    return digest.hexdigest()


def observed_rays(map_: Map) -> ObservedRays:
    """All observations that a map remembers.

    Raises:
        InvalidInput: it remembers none.
        InvalidMap: they are inconsistent with the rest of the map.
    """
    kept = check_memory(map_, "The map")
    views = map_.observations.views
    sources = kept.view_sources[views]
    rays, focal_px = np.zeros((len(views), 3)), np.zeros(len(views))
    for source, camera in enumerate(source_cameras(map_.info)):
        mine = np.flatnonzero(sources == source)
        rays[mine] = camera.rays(kept.pixels[mine])
        focal_px[mine] = camera.focal
    bearings = np.einsum("vij,vj->vi", map_.views.T_map_camera[views, :3, :3], rays)
    features = map_.observations.features.astype(np.int64)
    ranges_m = map_.observations.known("ranges_m").astype(np.float64)
    return ObservedRays(features, views, kept.pixels, bearings, map_.views.positions[views], focal_px, ranges_m)


def solve_landmarks(
    observations: ObservedRays, count: int, wanted: BoolArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Triangulate the landmarks ``wanted`` (F,) out of F = ``count`` features.

    Each landmark depends on its own observations alone, independent of their order and time.

    Returns:
        Positions (F, 3), covariances (F, 3, 3) and whether each is determined (F,). NaN and False if not wanted.
    """
    rows = np.flatnonzero(wanted[observations.features])
    number = np.cumsum(wanted) - 1
    tracks = number[observations.features[rows]]
    information, eta, kept = estimate_information(
        tracks,
        int(wanted.sum()),
        observations.bearings[rows],
        observations.positions[rows],
        observations.focal_px[rows],
        observations.ranges_m[rows],
    )
    solved, spread = landmarks_from_information(information, eta)
    enough = enough_observations(tracks[kept], observations.ranges_m[rows][kept], len(solved))
    positions, covariances = np.full((count, 3), np.nan), np.full((count, 3, 3), np.nan)
    determined = np.zeros(count, dtype=bool)
    positions[wanted], covariances[wanted] = solved, spread
    determined[wanted] = enough & np.isfinite(solved).all(axis=1)
    return positions, covariances, determined


def with_landmarks(map_: Map, wanted: BoolArray | None = None) -> Map:
    """The map with its landmarks triangulated again: those ``wanted`` (F,), by default all.

    Landmarks whose position is not determined are dropped, together with their features.

    Raises:
        InvalidInput: the map does not remember its observations.
        InvalidMap: the result is inconsistent.
    """
    wanted = np.ones(len(map_), dtype=bool) if wanted is None else wanted
    positions, covariances, determined = solve_landmarks(observed_rays(map_), len(map_), wanted)
    solved = wanted & determined
    places, spread = map_.landmarks.positions.copy(), map_.landmarks.covariances.copy()
    places[solved], spread[solved] = positions[solved], covariances[solved]
    landmarks = replace(map_.landmarks, positions=places, covariances=spread)
    map_ = keep_features(replace(map_, landmarks=landmarks), solved | ~wanted)
    validate_map(map_)
    return map_


def keep_features(map_: Map, kept: BoolArray) -> Map:
    """The map with only the features where ``kept`` (F,) is true, renumbered. Valid for maps in ``ray`` form, whose
    densities need no change.
    """
    if kept.all():
        return map_
    number = (np.cumsum(kept) - 1).astype(np.int32)
    descriptors = map_.descriptors.take(kept[map_.descriptors.features])
    observations = map_.observations.take(kept[map_.observations.features])
    return replace(
        map_,
        landmarks=map_.landmarks.take(kept),
        descriptors=replace(descriptors, features=number[descriptors.features]),
        observations=replace(observations, features=number[observations.features]),
    )


def keep_view_rows(map_: Map, kept: BoolArray) -> Map:
    """The map with only the views where ``kept`` (K,) is true and their observations; all features stay."""
    number = (np.cumsum(kept) - 1).astype(np.int32)
    observations = map_.observations.take(kept[map_.observations.views])
    return replace(
        map_, views=map_.views.take(kept), observations=replace(observations, views=number[observations.views])
    )
