"""Pixels of a zoomed picture, as if it had the common camera's focal length."""

from dataclasses import replace

import numpy as np

from rholoc.features import FeatureSet
from rholoc.geometry import Camera, FloatArray


def unzoomed(pixels: FloatArray, factor: FloatArray | float, camera: Camera) -> FloatArray:
    """Pixels (N, 2) with their distance from the principal point multiplied by a ``factor``, one or (N, 1)."""
    centre = np.array([camera.cx, camera.cy])
    return np.asarray(centre + (pixels - centre) * factor)


def unzoomed_features(features: FeatureSet, zoom: float, camera: Camera) -> FeatureSet:
    """Features of a picture with ``zoom`` × the camera's focal length, converted to the camera's focal length."""
    pixels = unzoomed(features.pixels.astype(np.float64), 1 / zoom, camera).astype(np.float32)
    return replace(features, pixels=pixels, sizes=np.asarray(features.sizes / zoom, np.float32))
