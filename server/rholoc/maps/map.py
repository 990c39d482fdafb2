"""The map: features with what their densities are made of, and the views they were seen from."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from rholoc.geometry import ByteArray, Camera, FloatArray, IntArray


class DensityKind(StrEnum):
    """The form of equation (3) that a map's densities take."""

    RAY = "ray"  # in s = (bearing, position): exact, from information sums
    TENSOR = "tensor"  # in s = (u, v, position, heading): the paper's own, fitted


@dataclass(frozen=True)
class MapInfo:
    """What a map says of itself.

    Attributes:
        id: unique for each built map, 32 hex digits.
        version: 1 for a new map, counted up with every update.
        density: the form of its densities.
        features: the extractor's name.
        metric: False where the unit of length is arbitrary; every answer then says so.
        upright: whether z points up.
        created: ISO 8601 time, UTC.
        camera: the intrinsics of the first recording.
        sources: a dict per recording: name, frames, pose method, density of keyframes …
        waypoints: measured points: name, position, residual_m.
        report: what the map found out about itself while it was built (JSON).
    """

    id: str
    version: int
    density: DensityKind
    features: str
    metric: bool
    upright: bool
    created: str
    camera: Camera
    sources: tuple[dict[str, Any], ...] = ()
    waypoints: tuple[dict[str, Any], ...] = ()
    report: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Map:
    """F features seen in K views (keyframes).

    A feature's landmark is m = Λ⁻¹ η, of the information sums Λ = Σ w (I − b bᵀ) and η = Σ w (I − b bᵀ) x over its
    observations (DESIGN, section 3). A feature has one or more descriptors. Which feature was seen in which view is
    kept as a compressed sparse list: view k saw ``view_features[view_offsets[k] : view_offsets[k + 1]]``.

    Attributes:
        info: the map's description.
        channels: (F,) uint8, the channel of each feature.
        landmarks: (F, 3) float32, metres, map frame.
        covariances: (F, 6) float32, m²: xx, xy, xz, yy, yz, zz of each landmark.
        descriptors: (D, B) uint8, sorted by feature.
        descriptor_features: (D,) int32, the feature that each descriptor belongs to.
        view_times: (K,) float64, seconds.
        view_poses: (K, 7) float32, x, y, z in metres and the quaternion x, y, z, w of R_map_camera.
        view_offsets: (K + 1,) int32.
        view_features: (V,) int32.
        extras: further arrays by name that a density's form needs (``tensor``'s coefficients) or that learning
            goes on with (information sums); written and read back as they are.
    """

    info: MapInfo
    channels: ByteArray
    landmarks: FloatArray
    covariances: FloatArray
    descriptors: ByteArray
    descriptor_features: IntArray
    view_times: FloatArray
    view_poses: FloatArray
    view_offsets: IntArray
    view_features: IntArray
    extras: dict[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.landmarks)
