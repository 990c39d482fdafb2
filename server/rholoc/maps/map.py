"""The map: features with their densities, and the views they were seen from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rholoc.density import Densities, RayDensities
from rholoc.geometry import BoolArray, ByteArray, FloatArray, IntArray
from rholoc.maps.cloud import Cloud
from rholoc.maps.info import MapInfo
from rholoc.maps.observations import Observations

UNKNOWN_GREY = 128  # the red, green and blue of landmarks whose colour is not known


@dataclass(frozen=True, eq=False)
class Map:
    """F features seen in K views (keyframes), V observations in all.

    A feature's landmark is m = Λ⁻¹ η, of the information sums Λ = Σ w (I − b bᵀ) and η = Σ w (I − b bᵀ) x over its
    observations (:mod:`rholoc.density.ray`). A feature has one or more descriptors.

    Attributes:
        info: the map's description.
        channels: (F,) uint8, the channel of each feature.
        landmarks: (F, 3) float32, metres, map frame.
        covariances: (F, 3, 3) float32, m², of each landmark.
        descriptors: (D, B) uint8, sorted by feature.
        descriptor_features: (D,) int32, the feature that each descriptor belongs to.
        view_times: (K,) float64, seconds.
        T_map_camera: (K, 4, 4) float64, the poses of the views.
        observation_views: (V,) int32, the view of each observation, never decreasing.
        observation_features: (V,) int32, its feature.
        observations: what else learning needs to know about each observation; None if the map does not keep it.
        view_covariances: (K, 6, 6) float32 of the views' poses: x, y, z in metres, then a small rotation about the
            map's axes, from the left, in radians; NaN for views whose uncertainty is not known. None if no view's is.
        colours: (F, 3) uint8, red, green and blue of each landmark in the pictures; None if they are not known.
        patches: (F, 3) float32, of each landmark a vector along the orientation of the patch that its descriptors
            describe, in the map frame, as long as the patch's diameter, metres (:mod:`rholoc.geometry.patches`); NaN
            where not known. None if no landmark's is known.
        cloud: further points of the room, for people to see.
        pictures: (K,) a small JPEG of each view, empty for views without one. None if no view has one.
        plan: the file of its floor plan, empty if it has none; ``info.plan`` describes it.
        densities: of all features, in the map's form.
    """

    info: MapInfo
    channels: ByteArray
    landmarks: FloatArray
    covariances: FloatArray
    descriptors: ByteArray
    descriptor_features: IntArray
    view_times: FloatArray
    T_map_camera: FloatArray
    observation_views: IntArray
    observation_features: IntArray
    observations: Observations | None = None
    view_covariances: FloatArray | None = None
    colours: ByteArray | None = None
    patches: FloatArray | None = None
    cloud: Cloud = Cloud()  # noqa: RUF009 - it is frozen
    pictures: tuple[bytes, ...] | None = None
    plan: bytes = b""
    densities: Densities = RayDensities()  # noqa: RUF009 - it is frozen

    def __len__(self) -> int:
        return len(self.landmarks)

    @cached_property
    def view_offsets(self) -> IntArray:
        """(K + 1,) int32: the observations of view k are rows view_offsets[k] : view_offsets[k + 1]."""
        return np.searchsorted(self.observation_views, np.arange(len(self.view_times) + 1)).astype(np.int32)

    @property
    def known_view_covariances(self) -> FloatArray:
        """(K, 6, 6) as ``view_covariances``, all NaN where there are none."""
        if self.view_covariances is None:
            return np.full((len(self.view_times), 6, 6), np.nan, dtype=np.float32)
        return self.view_covariances

    @property
    def known_colours(self) -> ByteArray:
        """(F, 3) as ``colours``, all grey where there are none."""
        return np.full((len(self), 3), UNKNOWN_GREY, dtype=np.uint8) if self.colours is None else self.colours

    @property
    def known_patches(self) -> FloatArray:
        """(F, 3) as ``patches``, all NaN where there are none."""
        return np.full((len(self), 3), np.nan, dtype=np.float32) if self.patches is None else self.patches

    @property
    def known_pictures(self) -> tuple[bytes, ...]:
        """(K,) as ``pictures``, all empty where there are none."""
        return (b"",) * len(self.view_times) if self.pictures is None else self.pictures

    def pictures_of(self, kept: BoolArray) -> tuple[bytes, ...] | None:
        """The pictures of the views where ``kept`` (K,) holds; None where none are kept at all."""
        if self.pictures is None:
            return None
        return tuple(self.pictures[view] for view in np.flatnonzero(kept))

    @property
    def expected_errors_m(self) -> FloatArray:
        """(K,) how far each view is expected to be from the truth (root mean square, metres); NaN where unknown."""
        variances = np.trace(self.known_view_covariances[:, :3, :3].astype(np.float64), axis1=1, axis2=2)
        return np.asarray(np.sqrt(variances))

    @property
    def view_positions(self) -> FloatArray:
        """(K, 3) metres, where the cameras of the views were."""
        return self.T_map_camera[:, :3, 3]

    @property
    def view_headings(self) -> FloatArray:
        """(K, 3) unit vectors, their optical axes."""
        return self.T_map_camera[:, :3, 2]
