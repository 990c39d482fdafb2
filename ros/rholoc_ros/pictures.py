"""``CameraInfo``, ``Image`` and ``CompressedImage`` → the client's camera and pictures."""

from __future__ import annotations

from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from rholoc_client.models import Camera

ByteArray: TypeAlias = NDArray[np.uint8]

_JPEG, _PNG = b"\xff\xd8\xff", b"\x89PNG"
_PINHOLES = ("plumb_bob", "rational_polynomial", "")
_FISHEYES = ("equidistant", "fisheye")
_MAX_PINHOLE, _FISHEYE = 8, 4  # coefficients
_CHANNELS = {  # of an encoding, and OpenCV's conversion to grey or BGR
    "mono8": (1, None),
    "8UC1": (1, None),
    "bgr8": (3, None),
    "8UC3": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2BGR),
    "uyvy": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuyv": (2, cv2.COLOR_YUV2BGR_YUYV),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2BGR_YUYV),
}


def camera_of(info: Any, rectified: bool = False) -> Camera:
    """Camera of the pictures that a ``CameraInfo`` describes, with its binning and region of interest applied.

    Args:
        info: the message.
        rectified: whether the pictures are rectified (``image_rect``): pinhole by ``p``, without distortion.

    Raises:
        ValueError: the camera is not calibrated, or its model is none of those that are known.
    """
    p, k = [float(value) for value in info.p], [float(value) for value in info.k]
    fx, skew, cx, fy, cy = (p[0], p[1], p[2], p[5], p[6]) if rectified else (k[0], k[1], k[2], k[4], k[5])
    if fx <= 0 or fy <= 0:
        raise ValueError("CameraInfo is not calibrated: calibrate the camera, or set use_camera_info to false.")
    if skew:
        raise ValueError("CameraInfo has a skew, which is not supported: calibrate the camera without.")
    lens, distortion = ("pinhole", ()) if rectified else _distortion(info.distortion_model, info.d)
    roi, bin_x, bin_y = info.roi, max(1, info.binning_x), max(1, info.binning_y)
    width, height = roi.width or info.width, roi.height or info.height
    return Camera(
        fx=fx / bin_x,
        fy=fy / bin_y,
        cx=(cx - roi.x_offset + 0.5) / bin_x - 0.5,
        cy=(cy - roi.y_offset + 0.5) / bin_y - 0.5,
        distortion=distortion,
        width=width // bin_x or None,
        height=height // bin_y or None,
        lens=lens,
    )


def _distortion(model: str, coefficients: Any) -> tuple[str, tuple[float, ...]]:
    """Lens and coefficients; no coefficients if all are 0."""
    values = tuple(float(value) for value in coefficients)
    if model in _FISHEYES:
        if len(values) not in (0, _FISHEYE):
            raise ValueError(f"CameraInfo has {len(values)} coefficients; {model} has {_FISHEYE}.")
        return "fisheye", values
    if model not in _PINHOLES:
        known = ", ".join((*_PINHOLES[:2], *_FISHEYES))
        raise ValueError(f"The distortion model '{model}' is not supported: use one of {known}.")
    if any(values[_MAX_PINHOLE:]):
        raise ValueError(f"CameraInfo has {len(values)} coefficients: calibrate with at most {_MAX_PINHOLE}.")
    values = values[:_MAX_PINHOLE]
    if not any(values):
        return "pinhole", ()
    if len(values) not in (4, 5, _MAX_PINHOLE):
        raise ValueError(f"CameraInfo has {len(values)} coefficients; {model} has 4, 5 or 8.")
    return "pinhole", values


def picture_of(image: Any) -> ByteArray:
    """Pixels of an ``Image``: (H, W, 3) BGR or (H, W) grey.

    Raises:
        ValueError: an encoding that is not known, or fewer bytes than the size says.
    """
    if image.encoding not in _CHANNELS:
        raise ValueError(f"The encoding '{image.encoding}' is not supported: use one of {', '.join(_CHANNELS)}.")
    channels, conversion = _CHANNELS[image.encoding]
    content = np.frombuffer(image.data, dtype=np.uint8)
    used = image.width * channels
    if image.height < 1 or image.width < 1 or image.step < used or content.size < image.height * image.step:
        raise ValueError(f"An image of {image.width}×{image.height} pixels has only {content.size} bytes.")
    rows = content[: image.height * image.step].reshape(image.height, image.step)[:, :used]
    pixels = np.ascontiguousarray(rows).reshape(image.height, image.width, channels)
    pixels = pixels[:, :, 0] if channels == 1 else pixels
    return pixels if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion), dtype=np.uint8)


def compressed_picture_of(image: Any) -> bytes:
    """The JPEG or PNG file of a ``CompressedImage``.

    Raises:
        ValueError: it is of another format.
    """
    content = bytes(image.data)
    if not content.startswith((_JPEG, _PNG)):
        raise ValueError(f"The format '{image.format}' is not supported: send JPEG or PNG.")
    return content
