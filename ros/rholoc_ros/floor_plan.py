"""A map's floor plan as files for Nav2's ``map_server``: a picture and its yaml."""

from __future__ import annotations

import argparse
import math
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import httpx
import numpy as np
from numpy.typing import NDArray

ByteArray: TypeAlias = NDArray[np.uint8]
_UNKNOWN = 205  # of map_server: neither free nor occupied
_PATIENCE_S = 60.0
_MAX_PIXELS = 50_000_000


@dataclass(frozen=True)
class PlanPlace:
    """Where a plan's picture lies.

    Attributes:
        corner: x and y of its lower left corner [m], map frame.
        turn_deg: angle from the map's x axis to its lower edge.
        m_per_unit: size of a pixel [m].
    """

    corner: tuple[float, float]
    turn_deg: float
    m_per_unit: float


def occupancy(plan: ByteArray, place: PlanPlace, resolution_m: float) -> tuple[ByteArray, tuple[float, float]]:
    """A plan along the map's axes, because costmaps ignore the yaw of an origin.

    Args:
        plan: (H, W) grey, walls dark; or with 3 or 4 channels BGR[A].
        place: where it lies.
        resolution_m: size of a pixel of the result. Walls never vanish: a pixel is as dark as the darkest beneath it.

    Returns:
        Grey picture (H', W'), ``_UNKNOWN`` outside the plan, and x and y of its lower left corner [m].

    Raises:
        ValueError: the result would have too many pixels.
    """
    grey = _grey(plan)
    height, width = grey.shape
    turn = math.radians(place.turn_deg)
    R = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]]) * place.m_per_unit @ R.T + place.corner
    low, high = corners.min(axis=0), corners.max(axis=0)
    columns, rows = (max(1, math.ceil(length / resolution_m - 1e-6)) for length in high - low)
    if columns * rows > _MAX_PIXELS:
        raise ValueError(f"The plan would have {columns}×{rows} pixels: choose a larger --resolution.")
    breadth = math.ceil(resolution_m / place.m_per_unit - 1e-6)
    if breadth > 1:
        grey = np.asarray(cv2.erode(grey, np.ones((breadth, breadth), dtype=np.uint8)), dtype=np.uint8)
    # Pixel (u, v) of the result → its centre in the map → pixel of the plan.
    x, y = np.meshgrid(low[0] + (np.arange(columns) + 0.5) * resolution_m, (np.arange(rows) + 0.5) * resolution_m)
    y = low[1] + rows * resolution_m - y
    units = (np.stack([x, y], axis=-1) - place.corner) @ R / place.m_per_unit
    u, v = np.floor(units[..., 0]).astype(int), np.floor(height - units[..., 1]).astype(int)
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    found = np.full((rows, columns), _UNKNOWN, dtype=np.uint8)
    found[inside] = grey[v[inside], u[inside]]
    return found, (float(low[0]), float(low[1]))


def write_map(grey: ByteArray, corner: tuple[float, float], resolution_m: float, yaml: Path) -> None:
    """Write a picture (PGM) and its yaml for ``map_server`` beside each other."""
    picture = yaml.with_suffix(".pgm")
    picture.write_bytes(b"P5\n%d %d\n255\n" % (grey.shape[1], grey.shape[0]) + grey.tobytes())
    lines = (
        f"image: {picture.name}",
        "mode: trinary",
        f"resolution: {resolution_m}",
        f"origin: [{corner[0]}, {corner[1]}, 0.0]",
        "negate: 0",
        "occupied_thresh: 0.65",
        "free_thresh: 0.196",
    )
    yaml.write_text("\n".join(lines) + "\n", encoding="utf-8")


def fetch_plan(http: httpx.Client, map_name: str) -> tuple[ByteArray, PlanPlace]:
    """The floor plan that a map keeps, as pixels.

    Raises:
        ValueError: the map keeps none, or one without pixels.
        httpx.HTTPError: the service is out of reach, or refuses.
    """
    plan: dict[str, Any] | None = http.get(f"/v1/maps/{map_name}").raise_for_status().json()["plan"]
    if plan is None:
        raise ValueError(f"The map {map_name} has no floor plan: add one on its page, under Make it right.")
    if not plan["media_type"].startswith("image/"):
        raise ValueError("The floor plan is GeoJSON, which has no pixels: add a picture of it instead.")
    content = http.get(f"/v1/maps/{map_name}/plan").raise_for_status().content
    pixels = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise ValueError("The floor plan's picture cannot be read.")
    x, y = plan["corner"]
    return np.asarray(pixels, dtype=np.uint8), PlanPlace((x, y), plan["turn_deg"], plan["m_per_unit"])


def main(arguments: list[str] | None = None) -> None:
    """Write the yaml and picture of a map's floor plan."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("map_name", help="the map")
    parser.add_argument("yaml", type=Path, help="file to write; the picture is written beside it")
    parser.add_argument("--url", default="http://127.0.0.1:8080", help="the service")
    parser.add_argument("--resolution", type=float, default=0.05, help="size of a pixel [m]")
    options = parser.parse_args(arguments)
    key = os.environ.get("RHOLOC_API_KEY")
    headers = {} if key is None else {"Authorization": f"Bearer {key}"}
    try:
        if not 0 < options.resolution < math.inf:
            raise ValueError("--resolution must be a positive number.")
        with httpx.Client(base_url=options.url, headers=headers, timeout=_PATIENCE_S) as http:
            plan, place = fetch_plan(http, options.map_name)
        grey, corner = occupancy(plan, place, options.resolution)
        write_map(grey, corner, options.resolution, options.yaml)
    except (ValueError, OSError, httpx.HTTPError) as error:
        sys.exit(str(error))


def _grey(plan: ByteArray) -> ByteArray:
    """Grey picture (H, W); what is transparent is white."""
    if plan.ndim == 2:
        return plan
    grey = cv2.cvtColor(np.ascontiguousarray(plan[:, :, :3]), cv2.COLOR_BGR2GRAY)
    if plan.shape[2] == 4:
        alpha = plan[:, :, 3] / 255.0
        grey = np.round(grey * alpha + 255 * (1 - alpha))
    return np.asarray(grey, dtype=np.uint8)
