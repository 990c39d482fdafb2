"""Landmarks' patches as map files keep them: three bytes each.

A direction is a point of the octahedron's unfolded surface (Meyer et al. 2010, "On floating-point normal vectors"), the
length is logarithmic. Directions are kept to 1° and lengths to 5 %: a detector's are ten times as far off.
"""

import numpy as np
from numpy.typing import NDArray

from rholoc.geometry import FloatArray, Similarity

_STEPS = 127  # of either coordinate, from the octahedron's centre to its edge
_STEPS_PER_OCTAVE = 8
_UNKNOWN = -128


def packed_patches(patches: FloatArray) -> NDArray[np.int8]:
    """Patches (F, 3) [m] → (F, 3) int8: a point on the octahedron and 8 log₂ length; NaN and 0 become -128."""
    vectors = patches.astype(np.float64)
    lengths = np.linalg.norm(vectors, axis=1)
    known = np.isfinite(lengths) & (lengths > 0)
    packed = np.full(patches.shape, _UNKNOWN, dtype=np.int8)
    vectors = vectors[known]
    across = vectors / np.abs(vectors).sum(axis=1, keepdims=True)
    flat = np.where(across[:, 2:] < 0, _folded(across[:, :2]), across[:, :2])
    packed[known, :2] = np.rint(flat * _STEPS)
    packed[known, 2] = np.clip(np.rint(_STEPS_PER_OCTAVE * np.log2(lengths[known])), _UNKNOWN + 1, -_UNKNOWN - 1)
    return packed


def unpacked_patches(packed: NDArray[np.int8]) -> FloatArray:
    """The patches (F, 3) float32, metres, NaN where not known, that :func:`packed_patches` packed."""
    flat, steps = packed[:, :2] / _STEPS, packed[:, 2:].astype(np.float64)
    height = 1 - np.abs(flat).sum(axis=1, keepdims=True)
    vectors = np.column_stack([np.where(height < 0, _folded(flat), flat), height])
    lengths = np.where(steps == _UNKNOWN, np.nan, np.exp2(steps / _STEPS_PER_OCTAVE))
    return np.asarray(vectors * (lengths / np.linalg.norm(vectors, axis=1, keepdims=True)), dtype=np.float32)


def storable_patches(patches: FloatArray) -> FloatArray | None:
    """Patches (F, 3) float32, rounded as map files keep them; None if none is known."""
    rounded = unpacked_patches(packed_patches(patches))
    return None if np.isnan(rounded).all() else rounded


def moved_patches(patches: FloatArray | None, similarity: Similarity) -> FloatArray | None:
    """Patches (F, 3) rotated and scaled by a similarity, rounded as map files keep them; None for None."""
    if patches is None:
        return None
    return storable_patches(similarity.scale * patches.astype(np.float64) @ similarity.rotation.T)


def _folded(flat: FloatArray) -> FloatArray:
    """Points (N, 2) of the octahedron's lower half → where the unfolded surface has them, or back."""
    return np.asarray((1 - np.abs(flat[:, ::-1])) * np.where(flat < 0, -1, 1))
