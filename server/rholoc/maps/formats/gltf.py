"""A map as glTF 2.0, in one binary file: for viewers on the web, Blender, Unity, Unreal.

glTF's y axis points up; the root node rotates the map, so that the numbers stay the map's own.
"""

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rholoc.maps.info import MapWaypoint
from rholoc.maps.map import Map
from rholoc.maps.place_names import NamedPoint

_MAGIC, _VERSION = 0x46546C67, 2
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942
_FLOAT, _UNSIGNED_BYTE = 5126, 5121
_ARRAY_BUFFER = 34962
_POINTS, _LINE_STRIP = 0, 3
_Z_UP_TO_Y_UP = [-0.7071067811865476, 0.0, 0.0, 0.7071067811865476]  # quaternion x, y, z, w


def map_to_gltf(map_: Map) -> bytes:
    """A map as GLB: landmarks as points, in the colours of the pictures where the map knows them; the further points of
    its cloud as another mesh; the path of each recording as a line; named points and waypoints as empty nodes. Metres.
    """
    file = _File()
    children: list[int] = []
    if len(map_):
        attributes = {"POSITION": file.positions(map_.landmarks.positions)}
        if map_.landmarks.colours is not None:
            attributes["COLOR_0"] = file.colours(map_.landmarks.colours)
        children.append(file.mesh("landmarks", attributes, _POINTS))
    if len(map_.cloud):
        attributes = {"POSITION": file.positions(map_.cloud.positions), "COLOR_0": file.colours(map_.cloud.colours)}
        children.append(file.mesh("further points", attributes, _POINTS))
    for source, rows in _walks(map_):
        if len(rows) > 1:
            children.append(file.mesh(source, {"POSITION": file.positions(map_.views.positions[rows])}, _LINE_STRIP))
    marks: list[NamedPoint | MapWaypoint] = [*map_.info.names.points, *map_.info.waypoints]
    for one in marks:
        children.append(file.node({"name": one.name, "translation": list(one.position)}))
    root = file.node({"name": "map", "rotation": _Z_UP_TO_Y_UP, **({"children": children} if children else {})})
    extras = {"map_id": map_.info.id, "map_version": map_.info.version, "metric": map_.info.metric}
    return file.glb(root, extras)


def _walks(map_: Map) -> list[tuple[str, NDArray[Any]]]:
    """Each walk's rows of views, with the name of the recording that it comes from."""
    sources = map_.views.known_sources
    names = [source.name for source in map_.info.sources] or ["walk"]
    return [(names[sources[rows[0]]], rows) for rows in map_.views.by_walk]


class _File:
    """A glTF file being written."""

    def __init__(self) -> None:
        self._binary = bytearray()
        self._lists: dict[str, list[dict[str, Any]]] = {
            name: [] for name in ("nodes", "meshes", "accessors", "bufferViews")
        }

    def positions(self, points: NDArray[Any]) -> int:
        """Add points (N, 3), N > 0, and return the number of their accessor."""
        stored = points.astype("<f4")
        bounds = {"min": stored.min(axis=0).tolist(), "max": stored.max(axis=0).tolist()}
        return self._accessor(stored.tobytes(), len(points), _FLOAT, "VEC3", bounds)

    def colours(self, colours: NDArray[Any]) -> int:
        """Add colours (N, 3) uint8, with alpha 255, for rows of four bytes; returns their accessor's number."""
        rows = np.column_stack([colours, np.full(len(colours), 255, dtype=np.uint8)])
        return self._accessor(
            rows.astype(np.uint8).tobytes(), len(colours), _UNSIGNED_BYTE, "VEC4", {"normalized": True}
        )

    def mesh(self, name: str, attributes: dict[str, int], mode: int) -> int:
        """Add a mesh and a node that shows it; return the node's number. ``attributes`` name accessors; ``mode`` is
        glTF's code of points or of a line strip.
        """
        mesh = self._add("meshes", {"name": name, "primitives": [{"attributes": attributes, "mode": mode}]})
        return self.node({"name": name, "mesh": mesh})

    def node(self, members: dict[str, Any]) -> int:
        """Add a node with these members and return its number."""
        return self._add("nodes", members)

    def glb(self, root: int, extras: dict[str, Any]) -> bytes:
        """Content of the file, whose scene has the node ``root``; ``extras`` go into its asset."""
        whole: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "rholoc", "extras": extras},
            "scene": 0,
            "scenes": [{"nodes": [root]}],
            **{name: found for name, found in self._lists.items() if found},
        }
        if self._binary:
            whole["buffers"] = [{"byteLength": len(self._binary)}]
        chunks = _chunk(_JSON_CHUNK, json.dumps(whole, separators=(",", ":")).encode(), b" ")
        if self._binary:
            chunks += _chunk(_BINARY_CHUNK, bytes(self._binary), b"\0")
        return struct.pack("<3I", _MAGIC, _VERSION, 12 + len(chunks)) + chunks

    def _accessor(self, data: bytes, count: int, component: int, kind: str, more: dict[str, Any]) -> int:
        """Append ``data``, ``count`` items, and return their accessor's number. ``component`` and ``kind`` are glTF's
        componentType and type; ``more`` has further members of the accessor.
        """
        view = {"buffer": 0, "byteOffset": len(self._binary), "byteLength": len(data), "target": _ARRAY_BUFFER}
        self._binary += data
        number = self._add("bufferViews", view)
        return self._add(
            "accessors", {"bufferView": number, "componentType": component, "count": count, "type": kind, **more}
        )

    def _add(self, name: str, members: dict[str, Any]) -> int:
        """Append an object to the glTF list ``name`` and return its number there."""
        self._lists[name].append(members)
        return len(self._lists[name]) - 1


def _chunk(kind: int, data: bytes, padding: bytes) -> bytes:
    """Chunk of a GLB file: length, type and data, padded to a multiple of four bytes."""
    data += padding * (-len(data) % 4)
    return struct.pack("<2I", len(data), kind) + data
