"""The pinhole camera with OpenCV's radial-tangential distortion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import cv2
import numpy as np

from rholoc.errors import InvalidCamera
from rholoc.geometry.arrays import BoolArray, FloatArray

_MIN_FIELD_OF_VIEW_DEG = 5.0
_MAX_FIELD_OF_VIEW_DEG = 175.0
_SHAPE_TOLERANCE = 0.01  # images whose aspect ratios differ by less than this share are of one shape


@dataclass(frozen=True)
class Camera:
    """Intrinsics of a camera, in pixels; pixel (0, 0) is the centre of the top-left pixel.

    ``distortion`` holds OpenCV's coefficients k1, k2, p1, p2[, k3[, k4, k5, k6]], or nothing.

    Raises:
        InvalidCamera: a value is not finite, a focal length is not positive, the size is impossible, the field of
            view is outside 5–175° or the principal point is outside the image.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        hint = "Give fx,fy,cx,cy[,k1,k2,p1,p2[,k3]] in pixels of the image that you send."
        values = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not all(math.isfinite(value) for value in values):
            raise InvalidCamera("The camera's intrinsics are not all finite numbers.", hint)
        if not (1 <= self.width <= 65535 and 1 <= self.height <= 65535) or self.width % 1 or self.height % 1:
            raise InvalidCamera(f"The camera's image size {self.width}×{self.height} is not possible.", hint)
        for name, focal, size in (("fx", self.fx, self.width), ("fy", self.fy, self.height)):
            if focal <= 0:
                raise InvalidCamera(f"The camera's {name} is {focal:g}; a focal length is positive.", hint)
            field_deg = math.degrees(2 * math.atan2(size / 2, focal))
            if not _MIN_FIELD_OF_VIEW_DEG <= field_deg <= _MAX_FIELD_OF_VIEW_DEG:
                raise InvalidCamera(
                    f"The camera's {name} {focal:g} px means a field of view of {field_deg:.1f}° over {size} px.", hint
                )
        if not (0 <= self.cx <= self.width and 0 <= self.cy <= self.height):
            raise InvalidCamera(f"The principal point ({self.cx:g}, {self.cy:g}) lies outside the image.", hint)
        if len(self.distortion) not in (0, 4, 5, 8):
            raise InvalidCamera(f"Expected 0, 4, 5 or 8 distortion coefficients, not {len(self.distortion)}.", hint)

    @classmethod
    def parse(cls, text: str, width: int, height: int) -> Camera:
        """Read ``fx,fy,cx,cy[,k1,k2,p1,p2[,k3]]``.

        Raises:
            InvalidCamera: the text is not such a list, or its values are impossible.
        """
        try:
            values = [float(part) for part in text.split(",")]
        except ValueError:
            values = []
        if len(values) < 4:
            raise InvalidCamera(f"'{text}' is not a camera.", "Give fx,fy,cx,cy[,k1,k2,p1,p2[,k3]] in pixels.")
        fx, fy, cx, cy, *distortion = values
        return cls(width, height, fx, fy, cx, cy, tuple(distortion))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Camera:
        """From ``width``, ``height``, ``fx``, ``fy``, ``cx``, ``cy`` and, optionally, ``distortion``.

        Raises:
            KeyError: a value is missing.
            TypeError, ValueError: one is not a number.
            InvalidCamera: the values are impossible.
        """
        intrinsics = {name: values[name] for name in ("fx", "fy", "cx", "cy")}
        width, height = int(values["width"]), int(values["height"])
        if (width, height) != (float(values["width"]), float(values["height"])):
            raise ValueError("width and height are whole numbers")
        distortion = tuple(map(float, values.get("distortion") or ()))
        return cls(width, height, **{name: float(value) for name, value in intrinsics.items()}, distortion=distortion)

    @classmethod
    def from_line(cls, text: str) -> Camera:
        """Read ``width height fx fy cx cy`` and the distortion, separated by spaces.

        Raises:
            ValueError: the text is not such a list.
            InvalidCamera: the values are impossible.
        """
        width, height, *values = text.split()
        fx, fy, cx, cy, *distortion = map(float, values)
        return cls(int(width), int(height), fx, fy, cx, cy, tuple(distortion))

    def to_line(self) -> str:
        """What :meth:`from_line` reads."""
        return " ".join(repr(value) for value in (self.width, self.height, *self.parameters))

    def to_dict(self) -> dict[str, Any]:
        """What :meth:`from_dict` takes, ready for JSON."""
        return asdict(self) | {"distortion": list(self.distortion)}

    @property
    def parameters(self) -> tuple[float, ...]:
        """fx, fy, cx, cy and the distortion, in the order that :meth:`parse` reads."""
        return (self.fx, self.fy, self.cx, self.cy, *self.distortion)

    @property
    def matrix(self) -> FloatArray:
        """K, (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], dtype=np.float64)

    @property
    def focal(self) -> float:
        """The geometric mean of fx and fy, in pixels."""
        return math.sqrt(self.fx * self.fy)

    def resized(self, width: int, height: int) -> Camera:
        """The same camera for its image scaled to ``width`` × ``height``; pixel centres are respected."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=(self.cx + 0.5) * sx - 0.5,
            cy=(self.cy + 0.5) * sy - 0.5,
        )

    def zoomed(self, scale: float) -> Camera:
        """The same camera with ``scale`` times the focal length."""
        return replace(self, fx=self.fx * scale, fy=self.fy * scale)

    def fitted(self, width: int, height: int) -> Camera:
        """The camera for images of ``width`` × ``height``: resized, if they are of the same shape.

        Raises:
            InvalidCamera: they are of another shape.
        """
        if abs(width * self.height / (height * self.width) - 1) >= _SHAPE_TOLERANCE:
            raise InvalidCamera(
                f"The intrinsics are for {self.width}×{self.height} pixels, the image is {width}×{height}.",
                "Give the intrinsics of the image as it is shown, after rotation.",
            )
        return self if (width, height) == (self.width, self.height) else self.resized(width, height)

    def undistort(self, pixels: FloatArray) -> FloatArray:
        """Pixels (N, 2) → points (N, 2) on the plane z = 1 of the camera frame."""
        points = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        if not self.distortion:
            return (points - (self.cx, self.cy)) / (self.fx, self.fy)
        if len(points) == 0:
            return np.zeros((0, 2))
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-12)
        undistorted = cv2.undistortPoints(points[:, None], self.matrix, np.array(self.distortion), criteria=criteria)
        return np.asarray(undistorted, dtype=np.float64).reshape(-1, 2)

    def rays(self, pixels: FloatArray) -> FloatArray:
        """Pixels (N, 2) → unit rays (N, 3) in the camera frame."""
        plane = self.undistort(pixels)
        rays = np.column_stack([plane, np.ones(len(plane))])
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def project(self, points: FloatArray) -> FloatArray:
        """Points (N, 3) in the camera frame, z > 0, → pixels (N, 2). Points with z ≤ 0 give NaN."""
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        depth = np.where(points[:, 2] > 0, points[:, 2], np.nan)
        plane = points[:, :2] / depth[:, None]
        return plane_to_pixels(self, plane)

    def contains(self, pixels: FloatArray) -> BoolArray:
        """Which of the pixels (N, 2) lie in the image: (N,) bool. NaN does not."""
        u, v = pixels[:, 0], pixels[:, 1]
        with np.errstate(invalid="ignore"):
            inside = (u >= -0.5) & (v >= -0.5) & (u <= self.width - 0.5) & (v <= self.height - 0.5)
        return inside


def plane_to_pixels(camera: Camera, plane: FloatArray) -> FloatArray:
    """Points (N, 2) on the plane z = 1 → pixels (N, 2), OpenCV's distortion model applied."""
    x, y = plane[:, 0], plane[:, 1]
    if camera.distortion:
        k1, k2, p1, p2, k3, k4, k5, k6 = (*camera.distortion, 0.0, 0.0, 0.0, 0.0)[:8]
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        x, y = (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )
    return np.column_stack([camera.fx * x + camera.cx, camera.fy * y + camera.cy])
