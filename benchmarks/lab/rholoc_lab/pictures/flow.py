"""Optical flow over a picture: tracks as lines, a dense field as colours."""

import cv2
import numpy as np

from rholoc.geometry import ByteArray, FloatArray

_LINE, _POINT = (60, 200, 255), (74, 209, 209)  # BGR
_FASTEST_SHARE = 99.0  # the percentile of motion that gets full saturation


def tracks_png(image: ByteArray, before: FloatArray, now: FloatArray) -> bytes:
    """A picture (H, W, 3) BGR with lines from where N corners were (N, 2) to where they are (N, 2), as a PNG."""
    drawn = cv2.addWeighted(image, 0.7, np.zeros_like(image), 0.3, 0)
    for start, end in zip(np.round(before).astype(int).tolist(), np.round(now).astype(int).tolist(), strict=True):
        cv2.line(drawn, start, end, _LINE, 1, cv2.LINE_AA)
        cv2.circle(drawn, end, 2, _POINT, -1, cv2.LINE_AA)
    return bytes(cv2.imencode(".png", drawn)[1].tobytes())


def dense_png(flow: FloatArray) -> bytes:
    """A field (H, W, 2) as a PNG: hue is the direction (red to the right), brightness how far, full at the fastest."""
    length, angle = np.linalg.norm(flow, axis=2), np.arctan2(flow[..., 1], flow[..., 0])
    fastest = max(float(np.percentile(length, _FASTEST_SHARE)), 1e-6)
    hue = np.round(np.degrees(angle) % 360 / 2) % 180
    value = np.round(255 * np.minimum(length / fastest, 1))
    coloured = np.stack([hue, np.full_like(hue, 255), value], axis=-1).astype(np.uint8)
    return bytes(cv2.imencode(".png", cv2.cvtColor(coloured, cv2.COLOR_HSV2BGR))[1].tobytes())
