"""Cameras: intrinsics, rays of pixels, projections of points."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from rholoc.errors import InvalidCamera
from rholoc.geometry.arrays import BoolArray, FloatArray
from rholoc.geometry.lenses import Lens, field_of_view_rad, places_of, rays_of, slopes_of, widest_angle
from rholoc.geometry.vectors import basis_across
from rholoc.lazy import lazy

_MIN_FIELD_OF_VIEW_DEG = 5.0
_MAX_FIELDS_OF_VIEW_DEG = {  # across and down
    Lens.PINHOLE: (175.0, 175.0),
    Lens.FISHEYE: (360.0, 360.0),
    Lens.EQUIRECTANGULAR: (360.5, 180.5),
}
_MIN_FISHEYE_RAD = math.radians(10.0)  # off the axis, up to which its distortion must describe a lens
CAMERA_WRITTEN = "fx,fy,cx,cy[,k1,k2,p1,p2[,k3]], fisheye:fx,fy,cx,cy[,k1,k2,k3,k4] or equirectangular"
"""How users write a camera, see :meth:`Camera.parse`."""

_ORDINARY_RAD, _MAX_BREADTH = math.radians(60.0), 4.0
_SHAPE_TOLERANCE = 0.01  # images whose aspect ratios differ by less than this share are of one shape


@dataclass(frozen=True)
class Camera:
    """Intrinsics of a camera, in pixels; pixel (0, 0) is the centre of the top-left pixel.

    ``fx`` and ``fy`` are pixels a unit of the lens's own coordinates (:mod:`rholoc.geometry.lenses`): at the optical
    axis pixels a radian. ``distortion`` holds the lens's coefficients, as OpenCV orders them, or nothing.

    Raises:
        InvalidCamera: a value is not finite, a focal length is not positive, the size is impossible, the field of
            view is too small or too large for the lens, the principal point is outside the image, or the lens has
            another number of coefficients.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    lens: Lens = Lens.PINHOLE

    def __post_init__(self) -> None:
        hint = f"Give {CAMERA_WRITTEN} in pixels of the image that you send."
        values = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not all(math.isfinite(value) for value in values):
            raise InvalidCamera("The camera's intrinsics are not all finite numbers.", hint)
        if not (1 <= self.width <= 65535 and 1 <= self.height <= 65535) or self.width % 1 or self.height % 1:
            raise InvalidCamera(f"The camera's image size {self.width}×{self.height} is not possible.", hint)
        widest_deg = _MAX_FIELDS_OF_VIEW_DEG[self.lens]
        for name, focal, size, most_deg in zip(
            ("fx", "fy"), (self.fx, self.fy), (self.width, self.height), widest_deg, strict=True
        ):
            if focal <= 0:
                raise InvalidCamera(f"The camera's {name} is {focal:g}; a focal length is positive.", hint)
            field_deg = math.degrees(field_of_view_rad(self.lens, float(size) / float(focal)))
            if not _MIN_FIELD_OF_VIEW_DEG <= field_deg <= most_deg:
                raise InvalidCamera(
                    f"The camera's {name} {focal:g} px means a field of view of {field_deg:.1f}° over {size} px.", hint
                )
        if not (-0.5 < self.cx < self.width - 0.5 and -0.5 < self.cy < self.height - 0.5):  # the edges' coordinates
            raise InvalidCamera(
                f"The principal point ({self.cx:g}, {self.cy:g}) lies outside the image of {self.width}×{self.height}.",
                f"{hint} Those of a larger picture must be scaled with it.",
            )
        allowed = self.lens.coefficients
        if len(self.distortion) not in allowed:
            numbers = ", ".join(map(str, allowed[:-1])) + f" or {allowed[-1]}" if len(allowed) > 1 else "0"
            raise InvalidCamera(
                f"A {self.lens} camera has {numbers} distortion coefficients, not {len(self.distortion)}.", hint
            )
        if self.lens is Lens.FISHEYE and widest_angle(self.distortion) < _MIN_FISHEYE_RAD:
            raise InvalidCamera("The fisheye's distortion describes no lens: its radius soon shrinks again.", hint)

    @classmethod
    def panorama(cls, width: int, height: int) -> Camera:
        """Equirectangular camera of a whole panorama, the optical axis in its middle."""
        focal = width / math.tau, height / math.pi
        return cls(width, height, *focal, (width - 1) / 2, (height - 1) / 2, lens=Lens.EQUIRECTANGULAR)

    @classmethod
    def parse(cls, text: str, width: int, height: int) -> Camera:
        """Read ``fx,fy,cx,cy[,k1,k2,p1,p2[,k3[,k4,k5,k6]]]``, ``fisheye:fx,fy,cx,cy[,k1,k2,k3,k4]`` or
        ``equirectangular``.

        Raises:
            InvalidCamera: the text is none of them, or its values are impossible.
        """
        named, _, values_text = text.rpartition(":")
        if text == Lens.EQUIRECTANGULAR:
            return cls.panorama(width, height)
        try:
            lens = Lens(named) if named else Lens.PINHOLE
            values = [float(part) for part in values_text.split(",")]
        except ValueError:
            values = []
        if len(values) < 4:
            raise InvalidCamera(f"'{text}' is not a camera.", f"Give {CAMERA_WRITTEN} in pixels.")
        fx, fy, cx, cy, *distortion = values
        return cls(width, height, fx, fy, cx, cy, tuple(distortion), lens)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Camera:
        """From ``width``, ``height``, ``fx``, ``fy``, ``cx``, ``cy`` and, optionally, ``distortion`` and ``lens``.

        Of a whole panorama ``width``, ``height`` and ``lens`` suffice.

        Raises:
            KeyError: a value is missing.
            TypeError, ValueError: one is not a number, or the lens is not known.
            InvalidCamera: the values are impossible.
        """
        width, height = int(values["width"]), int(values["height"])
        if (width, height) != (float(values["width"]), float(values["height"])):
            raise ValueError("width and height are whole numbers")
        lens = Lens(values.get("lens") or Lens.PINHOLE)
        if lens is Lens.EQUIRECTANGULAR and values.get("fx") is None:
            return cls.panorama(width, height)
        intrinsics = {name: values[name] for name in ("fx", "fy", "cx", "cy")}
        distortion = tuple(map(float, values.get("distortion") or ()))
        numbers = {name: float(value) for name, value in intrinsics.items()}
        return cls(width, height, **numbers, distortion=distortion, lens=lens)

    @classmethod
    def from_line(cls, text: str) -> Camera:
        """Read ``width height fx fy cx cy`` and the distortion, separated by spaces; the lens first unless a pinhole.

        Raises:
            ValueError: the text is not such a list.
            InvalidCamera: the values are impossible.
        """
        first, *rest = text.split()
        lens, numbers = (Lens(first), rest) if first in set(Lens) else (Lens.PINHOLE, [first, *rest])
        width, height, *values = numbers
        fx, fy, cx, cy, *distortion = map(float, values)
        return cls(int(width), int(height), fx, fy, cx, cy, tuple(distortion), lens)

    def to_line(self) -> str:
        """The camera as a line of text, read by :meth:`from_line`."""
        numbers = " ".join(repr(value) for value in (self.width, self.height, *self.parameters))
        return numbers if self.lens is Lens.PINHOLE else f"{self.lens} {numbers}"

    def to_text(self) -> str:
        """The intrinsics as text, read by :meth:`parse` for images of the camera's size."""
        numbers = ",".join(repr(value) for value in self.parameters)
        return numbers if self.lens is Lens.PINHOLE else f"{self.lens}:{numbers}"

    def to_dict(self) -> dict[str, Any]:
        """The camera as a JSON-serialisable dictionary, read by :meth:`from_dict`; a pinhole's has no ``lens``."""
        values = asdict(self) | {"distortion": list(self.distortion), "lens": self.lens.value}
        return {name: value for name, value in values.items() if name != "lens" or self.lens is not Lens.PINHOLE}

    @property
    def parameters(self) -> tuple[float, ...]:
        """fx, fy, cx, cy and the distortion, in the order that :meth:`parse` reads."""
        return (self.fx, self.fy, self.cx, self.cy, *self.distortion)

    @property
    def matrix(self) -> FloatArray:
        """Intrinsic matrix K (3, 3), without distortion."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], dtype=np.float64)

    @property
    def focal(self) -> float:
        """The geometric mean of fx and fy, in pixels: pixels a radian at the optical axis."""
        return math.sqrt(self.fx * self.fy)

    @property
    def breadth(self) -> float:
        """Field of view of a wide lens along the longer side in units of 60°, clipped to 1 to 4; 1 for pinholes.

        Limits on pixels and features are for ordinary pictures; for wide ones they are multiplied by this.
        """
        if self.lens is Lens.PINHOLE:
            return 1.0
        across_rad = field_of_view_rad(self.lens, max(self.width, self.height) / self.focal)
        return float(np.clip(across_rad / _ORDINARY_RAD, 1.0, _MAX_BREADTH))

    def resized(self, width: int, height: int) -> Camera:
        """The camera for its image scaled to ``width`` × ``height``, which may have another aspect ratio."""
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

    def turned(self, quarters: int) -> Camera:
        """The camera for its image turned clockwise by quarter turns; the camera frame turns with the image, about the
        optical axis. Not for panoramas.
        """
        if quarters % 4 == 0:
            return self
        distortion = self.distortion
        if self.lens is Lens.PINHOLE and distortion:
            k1, k2, p1, p2, *others = distortion
            distortion = (k1, k2, p2, -p1, *others)
        centre = self.height - 1 - self.cy, self.cx
        once = Camera(self.height, self.width, self.fy, self.fx, *centre, distortion, self.lens)
        return once.turned(quarters - 1)

    def fitted(self, width: int, height: int) -> Camera:
        """The camera resized for images of ``width`` × ``height``, whose aspect ratio must be the same within 1 %.

        Raises:
            InvalidCamera: the aspect ratio differs.
        """
        if abs(width * self.height / (height * self.width) - 1) >= _SHAPE_TOLERANCE:
            raise InvalidCamera(
                f"The intrinsics are for {self.width}×{self.height} pixels, the image is {width}×{height}.",
                "Give the intrinsics of the image as it is shown, after rotation.",
            )
        return self if (width, height) == (self.width, self.height) else self.resized(width, height)

    def rays(self, pixels: FloatArray) -> FloatArray:
        """Pixels (N, 2) → unit rays (N, 3) in the camera frame."""
        pixels = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        return rays_of(self.lens, (pixels - (self.cx, self.cy)) / (self.fx, self.fy), self.distortion)

    def project(self, points: FloatArray) -> FloatArray:
        """Points (N, 3) in the camera frame → pixels (N, 2).

        NaN for points that the lens cannot show: z ≤ 0 for a pinhole, beyond :func:`widest_angle` for a fisheye.
        """
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        places = places_of(self.lens, points, self.distortion)
        return np.asarray(places * (self.fx, self.fy) + (self.cx, self.cy))

    def slopes(self, points: FloatArray) -> FloatArray:
        """Derivative (N, 2, 3) of the pixel by the point, at points (N, 3) in the camera frame.

        NaN for points that the lens cannot show. A pinhole's distortion is ignored.
        """
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        return np.asarray(slopes_of(self.lens, points, self.distortion) * np.array([[self.fx], [self.fy]]))

    def depths(self, points: FloatArray) -> FloatArray:
        """Depths (N,) of points (N, 3) in the camera frame, such that size in pixels = focal × size / depth.

        Along the optical axis of a pinhole; of other lenses the distance.
        """
        return np.asarray(points[:, 2] if self.lens is Lens.PINHOLE else np.linalg.norm(points, axis=1))

    def planes(self, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Planes in which reprojection errors of pixels (N, 2) are measured, in units of the focal length.

        For a pinhole the image plane z = 1; for other lenses the plane perpendicular to each pixel's ray.

        Returns:
            R_plane_camera (N, 3, 3), and the pixels' points (N, 2) on the plane z = 1 of these frames.
        """
        rays = self.rays(pixels)
        if self.lens is Lens.PINHOLE:
            return np.broadcast_to(np.eye(3), (len(rays), 3, 3)), on_plane(rays)
        R_plane_camera = np.concatenate([np.swapaxes(basis_across(rays), 1, 2), rays[:, None]], axis=1)
        return R_plane_camera, np.zeros((len(rays), 2))

    def contains(self, pixels: FloatArray) -> BoolArray:
        """Mask (N,) of the pixels (N, 2) that lie in the image; false for NaN."""
        u, v = pixels[:, 0], pixels[:, 1]
        with np.errstate(invalid="ignore"):
            inside = (u >= -0.5) & (v >= -0.5) & (u <= self.width - 0.5) & (v <= self.height - 0.5)
        return inside

    def shows(self, points: FloatArray) -> BoolArray:
        """Mask (...) of the points (..., 3) in the camera frame that lie in its field of view.

        With a pinhole's distortion approximately: as a rectangle through the middles of the image's edges.
        """
        if self.lens is not Lens.PINHOLE:
            return np.reshape(self.contains(self.project(points)), points.shape[:-1])
        (left, top), (right, bottom) = self._field
        x, y, depth = np.moveaxis(points, -1, 0)
        inside = (x >= left * depth) & (x <= right * depth) & (y >= top * depth) & (y <= bottom * depth)
        return np.asarray(inside & (depth > 0))

    @lazy
    def _field(self) -> FloatArray:
        """Bounds (2, 2) of a pinhole's image on the plane z = 1, at the middles of its edges: min x, y; max x, y."""
        right, bottom = self.width - 0.5, self.height - 0.5
        edges = np.array([[-0.5, self.cy], [self.cx, -0.5], [right, self.cy], [self.cx, bottom]])
        (left, _), (_, top), (right, _), (_, bottom) = on_plane(self.rays(edges))
        return np.array([[left, top], [right, bottom]])


def on_plane(rays: FloatArray) -> FloatArray:
    """Rays (N, 3) with z > 0 → points (N, 2) on the plane z = 1."""
    return np.asarray(rays[:, :2] / rays[:, 2:])
