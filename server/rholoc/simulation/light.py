"""Lighting of a room: illuminance and luminance of every patch of every face.

Direct light from windows and lamps as area sources with shadows, the sun through the windows, one bounce by virtual
point lights (Keller 1997), and a uniform remainder for all later bounces. Colours are linear BGR; illuminance is in lux
and luminance in cd/m², per channel, scaled so that white light of 1 lux has 1 in every channel.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import cv2
import numpy as np

from rholoc.geometry import ByteArray, FloatArray
from rholoc.simulation.scene import Building, Face, Scene, Source

GAMMA = 2.2
_PATCH_M = 0.12
_BOUNCE_PATCH_M = 0.35
_VIRTUAL_LIGHTS = 64
_OFF_SURFACE_M = 0.01
_SAMPLES_PER_SIDE = 3
_DARKEST_WHITE = 0.01  # cd/m²
_SMALLEST_SOURCE_PX = 25
_DARK_ROOMS_IN_A_ROW = 3
_DARK_SHARE = 0.02  # of the brightest room's light; darker rooms are lit by their neighbours
_SPILL = 0.5  # of their light
_BRIGHT_SHARE = 0.998  # of a building's surfaces are less bright than white may be, lest walls near lamps be clipped
_SOFTENING_M2 = 0.15  # keeps a virtual light from blazing at what touches it


class Light(StrEnum):
    """The paper's three light conditions (section 6)."""

    DAYLIGHT = "daylight"  # sky and sun through the window, lamps off
    ARTIFICIAL = "artificial"  # cold white lamps at 100 %, night outside
    DIM = "dim"  # the same lamps at 50 %


@dataclass(frozen=True)
class _Conditions:
    """Strength of the light sources: luminances in cd/m², the sun's illuminance across its rays in lux."""

    lamp_luminance: float
    lamp_kelvin: float
    sky_luminance: float
    sky_kelvin: float
    sun_illuminance: float
    sun_kelvin: float


_CONDITIONS = {
    Light.DAYLIGHT: _Conditions(0.0, 5000.0, 8000.0, 7500.0, 12000.0, 5300.0),
    Light.ARTIFICIAL: _Conditions(12000.0, 5000.0, 3.0, 9000.0, 0.0, 5300.0),
    Light.DIM: _Conditions(6000.0, 5000.0, 3.0, 9000.0, 0.0, 5300.0),
}
_SUN_RAYS = np.array([0.35, -0.55, -0.75]) / np.linalg.norm([0.35, -0.55, -0.75])  # through a window in the wall y+


@dataclass(frozen=True, eq=False)
class Lighting:
    """A lit scene, as a renderer draws it.

    Attributes:
        paints: one image (H, W, 3) per face of the scene: the luminance L that leaves it as
            255 · (L / white_luminance)^(1 / 2.2), clipped.
        white_luminance: cd/m².
    """

    paints: tuple[ByteArray, ...]
    white_luminance: float


@dataclass(frozen=True, eq=False)
class _Emitters:
    """Small sources: places (S, 3), the directions they face (S, 3), intensities along them (S, 3) in cd, BGR."""

    places: FloatArray
    normals: FloatArray
    intensities: FloatArray


def white_point(kelvin: float) -> FloatArray:
    """Linear BGR (3,) of daylight of a colour temperature (CIE daylight locus, 4000–25000 K), luminance 1."""
    t = 1000.0 / kelvin
    if kelvin <= 7000:
        x = 0.244063 + 0.09911 * t + 2.9678 * t**2 - 4.6070 * t**3
    else:
        x = 0.237040 + 0.24748 * t + 1.9018 * t**2 - 2.0064 * t**3
    y = -3.0 * x * x + 2.870 * x - 0.275
    XYZ = np.array([x / y, 1.0, (1 - x - y) / y])
    to_rgb = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
    return np.asarray((to_rgb @ XYZ)[::-1])


def light_scene(scene: Scene, light: Light) -> Lighting:
    """Light a scene; deterministic. White shows four times the median illuminance; brighter is clipped."""
    illuminance = _illuminance(scene, _CONDITIONS[light])
    typical = float(np.median(np.concatenate([e.mean(axis=2).ravel() for e in illuminance])))
    return _lighting(scene.faces, illuminance, 4.0 * typical, _CONDITIONS[light])


def light_building(building: Building, light: Light) -> Lighting:
    """Light every room by its own windows and lamps, and a room without any by the light from its neighbours.

    Deterministic. Light that falls through an open door into a room with its own is left out.
    """
    conditions = _CONDITIONS[light]
    by_room = [_illuminance(room, conditions) for room in building.rooms]
    for _ in range(_DARK_ROOMS_IN_A_ROW):
        means = [float(np.mean([patch.mean() for patch in room])) for room in by_room]
        brightest = max(means)
        for room, portals in enumerate(building.portals):
            if means[room] < _DARK_SHARE * brightest and portals:
                spill = _SPILL * float(np.mean([means[portal.into] for portal in portals]))
                by_room[room] = [patch + np.float32(spill) for patch in by_room[room]]
    illuminance = [patch for room in by_room for patch in room]
    bright = float(np.quantile(np.concatenate([e.max(axis=2).ravel() for e in illuminance]), _BRIGHT_SHARE))
    return _lighting(building.faces, illuminance, bright, conditions)


def _lighting(faces: list[Face], illuminance: list[FloatArray], brightest: float, conditions: _Conditions) -> Lighting:
    """Faces under their illuminances (rows, columns, 3) [lux]; white lit brighter than ``brightest`` is clipped."""
    white = max(brightest / math.pi, _DARKEST_WHITE)
    glows = {
        Source.LAMP: conditions.lamp_luminance * white_point(conditions.lamp_kelvin),
        Source.WINDOW: conditions.sky_luminance * white_point(conditions.sky_kelvin),
    }
    return Lighting(tuple(_lit(f, e, glows, white) for f, e in zip(faces, illuminance, strict=True)), white)


def _illuminance(scene: Scene, conditions: _Conditions) -> list[FloatArray]:
    """Illuminance of each face (rows, columns, 3) [lux]."""
    faces = scene.faces
    fine = [_patches(face, _PATCH_M) for face in faces]
    points = np.concatenate([p.reshape(-1, 3) for p in fine])
    normals = np.concatenate([np.broadcast_to(f.normal, (p.size // 3, 3)) for f, p in zip(faces, fine, strict=True)])
    direct = _gather(scene, points, normals, _sources(faces, conditions))
    direct += _sunlight(scene, faces, points, normals, conditions)

    albedo = [
        _linear(cv2.resize(f.paint.albedo, p.shape[1::-1], interpolation=cv2.INTER_AREA))
        for f, p in zip(faces, fine, strict=True)
    ]
    areas = np.concatenate(
        [np.full(p.size // 3, f.width_m * f.height_m * 3 / p.size) for f, p in zip(faces, fine, strict=True)]
    )
    reflected = direct * np.concatenate([a.reshape(-1, 3) for a in albedo]) * areas[:, None]  # lumen
    virtual = _virtual_lights(points, normals, reflected)
    coarse = [_patches(face, _BOUNCE_PATCH_M) for face in faces]
    bounced = _gather(
        scene,
        np.concatenate([p.reshape(-1, 3) for p in coarse]),
        np.concatenate([np.broadcast_to(f.normal, (p.size // 3, 3)) for f, p in zip(faces, coarse, strict=True)]),
        virtual,
        _SOFTENING_M2,
    )
    reflectance = float(reflected.sum() / max(float((direct * areas[:, None]).sum()), 1e-9))
    remainder = bounced.mean(axis=0) * reflectance / (1 - reflectance)

    illuminance = []
    direct_parts = np.split(direct, np.cumsum([p.size // 3 for p in fine])[:-1])
    bounced_parts = np.split(bounced, np.cumsum([p.size // 3 for p in coarse])[:-1])
    for fine_patch, coarse_patch, d, b in zip(fine, coarse, direct_parts, bounced_parts, strict=True):
        shape = fine_patch.shape[:2]
        soft = cv2.resize(
            b.reshape(*coarse_patch.shape[:2], 3).astype(np.float32), shape[::-1], interpolation=cv2.INTER_LINEAR
        )
        illuminance.append(d.reshape(*shape, 3).astype(np.float32) + soft + remainder.astype(np.float32))
    return illuminance


def _patches(face: Face, spacing_m: float) -> FloatArray:
    """Patch centres (rows, columns, 3) [m] about ``spacing_m`` apart, 1 cm off the face."""
    columns, rows = max(2, round(face.width_m / spacing_m)), max(2, round(face.height_m / spacing_m))
    a, b = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    return np.asarray(face.points(a, b) + _OFF_SURFACE_M * face.normal)


def _linear(image: Any) -> FloatArray:
    """Linear values 0 to 1 of gamma-encoded bytes."""
    table = (np.arange(256) / 255.0) ** GAMMA
    return np.asarray(table.astype(np.float32)[np.asarray(image, np.uint8)])


def _rectangles(face: Face) -> list[tuple[float, float, float, float]]:
    """The glowing rectangles of a face of at least 25 px, as shares of width and height: left, top, width, height."""
    if face.paint.glow is None:
        return []
    rows, columns = face.paint.glow.shape
    stats = cv2.connectedComponentsWithStats(face.paint.glow.astype(np.uint8))[2][1:]
    stats = stats[stats[:, 4] >= _SMALLEST_SOURCE_PX, :4]
    return [(x / columns, y / rows, w / columns, h / rows) for x, y, w, h in stats]


def _sources(faces: list[Face], conditions: _Conditions) -> _Emitters:
    """Windows and lamps as grids of 3 × 3 small Lambertian sources."""
    places, normals, intensities = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros((0, 3))]
    grid = (np.arange(_SAMPLES_PER_SIDE) + 0.5) / _SAMPLES_PER_SIDE
    for face in faces:
        if face.paint.source is Source.LAMP:
            luminance = conditions.lamp_luminance * white_point(conditions.lamp_kelvin)
        else:
            luminance = conditions.sky_luminance * white_point(conditions.sky_kelvin)
        for left, top, width, height in _rectangles(face):
            a, b = np.meshgrid(left + width * grid, top + height * grid)
            area = width * face.width_m * height * face.height_m / a.size
            places.append(face.points(a.ravel(), b.ravel()) + _OFF_SURFACE_M * face.normal)
            normals.append(np.tile(face.normal, (a.size, 1)))
            intensities.append(np.tile(luminance * area, (a.size, 1)))
    return _Emitters(np.concatenate(places), np.concatenate(normals), np.concatenate(intensities))


def _gather(
    scene: Scene, points: FloatArray, normals: FloatArray, emitters: _Emitters, softening_m2: float = 0.0
) -> FloatArray:
    """Illuminance (N, 3) [lux] at points (N, 3) with normals (N, 3): Σ I cosθ cosθ' / d², where nothing stands between;
    ``softening_m2`` is added to one d².
    """
    total = np.zeros((len(points), 3))
    for place, normal, intensity in zip(emitters.places, emitters.normals, emitters.intensities, strict=True):
        ray = place - points
        squared = np.einsum("nk,nk->n", ray, ray)
        strength = np.maximum(np.einsum("nk,nk->n", ray, normals), 0) * np.maximum(-ray @ normal, 0)
        strength /= squared * (squared + softening_m2) + 1e-9
        lit = np.flatnonzero(strength > 1e-6)
        lit = lit[~scene.blocked(points[lit], place)]
        total[lit] += strength[lit, None] * intensity
    return total


def _sunlight(
    scene: Scene, faces: list[Face], points: FloatArray, normals: FloatArray, conditions: _Conditions
) -> FloatArray:
    """The sun's illuminance (N, 3) [lux] of points, normals (N, 3) that it reaches through a window's glass; else 0."""
    total = np.zeros((len(points), 3))
    if conditions.sun_illuminance == 0:
        return total
    cosine = np.maximum(-normals @ _SUN_RAYS, 0)
    for face in faces:
        if face.paint.source is not Source.WINDOW or face.paint.glow is None or _SUN_RAYS @ face.normal <= 0:
            continue
        distance = (points - face.origin) @ face.normal / (_SUN_RAYS @ face.normal)
        entry = points - distance[:, None] * _SUN_RAYS
        rows, columns = face.paint.glow.shape
        a = (entry - face.origin) @ face.right / face.width_m**2
        b = (entry - face.origin) @ face.down / face.height_m**2
        inside = (a >= 0) & (a < 1) & (b >= 0) & (b < 1) & (cosine > 0)
        lit = np.flatnonzero(inside)
        lit = lit[face.paint.glow[(b[lit] * rows).astype(int), (a[lit] * columns).astype(int)]]
        lit = lit[~scene.blocked(points[lit], entry[lit])]
        total[lit] += cosine[lit, None] * conditions.sun_illuminance * white_point(conditions.sun_kelvin)
    return total


def _virtual_lights(points: FloatArray, normals: FloatArray, flux: FloatArray) -> _Emitters:
    """64 patches drawn in proportion to the light they reflect (N, 3) [lm], together emitting all of it; none if 0."""
    power = flux.sum(axis=1)
    if power.sum() == 0:  # a room without a source stays dark
        return _Emitters(*np.zeros((3, 0, 3)))
    steps = (np.arange(_VIRTUAL_LIGHTS) + 0.5) / _VIRTUAL_LIGHTS
    chosen = np.minimum(np.searchsorted(np.cumsum(power) / power.sum(), steps), len(power) - 1)
    share = power.sum() / _VIRTUAL_LIGHTS
    tint = flux[chosen] / power[chosen, None]
    return _Emitters(points[chosen], normals[chosen], share * tint / math.pi)


def _lit(face: Face, illuminance: FloatArray, glows: dict[Source, FloatArray], white: float) -> ByteArray:
    """A face's image (H, W, 3) under its illuminance (rows, columns, 3): encoded luminance, as in :class:`Lighting`."""
    height, width = face.paint.albedo.shape[:2]
    # Encoding is a power law: the encoded product is the product of the encoded.
    shade = cv2.resize(
        (illuminance / (math.pi * white)) ** np.float32(1 / GAMMA), (width, height), interpolation=cv2.INTER_LINEAR
    )
    image = cv2.multiply(face.paint.albedo, shade.astype(np.float32), dtype=cv2.CV_8U)
    if face.paint.glow is not None and face.paint.source is not None:
        factor = (glows[face.paint.source] / white) ** (1 / GAMMA)
        shining = np.clip(face.paint.albedo[face.paint.glow] * factor, 0, 255).astype(np.uint8)
        # Glass lets the room's light out; a lamp's diffuser reflects it.
        reflected = image[face.paint.glow] if face.paint.source is Source.LAMP else np.uint8(0)
        image[face.paint.glow] = np.maximum(shining, reflected)
    return np.asarray(image)
