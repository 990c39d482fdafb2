"""Landscapes of densities: a feature's ρ over pixels, positions and headings; a frame's product around its pose.

All of it is read through :class:`rholoc.density.Densities`, as an ascent reads it, whatever the form.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rholoc.density import Evidence
from rholoc.density.presence import Presence
from rholoc.features import FeatureSet
from rholoc.geometry import BoolArray, Camera, FloatArray, Pose, pose_matrix
from rholoc.localization.pose.ascent import optimum_at
from rholoc.maps import Map
from rholoc.paper.density_localizer import Ascent, DensityLocalizer

_CERTAIN = 0.999  # the chance of a match that a feature is looked at alone for
_REACH = (0.4, 3.0)  # metres, the least and the most from a pose to the edge of its landscape
_NEAR_M = 0.5  # of a pose, within which an ascent that ends counts as leading to it
_MARGIN = 1.2  # by which it is wider than the ways of the ascents
_STEPS = 16  # from a pose to the edge
_TOLERANCE_PX = 12.0


@dataclass(frozen=True, eq=False)
class Look:
    """A feature as one camera sees it: where its density is evaluated.

    Attributes:
        feature: its number.
        camera: the intrinsics.
        T_map_camera: (4, 4).
        pixel: (2,) where it appears.
    """

    feature: int
    camera: Camera
    T_map_camera: FloatArray
    pixel: FloatArray

    @classmethod
    def of_view(cls, map_: Map, feature: int, view: int) -> Look:
        """From a view of the map, at the pixel where the landmark appears by its pose; nonsense behind the camera."""
        T = map_.views.T_map_camera[view]
        seen = (map_.landmarks.positions[feature].astype(np.float64) - T[:3, 3]) @ T[:3, :3]
        return cls(feature, map_.info.camera, T, map_.info.camera.project(seen[None])[0])


@dataclass(frozen=True, eq=False)
class Grid:
    """Positions on a grid about a point.

    Attributes:
        origin: (3,) metres, the corner with the least x, y and z.
        spacing_m: between neighbours.
        shape: how many along x, y and z.
    """

    origin: FloatArray
    spacing_m: float
    shape: tuple[int, int, int]

    @classmethod
    def about(cls, centre: FloatArray, half_m: tuple[float, float, float], spacing_m: float) -> Grid:
        """The grid that reaches ``half_m`` metres from ``centre`` (3,) along each axis, which is a point of it."""
        steps = [round(half / spacing_m) for half in half_m]
        x, y, z = (2 * count + 1 for count in steps)
        return cls(np.asarray(centre) - spacing_m * np.array(steps), spacing_m, (x, y, z))

    @classmethod
    def around_ways(cls, centre: FloatArray, ways: Sequence[FloatArray], steps: int) -> Grid:
        """A square at the height of ``centre`` (3,), 2 · ``steps`` + 1 points wide, that holds the paths ``ways``, each
        (S, 3), that end within 0.5 m of the centre.

        It reaches 0.4 to 3 m from the centre.
        """
        near = [way for way in ways if np.linalg.norm(way[-1] - centre) < _NEAR_M]
        away = max((float(np.abs(way[:, :2] - centre[:2]).max()) for way in near), default=0.0)
        half = float(np.clip(_MARGIN * away, *_REACH))
        return cls.about(centre, (half, half, 0.0), half / steps)

    @property
    def axes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The coordinates along x, y and z [m]: three arrays."""
        x, y, z = (self.origin[i] + self.spacing_m * np.arange(self.shape[i]) for i in range(3))
        return x, y, z

    @property
    def points(self) -> FloatArray:
        """Points (X · Y · Z, 3) [m], x counting fastest."""
        x, y, z = self.axes
        return np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], axis=-1).reshape(-1, 3)

    def folded(self, values: FloatArray) -> FloatArray:
        """Values (N,) of the points as an array (z, y, x)."""
        x, y, z = self.shape
        return values.reshape(z, y, x)


def over_picture(map_: Map, look: Look, tolerance_px: float, step_px: float) -> tuple[FloatArray, FloatArray]:
    """ρ (H, W) of a look's feature at pixels every ``step_px`` from its pose, and these pixels (H, W, 2)."""
    camera = look.camera
    u, v = np.meshgrid(np.arange(0, camera.width, step_px), np.arange(0, camera.height, step_px))
    pixels = np.stack([u, v], axis=-1)
    evidence = _evidence(map_, look.feature, camera.rays(pixels.reshape(-1, 2)), camera.focal)
    return _density(map_, evidence, look.T_map_camera, tolerance_px).reshape(u.shape), pixels


def over_positions(map_: Map, look: Look, grid: Grid, tolerance_px: float) -> FloatArray:
    """Density ρ (Z, Y, X) of the look's feature at the look's pixel, for cameras at the grid's points with the look's
    orientation.
    """
    evidence = _evidence(map_, look.feature, look.camera.rays(look.pixel[None]), look.camera.focal)
    R = look.T_map_camera[:3, :3]
    values = [_density(map_, evidence, pose_matrix(R, point), tolerance_px)[0] for point in grid.points]
    return grid.folded(np.array(values))


def over_headings(
    map_: Map, look: Look, half_rad: float, count: int, tolerance_px: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Density ρ (E, A) of the look's feature at the look's pixel, for cameras at the look's position with its roll, at
    ``count`` × ``count`` offsets of heading from −``half_rad`` to ``half_rad``.

    Returns:
        ρ, with the elevation's offset along the first axis; the offsets (E,) of elevation and (A,) of azimuth [rad].
    """
    evidence = _evidence(map_, look.feature, look.camera.rays(look.pixel[None]), look.camera.focal)
    pose = Pose(look.T_map_camera)
    azimuth = np.arctan2(pose.heading[1], pose.heading[0])
    elevation = np.arctan2(pose.heading[2], np.hypot(pose.heading[0], pose.heading[1]))
    offsets = np.linspace(-half_rad, half_rad, count)
    values = np.zeros((count, count))
    for i, up in enumerate(offsets):
        e = np.clip(elevation + up, -1.55, 1.55)
        for j, aside in enumerate(offsets):
            a = azimuth + aside
            heading = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
            T = Pose.from_heading(pose.position, heading, pose.roll).T_map_camera
            values[i, j] = _density(map_, evidence, T, tolerance_px)[0]
    return values, offsets, offsets


def _go_on() -> None:
    pass


def product_over_positions(
    map_: Map,
    evidence: Evidence,
    T_map_camera: FloatArray,
    grid: Grid,
    tolerance_px: float,
    check: Callable[[], None] = _go_on,
) -> FloatArray:
    """Σ log((ε + ρ) / ε) (Z, Y, X) [nats]: a frame's product (2) for cameras at a grid's points with the orientation of
    a pose (4, 4).

    ``check`` is called before each position, and may raise to stop.
    """
    R, values = T_map_camera[:3, :3], []
    for x in grid.points:
        check()
        values.append(optimum_at(map_.densities, evidence, pose_matrix(R, x), tolerance_px).value)
    return grid.folded(np.array(values))


@dataclass(frozen=True, eq=False)
class Landscape:
    """A frame's product (2) around a pose, and the ascents to it.

    Attributes:
        T_map_camera: (4, 4) the pose.
        grid: positions around it at its height, for cameras of its orientation.
        values: (Y, X) Σ log((ε + ρ) / ε) there, nats.
        tolerance_px: how far a feature may be off and still count.
        ascents: from the views with the most votes, the best last.
    """

    T_map_camera: FloatArray
    grid: Grid
    values: FloatArray
    tolerance_px: float
    ascents: tuple[Ascent, ...]


def landscape_around(
    localizer: DensityLocalizer,
    features: FeatureSet,
    camera: Camera,
    T_map_camera: FloatArray | None,
    check: Callable[[], None] = _go_on,
) -> Landscape | None:
    """Landscape around a pose (4, 4), or if that is None the best optimum; None if fewer than six features match.

    Args:
        localizer: of the map.
        features: of the frame, by the map's extractor.
        camera: its intrinsics.
        T_map_camera: the pose, or None.
        check: is called before each position, and may raise to stop.
    """
    ascents = []
    for ascent in localizer.ascents(features, camera):
        check()
        ascents.append(ascent)
    if not ascents:
        return None
    ascents.sort(key=lambda one: one.optimum.value)
    T = ascents[-1].optimum.T_map_camera if T_map_camera is None else T_map_camera
    densities = localizer.map.densities
    here = max(ascents, key=lambda one: optimum_at(densities, one.evidence, T, _TOLERANCE_PX).value)
    grid = Grid.around_ways(T[:3, 3], [ascent.positions for ascent in ascents], _STEPS)
    values = product_over_positions(localizer.map, here.evidence, T, grid, _TOLERANCE_PX, check)[0]
    return Landscape(T, grid, values, _TOLERANCE_PX, tuple(ascents))


def presence_of(map_: Map, feature: int) -> Presence:
    """Presence π of one feature, by the views of the map that saw it, of which there must be one."""
    mine = map_.observations.features == feature
    return Presence.of(
        map_.landmarks.positions[[feature]].astype(np.float64),
        map_.views.positions[map_.observations.views[mine]],
        np.zeros(int(mine.sum()), dtype=np.int64),
    )


def seen_from(map_: Map, feature: int, grid: Grid) -> BoolArray:
    """Whether a feature may be seen (its presence π) at each position of a grid (Z, Y, X)."""
    presence, landmark = presence_of(map_, feature), map_.landmarks.positions[[feature]].astype(np.float64)
    return np.asarray(grid.folded(np.array([presence.allows(landmark, point)[0] for point in grid.points])))


def _evidence(map_: Map, feature: int, rays: FloatArray, focal_px: float) -> Evidence:
    """Evidence of one feature at rays (N, 3), as matches that are certain to 0.999."""
    count = len(rays)
    return Evidence.of(
        np.full(count, feature),
        rays,
        np.tile(map_.landmarks.positions[feature].astype(np.float64), (count, 1)),
        np.tile(map_.landmarks.covariances[feature].astype(np.float64), (count, 1, 1)),
        np.full(count, _CERTAIN),
        focal_px,
    )


def _density(map_: Map, evidence: Evidence, T_map_camera: FloatArray, tolerance_px: float) -> FloatArray:
    """Density ρ (N,) of each match of ``evidence`` at a pose (4, 4)."""
    return optimum_at(map_.densities, evidence, T_map_camera, tolerance_px).density
