"""Compact binary form of a map for a 3-D viewer."""

import numpy as np

from rholoc.geometry import FloatArray, IntArray
from rholoc.maps.formats.ply_and_vtp import landmark_sigmas
from rholoc.maps.map import Map


def map_to_scene(map_: Map, most_landmarks: int | None = None, rotation: FloatArray | None = None) -> bytes:
    """Landmarks and views as little-endian numbers, one array after the other.

    Two uint32, the numbers F and K; (F, 4) float32 of each landmark's x, y, z and standard deviation; (K, 7) float32 of
    each view's x, y, z, heading and the number of its walk, as in :attr:`MapViews.walks`; where the map knows the
    colours of its landmarks or positions of a second reconstruction, (F, 3) uint8, red, green and blue; where it knows
    these positions, (K, 3) float32 of them, NaN for views without one. Lengths in metres. If there are more than
    ``most_landmarks``, that many are chosen evenly. ``rotation`` (3, 3) rotates everything.
    """
    views = len(map_.views)
    R = np.eye(3) if rotation is None else rotation
    landmarks = np.column_stack([map_.landmarks.positions @ R.T, landmark_sigmas(map_)])
    path = np.column_stack([map_.views.positions @ R.T, map_.views.headings @ R.T, map_.views.walks])
    chosen = evenly(len(landmarks), most_landmarks)
    counts = np.array([len(chosen), views])
    arrays = [counts.astype("<u4"), landmarks[chosen].astype("<f4"), path.astype("<f4")]
    second_positions = map_.views.second_positions
    if map_.landmarks.colours is not None or second_positions is not None:
        arrays.append(map_.landmarks.known_colours[chosen])
    if second_positions is not None:
        arrays.append((second_positions @ R.T).astype("<f4"))
    return b"".join(array.tobytes() for array in arrays)


def cloud_to_bytes(map_: Map) -> bytes:
    """The further points of a map as little-endian numbers: one uint32, the number P; (P, 3) float32 of their x, y, z;
    (P, 3) uint8, red, green and blue. Lengths in metres."""
    cloud = map_.cloud
    count = np.array([len(cloud)], dtype="<u4")
    return count.tobytes() + cloud.positions.astype("<f4").tobytes() + cloud.colours.tobytes()


def room_to_bytes(map_: Map, rotation: FloatArray | None = None) -> bytes:
    """The surfaces of a map's room as little-endian numbers: two uint32, the numbers V and Q; (V, 3) float32 of the
    vertices' x, y, z; (Q, 4) uint32, the vertices of each quadrilateral, counter-clockwise as seen from the free side;
    (V, 3) uint8, red, green and blue. Lengths in metres. ``rotation`` (3, 3) rotates everything."""
    vertices, faces = map_.room.vertices, map_.room.faces
    counts = np.array([len(vertices), len(faces)], dtype="<u4")
    R = np.eye(3) if rotation is None else rotation
    arrays = (counts, (vertices.positions @ R.T).astype("<f4"), faces.astype("<u4"), vertices.colours)
    return b"".join(array.tobytes() for array in arrays)


def evenly(count: int, most: int | None) -> IntArray:
    """The indices of at most ``most`` of ``count``, evenly chosen; all of them if ``most`` is None."""
    if most is None or count <= most:
        return np.arange(count)
    return np.arange(most) * count // most
