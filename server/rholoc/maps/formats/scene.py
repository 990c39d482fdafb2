"""Compact binary form of a map for a 3-D viewer."""

from __future__ import annotations

import numpy as np

from rholoc.geometry import FloatArray, IntArray
from rholoc.maps.formats.ply_and_vtp import landmark_sigmas
from rholoc.maps.map import Map


def map_to_scene(map_: Map, most_landmarks: int | None = None, rotation: FloatArray | None = None) -> bytes:
    """Landmarks and views as little-endian numbers, one array after the other.

    Two uint32, the numbers F and K; (F, 4) float32 of each landmark's x, y, z and standard deviation; (K, 7) float32 of
    each view's x, y, z, heading and the number of the recording that it comes from; where the map knows the colours of
    its landmarks, (F, 3) uint8, red, green and blue. Lengths in metres. If there are more than ``most_landmarks``, that
    many are chosen evenly. ``rotation`` (3, 3) rotates everything.
    """
    views = len(map_.views)
    sources = np.zeros(views) if map_.views.sources is None else map_.views.sources
    R = np.eye(3) if rotation is None else rotation
    landmarks = np.column_stack([map_.landmarks.positions @ R.T, landmark_sigmas(map_)])
    path = np.column_stack([map_.views.positions @ R.T, map_.views.headings @ R.T, sources])
    chosen = evenly(len(landmarks), most_landmarks)
    counts = np.array([len(chosen), views])
    arrays = [counts.astype("<u4"), landmarks[chosen].astype("<f4"), path.astype("<f4")]
    if map_.landmarks.colours is not None:
        arrays.append(map_.landmarks.colours[chosen])
    return b"".join(array.tobytes() for array in arrays)


def cloud_to_bytes(map_: Map) -> bytes:
    """The further points of a map as little-endian numbers: one uint32, the number P; (P, 3) float32 of their x, y, z;
    (P, 3) uint8, red, green and blue. Lengths in metres."""
    cloud = map_.cloud
    count = np.array([len(cloud)], dtype="<u4")
    return count.tobytes() + cloud.positions.astype("<f4").tobytes() + cloud.colours.tobytes()


def evenly(count: int, most: int | None) -> IntArray:
    """The indices of at most ``most`` of ``count``, evenly chosen; all of them if ``most`` is None."""
    if most is None or count <= most:
        return np.arange(count)
    return np.arange(most) * count // most
