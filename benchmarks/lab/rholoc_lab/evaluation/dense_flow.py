"""Dense optical flow between two pictures (the paper's Table 1)."""

from enum import StrEnum

import cv2
import numpy as np

from rholoc.geometry import ByteArray, FloatArray


class DenseMethod(StrEnum):
    """How dense flow is computed."""

    FARNEBACK = "farneback"  # polynomial expansion on a pyramid (Farnebäck, 2003)
    DIS = "dis"  # dense inverse search (Kroeger et al., 2016): quicker, sharper at edges


def dense_flow(before: ByteArray, after: ByteArray, method: DenseMethod) -> FloatArray:
    """Flow (H, W, 2) [px] from ``before`` to ``after``; both (H, W, 3) BGR or (H, W) grey."""
    first, second = _grey(before), _grey(after)
    if method is DenseMethod.DIS:
        search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        return np.asarray(search.calc(first, second, None), dtype=np.float64)  # type: ignore[call-overload]
    flow = cv2.calcOpticalFlowFarneback(first, second, None, 0.5, 5, 21, 3, 7, 1.5, 0)  # type: ignore[call-overload]
    return np.asarray(flow, dtype=np.float64)


def _grey(image: ByteArray) -> ByteArray:
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    return np.ascontiguousarray(grey, dtype=np.uint8)


def off_tracks(field: FloatArray, before: FloatArray, now: FloatArray) -> FloatArray:
    """Distances (N,) [px] of a dense field (H, W, 2) at ``before`` (N, 2) from the motions to ``now`` (N, 2)."""
    height, width = field.shape[:2]
    u, v = np.round(before).astype(np.int64).T
    there = field[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)]
    return np.asarray(np.linalg.norm(there - (now - before), axis=1))
