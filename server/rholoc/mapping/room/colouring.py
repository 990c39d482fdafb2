"""Colours of a mesh's vertices: means over the views that see them."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from rholoc.geometry import BoolArray, ByteArray, FloatArray, IntArray
from rholoc.mapping.room.depth_views import DepthView
from rholoc.mapping.room.surface import neighbours_of

_TOLERANCE = 0.04  # of a vertex's depth to the measured one
_UNMEASURED = 1e-3  # weight of a pixel without depth, if nothing measured around it is in front
_AROUND = 41  # pixels
_SMOOTHINGS = 20  # of the colours that have spread
_UNSEEN = 170  # grey of vertices that they do not reach


def vertex_colours(views: Sequence[DepthView], vertices: FloatArray, normals: FloatArray, faces: IntArray) -> ByteArray:
    """Red, green and blue (V, 3) uint8 of a mesh's vertices (V, 3) with unit normals (V, 3), in the map frame.

    Vertices that no view sees take their neighbours' colours along ``faces`` (Q, 4), or grey if they have none.
    """
    sums, weights = np.zeros((len(vertices), 3)), np.zeros(len(vertices))
    for view in views:
        weight, shown = _seen_by(view, vertices, normals)
        sums += weight[:, None] * shown
        weights += weight
    known = weights > 0
    colours = np.full((len(vertices), 3), float(_UNSEEN))
    colours[known] = sums[known] / weights[known][:, None]
    return np.rint(_spread(colours, known, faces)).astype(np.uint8)


def _seen_by(view: DepthView, vertices: FloatArray, normals: FloatArray) -> tuple[FloatArray, ByteArray]:
    """Weights (V,) and colours (V, 3) of vertices in a view: cosine of incidence over squared distance if the measured
    depth agrees within 4 %, a thousandth of that without any depth around, 0 where something is in front.
    """
    z, measured, shown, colours = view.look_at(vertices)
    towards = view.T_map_camera[:3, 3] - vertices
    distance = np.linalg.norm(towards, axis=1)
    facing = np.einsum("vx,vx->v", towards, normals) / np.maximum(distance, 1e-9)
    nearest = np.asarray(cv2.erode(np.nan_to_num(view.depth, nan=np.inf), np.ones((_AROUND,) * 2, np.uint8)), float)
    _, around, _, _ = replace(view, depth=nearest).look_at(vertices)
    with np.errstate(invalid="ignore"):
        matches = np.abs(measured - z) < _TOLERANCE * z
        open_view = np.isnan(measured) & (around > (1 - 2 * _TOLERANCE) * z)
    weight = np.where(matches, 1.0, np.where(open_view, _UNMEASURED, 0.0))
    weight = np.where(shown & (facing > 0.1), weight * facing / np.maximum(distance, 1e-9) ** 2, 0.0)
    return weight, colours


def _spread(colours: FloatArray, known: BoolArray, faces: IntArray) -> FloatArray:
    """Colours (V, 3), in place: unknown ones become means of their neighbours', step by step, then are smoothed."""
    neighbours = neighbours_of(faces, len(known))
    reached = known.astype(np.float64)
    while (fresh := (reached == 0) & ((count := neighbours @ reached) > 0)).any():
        colours[fresh] = (neighbours @ (colours * reached[:, None]))[fresh] / count[fresh][:, None]
        reached[fresh] = 1.0
    guessed = ~known & (reached > 0)
    for _ in range(_SMOOTHINGS):
        means = neighbours @ (colours * reached[:, None]) / np.maximum(count, 1)[:, None]
        colours[guessed] = 0.5 * (colours + means)[guessed]
    return colours
