"""Camera models by their names in COLMAP, kapture, nerfstudio and others."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rholoc.geometry import Camera, Lens
from rholoc.reports import RecordingWarning, WarningKind

CENTRE_SHIFT = 0.5  # their pixel (0.5, 0.5) is the centre of the top-left one


@dataclass(frozen=True)
class _Model:
    """Parameter layout of a camera model.

    Attributes:
        lens: its lens.
        pinhole: indices of fx, fy, cx, cy; empty for a panorama, which has only a size.
        distortion: indices of the lens's coefficients; None stands for zero.
    """

    lens: Lens
    pinhole: tuple[int, ...]
    distortion: tuple[int | None, ...] = ()


_MODELS = {
    "SIMPLE_PINHOLE": _Model(Lens.PINHOLE, (0, 0, 1, 2)),
    "PINHOLE": _Model(Lens.PINHOLE, (0, 1, 2, 3)),
    "SIMPLE_RADIAL": _Model(Lens.PINHOLE, (0, 0, 1, 2), (3, None, None, None)),
    "RADIAL": _Model(Lens.PINHOLE, (0, 0, 1, 2), (3, 4, None, None)),
    "OPENCV": _Model(Lens.PINHOLE, (0, 1, 2, 3), (4, 5, 6, 7)),
    "FULL_OPENCV": _Model(Lens.PINHOLE, (0, 1, 2, 3), (4, 5, 6, 7, 8, 9, 10, 11)),
    "SIMPLE_FISHEYE": _Model(Lens.FISHEYE, (0, 0, 1, 2)),
    "FISHEYE": _Model(Lens.FISHEYE, (0, 1, 2, 3)),
    "SIMPLE_RADIAL_FISHEYE": _Model(Lens.FISHEYE, (0, 0, 1, 2), (3, None, None, None)),
    "RADIAL_FISHEYE": _Model(Lens.FISHEYE, (0, 0, 1, 2), (3, 4, None, None)),
    "OPENCV_FISHEYE": _Model(Lens.FISHEYE, (0, 1, 2, 3), (4, 5, 6, 7)),
    "EQUIRECTANGULAR": _Model(Lens.EQUIRECTANGULAR, ()),
}


def camera_of_model(model: str, size: tuple[int, int], parameters: Sequence[float]) -> Camera | None:
    """The camera of a COLMAP model, or of ``EQUIRECTANGULAR``, which has no parameters. None for other models.

    In ``parameters`` pixel (0.5, 0.5) is the centre of the top-left pixel; the camera's is (0, 0). Surplus parameters
    are ignored.

    Raises:
        IndexError: parameters are missing.
        InvalidCamera: their values are impossible.
    """
    known = _MODELS.get(model)
    if known is None:
        return None
    if known.lens is Lens.EQUIRECTANGULAR:
        return Camera.panorama(*size)
    fx, fy, cx, cy = (parameters[place] for place in known.pinhole)
    coefficients = tuple(0.0 if place is None else parameters[place] for place in known.distortion)
    return Camera(*size, fx, fy, cx - CENTRE_SHIFT, cy - CENTRE_SHIFT, coefficients, known.lens)


def lens_of_model(model: str) -> Lens | None:
    """The lens of a camera model by its name; None where it is not supported."""
    known = _MODELS.get(model)
    return None if known is None else known.lens


def three_coefficients(radial: Sequence[float], camera: Camera) -> tuple[float, float, float]:
    """k1, k2, k3 that approximate the distortion by ``radial``, k1 … k4 of a polynomial: least squares over the image
    of a ``camera`` without distortion. If k4 is 0, the first three unchanged.
    """
    if not radial[3]:
        return radial[0], radial[1], radial[2]
    radius = float(np.hypot(camera.width, camera.height)) / 2 / camera.focal
    squares = np.linspace(0.05, 1, 40) ** 2 * radius**2
    powers = squares[:, None] ** np.arange(1, 5)
    found = np.linalg.lstsq(powers[:, :3], powers @ np.array(radial), rcond=None)[0]
    return float(found[0]), float(found[1]), float(found[2])


def unsupported(model: str) -> RecordingWarning:
    """Warning that intrinsics of the camera model ``model`` are ignored."""
    text = f"The camera's model is {model}, which is not supported: its intrinsics are ignored."
    return RecordingWarning(WarningKind.CAMERA_UNSUPPORTED, text)
