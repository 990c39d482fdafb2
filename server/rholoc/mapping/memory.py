"""What a map remembers: who saw which feature, from where, at which pixel; and the landmarks that follow from it.

A ``ray`` density is a sum over observations (:mod:`rholoc.density.ray`). A map keeps the observations themselves, at
four bytes each beside the list of what each view saw, so that learning goes on for as long as the map lives: another
recording adds its observations to the sums, forgetting it takes them away, and either way the landmarks are those of a
map that was never built otherwise. Keeping observations rather than sums lets the weights, which fade with an
observation's distance from its landmark, be found anew; sums of fixed weights would remember the order of learning.

``Map.extras`` holds ``observation_pixels`` (V, 2) uint16, the pixel of each entry of ``view_features``, in units of
1/65536 of the image's width and height from its top left corner; ``view_sources`` (K,) int32, the row of
``info.sources`` that each view comes from; and ``descriptor_sources`` (D,) int32.
A source has ``id``, ``name`` and ``camera``.
"""

from __future__ import annotations

import contextlib
import hashlib
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.density.ray import landmarks_from_information
from rholoc.errors import InvalidInput, InvalidMap, InvalidRecording
from rholoc.geometry import BoolArray, Camera, FloatArray, IntArray, pose_matrix
from rholoc.mapping.landmarks import estimate_information
from rholoc.maps import Map, validate_map
from rholoc.recordings import Recording

PIXELS = "observation_pixels"
VIEW_SOURCES = "view_sources"
DESCRIPTOR_SOURCES = "descriptor_sources"

_STEPS = 65536
_MIN_OBSERVATIONS = 2
_UPPER = np.triu_indices(3)


@dataclass(frozen=True, eq=False)
class Observations:
    """V observations of a map's features, in the order of ``Map.view_features``.

    Attributes:
        features: (V,) rows of the map's features.
        views: (V,) rows of its views.
        pixels: (V, 2) u and v.
        bearings: (V, 3) unit vectors in the map frame.
        positions: (V, 3) metres, where the camera was.
        focal_px: (V,) its focal length.
    """

    features: IntArray
    views: IntArray
    pixels: FloatArray
    bearings: FloatArray
    positions: FloatArray
    focal_px: FloatArray


def recording_id(recording: Recording) -> str:
    """What tells recordings apart whatever they are called: 16 hex digits, of their times and first frame."""
    digest = hashlib.blake2b(recording.frames.times.tobytes(), digest_size=8)
    with contextlib.suppress(InvalidRecording):  # a damaged frame is no matter as long as nobody needs it
        digest.update(next(iter(recording.frames.images([0]))).tobytes())
    return digest.hexdigest()


def source_camera(camera: Camera) -> dict[str, Any]:
    """A camera as a source keeps it."""
    return asdict(camera) | {"distortion": list(camera.distortion)}


def packed_pixels(pixels: FloatArray, camera: Camera) -> IntArray:
    """Pixels (N, 2) as the map keeps them, (N, 2) uint16."""
    size = np.array([camera.width, camera.height])
    steps = np.round((np.asarray(pixels, dtype=np.float64) + 0.5) / size * _STEPS)
    return np.asarray(np.clip(steps, 0, _STEPS - 1).astype(np.uint16))


def unpacked_pixels(packed: IntArray, camera: Camera) -> FloatArray:
    """What :func:`packed_pixels` packed, to 1/131072 of the image's size."""
    return np.asarray(packed / _STEPS * np.array([camera.width, camera.height]) - 0.5)


def check_memory(map_: Map, what: str) -> None:
    """Check that the map can go on learning; ``what`` names it to users.

    Raises:
        InvalidInput: it does not remember its observations.
        InvalidMap: its memory contradicts itself.
    """
    extras = map_.extras
    if any(name not in extras for name in (PIXELS, VIEW_SOURCES, DESCRIPTOR_SOURCES)):
        raise InvalidInput(
            f"{what} does not remember what it was learned from.",
            "Build it again from its recordings, with this version.",
        )
    sources = len(map_.info.sources)
    whole = (
        extras[PIXELS].shape == (len(map_.view_features), 2)
        and extras[PIXELS].dtype == np.uint16
        and extras[VIEW_SOURCES].shape == (len(map_.view_times),)
        and extras[DESCRIPTOR_SOURCES].shape == (len(map_.descriptors),)
        and all(
            bool(((row >= 0) & (row < sources)).all()) for row in (extras[VIEW_SOURCES], extras[DESCRIPTOR_SOURCES])
        )
        and all({"id", "name", "camera"} <= source.keys() for source in map_.info.sources)
    )
    if not whole:
        raise InvalidMap(f"The memory of {what} contradicts itself.", "Build it again, or take another copy.")


def view_cameras(map_: Map) -> list[Camera]:
    """The camera of each source."""
    try:
        return [
            Camera(**source["camera"] | {"distortion": tuple(source["camera"]["distortion"])})
            for source in map_.info.sources
        ]
    except (KeyError, TypeError, InvalidInput) as error:
        raise InvalidMap(f"A source of the map has a broken camera: {error}.", "Take another copy.") from error


def view_transforms(map_: Map) -> FloatArray:
    """T_map_camera (K, 4, 4) of the views."""
    poses = map_.view_poses.astype(np.float64)
    return pose_matrix(Rotation.from_quat(poses[:, 3:]).as_matrix(), poses[:, :3])


def packed_poses(T_map_camera: FloatArray) -> FloatArray:
    """Poses (K, 4, 4) as a map keeps them: (K, 7) float32."""
    quaternions = Rotation.from_matrix(T_map_camera[:, :3, :3]).as_quat()
    return np.column_stack([T_map_camera[:, :3, 3], quaternions]).astype(np.float32)


def observations_of(map_: Map) -> Observations:
    """All observations that a map remembers."""
    views = np.repeat(np.arange(len(map_.view_times)), np.diff(map_.view_offsets))
    T = view_transforms(map_)
    sources = np.asarray(map_.extras[VIEW_SOURCES])[views]
    packed = np.asarray(map_.extras[PIXELS])
    pixels, rays, focal_px = np.zeros((len(views), 2)), np.zeros((len(views), 3)), np.zeros(len(views))
    for source, camera in enumerate(view_cameras(map_)):
        mine = np.flatnonzero(sources == source)
        pixels[mine] = unpacked_pixels(packed[mine], camera)
        rays[mine] = camera.rays(pixels[mine])
        focal_px[mine] = camera.focal
    bearings = np.einsum("vij,vj->vi", T[views, :3, :3], rays)
    return Observations(map_.view_features.astype(np.int64), views, pixels, bearings, T[views, :3, 3], focal_px)


def solve_landmarks(
    observations: Observations, count: int, wanted: BoolArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Landmarks (F, 3), covariances (F, 6) and whether they are determined (F,), of ``wanted`` (F,) of F features.

    A landmark depends on its own observations alone, and on all of them alike: not on their order, nor on when they
    came. What is not wanted is NaN and undetermined.
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
    )
    solved, spread = landmarks_from_information(information, eta)
    enough = np.bincount(tracks[kept], minlength=len(solved)) >= _MIN_OBSERVATIONS
    positions, covariances = np.full((count, 3), np.nan), np.full((count, 6), np.nan)
    determined = np.zeros(count, dtype=bool)
    positions[wanted], covariances[wanted] = solved, spread[:, _UPPER[0], _UPPER[1]]
    determined[wanted] = enough & np.isfinite(solved).all(axis=1)
    return positions, covariances, determined


def with_landmarks(map_: Map, wanted: BoolArray | None = None) -> Map:
    """The map with its landmarks, or those ``wanted`` (F,), found from what it remembers.

    Features whose observations determine no landmark vanish.
    """
    wanted = np.ones(len(map_), dtype=bool) if wanted is None else wanted
    positions, covariances, determined = solve_landmarks(observations_of(map_), len(map_), wanted)
    solved = wanted & determined
    landmarks, spread = map_.landmarks.copy(), map_.covariances.copy()
    landmarks[solved], spread[solved] = positions[solved], covariances[solved]
    map_ = keep_features(replace(map_, landmarks=landmarks, covariances=spread), solved | ~wanted)
    validate_map(map_)
    return map_


def keep_features(map_: Map, kept: BoolArray) -> Map:
    """The map with only the features where ``kept`` (F,) holds, renumbered. Its tensors are not touched."""
    if kept.all():
        return map_
    number = np.cumsum(kept) - 1
    views = np.repeat(np.arange(len(map_.view_times)), np.diff(map_.view_offsets))
    seen, described = kept[map_.view_features], kept[map_.descriptor_features]
    return replace(
        map_,
        channels=map_.channels[kept],
        landmarks=map_.landmarks[kept],
        covariances=map_.covariances[kept],
        descriptors=map_.descriptors[described],
        descriptor_features=number[map_.descriptor_features[described]].astype(np.int32),
        view_offsets=np.searchsorted(views[seen], np.arange(len(map_.view_times) + 1)).astype(np.int32),
        view_features=number[map_.view_features[seen]].astype(np.int32),
        extras=map_.extras
        | {PIXELS: map_.extras[PIXELS][seen], DESCRIPTOR_SOURCES: map_.extras[DESCRIPTOR_SOURCES][described]},
    )
