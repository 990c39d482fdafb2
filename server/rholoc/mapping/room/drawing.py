"""Recordings of a map → the surfaces of its room."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rholoc.geometry import FloatArray
from rholoc.mapping.build.stored_observations import recording_id
from rholoc.mapping.edit.frame_corrections import levelled
from rholoc.mapping.room.colouring import vertex_colours
from rholoc.mapping.room.depth_views import DepthView, depth_views
from rholoc.mapping.room.fusion import fused, sampled_points, voxel_size
from rholoc.mapping.room.planes import close_gaps, floor_height, walls_of
from rholoc.mapping.room.surface import Quads, normals_of, surface_of
from rholoc.maps import Cloud, Map, Room
from rholoc.progress import ProgressListener, Stage, silent
from rholoc.recordings import Recording

MAX_VERTICES = 65_000
_PAIRS_PER_SECOND = 2.5  # of a walk: a room takes less than half its length
_FRAMES_PER_SECOND = 30.0  # of frames without times
_PAIRS = (30, 150)  # fewest and most of them
_FINEST = 1 / 85  # edge of a voxel as a share of the median depth
_SMALLEST_FITTED, _SMALLEST_DRAWN = 0.002, 0.01  # pieces, of the largest one's vertices
_OCCUPIED = 2  # voxels that hold points, per vertex: depths scatter around surfaces
_MIN_POINTS = 2000
_COARSER = 1.25


def draw_room(map_: Map, recordings: Sequence[Recording], progress: ProgressListener = silent) -> Map:
    """The map with the surfaces of its room that one of its recordings shows: the one that gives most vertices.

    Depth is measured in pairs of frames, or was recorded with them; what only one pair sees is dropped. The floor and
    up to four walls are fitted, and close gaps where pictures show no texture. A map whose recordings show too little
    (2000 points), or fewer vertices than the room that it has, stays as it is.

    Args:
        map_: the map.
        recordings: some of those that it was made from, in any order; others are ignored.
        progress: called with the share done.

    Raises:
        InvalidRecording: a frame cannot be decoded.
        Cancelled: ``progress`` asked to stop.
    """
    sources = {source.id: row for row, source in enumerate(map_.info.sources)}
    for number, recording in enumerate(recordings):
        progress(Stage.REPORT, number / len(recordings), "drawing the room")
        source = sources.get(recording_id(recording))
        room = None if source is None else _room(map_, recording, source)
        if room is not None and len(room) > len(map_.room):
            map_ = replace(map_, room=room)
    return map_


def _room(map_: Map, recording: Recording, source: int) -> Room | None:
    """Surfaces that one source's views show; None without enough depth."""
    views = depth_views(map_, recording, source, _pairs_of(recording))
    points = sampled_points(views)
    if len(points) < _MIN_POINTS:
        return None
    rotation = levelled(map_)
    R_grid_map = np.eye(3) if rotation is None else rotation
    depths = np.concatenate([view.depth[np.isfinite(view.depth)] for view in views])
    size = voxel_size(points, _FINEST * float(np.median(depths)), _OCCUPIED * MAX_VERTICES)
    mesh = _closed_mesh(views, points, size, R_grid_map)
    while len(mesh.vertices) > MAX_VERTICES:
        size *= _COARSER
        mesh = _closed_mesh(views, points, size, R_grid_map)
    if not len(mesh.faces):
        return None
    normals = normals_of(mesh.vertices, mesh.faces)
    vertices = mesh.vertices @ R_grid_map
    colours = vertex_colours(views, vertices, normals @ R_grid_map, mesh.faces)
    sources = np.full(len(vertices), source, dtype=np.int32)
    return Room(Cloud(vertices.astype(np.float32), colours, sources), mesh.faces.astype(np.int32))


def _pairs_of(recording: Recording) -> int:
    """Number of pairs of frames to measure depth in: 2.5 per second of the recording, 30 to 150."""
    times = recording.frames.times
    length_s = times[-1] - times[0] if recording.frames.timed else len(times) / _FRAMES_PER_SECOND
    return int(np.clip(_PAIRS_PER_SECOND * float(length_s), *_PAIRS))


def _closed_mesh(views: Sequence[DepthView], points: FloatArray, size: float, R_grid_map: FloatArray) -> Quads:
    """Mesh of the views' surfaces, gaps in floor and walls closed, in the grid's axes; ``points`` and ``size`` as for
    :func:`fused`. Without faces if the views show no surface.
    """
    grid = fused(views, points, size, R_grid_map)
    mesh = surface_of(grid, _SMALLEST_FITTED)
    if not len(mesh.faces):
        return mesh
    close_gaps(grid, floor_height(mesh, size), walls_of(mesh, size))
    return surface_of(grid, _SMALLEST_DRAWN)
