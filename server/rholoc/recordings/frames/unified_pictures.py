"""Pictures of several cameras, sizes, orientations or changing intrinsics as frames of one camera."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from rholoc.errors import InvalidCamera
from rholoc.geometry import ByteArray, Camera, FloatArray, IntArray, Lens, on_plane
from rholoc.geometry.lenses import places_of
from rholoc.recordings.frames.image_decoding import read_frame
from rholoc.recordings.recording import FrameSource, Recording

_MAX_EXTENT = 1.8  # tangent of a wide pinhole's maximum angle off the axis: 61°
_SHRINKING = 1.5  # minimum reduction for a picture to be averaged before it is resampled
_NAMED = 4  # sizes in a message
_MAPS = 4  # resampling maps of distorted cameras in memory
_STEADY = 0.002  # relative change of logged focal lengths, up to which they count as constant …
_STEADY_PX = 1.0  # … and of the principal point
_MAX_OFF_CENTRE = 0.1  # of a plausible principal point, as a share of the image's longer side
_FOCALS = (0.3, 4.0)  # plausible focal lengths, in multiples of the longer side


@dataclass(frozen=True, eq=False)
class UnifiedPictures:
    """Picture files resampled to one camera when read, see :class:`rholoc.recordings.FrameSource`.

    Border pixels are repeated beyond a picture's edge, which adds no corners.

    Attributes:
        paths: N files.
        cameras: N cameras of the stored pictures. Their focal lengths may share an unknown factor.
        common: the camera of the frames.
        numbers: (N,) int64.
        times: (N,) seconds, or rows.
        timed: whether the times were measured.
        focal_px: the common camera's focal length by EXIF; None if it is given, or nominal.
        lenses: lens number of each frame if focal lengths are unknown, one per picture size; empty if all share one.
    """

    paths: tuple[Path, ...]
    cameras: tuple[Camera, ...]
    common: Camera
    numbers: IntArray
    times: FloatArray
    timed: bool
    focal_px: float | None = None
    lenses: tuple[int, ...] = ()

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.common.width, self.common.height

    @property
    def lens_by_number(self) -> dict[int, int]:
        """Lens number by frame number; empty if one lens took all frames."""
        return dict(zip(self.numbers.tolist(), self.lenses, strict=True)) if self.lenses else {}

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        """The frames (H, W, 3) BGR of the rows, which must increase.

        Raises:
            InvalidRecording: a file is damaged, or has changed since it was listed.
        """
        for row in rows:
            camera = self.cameras[row]
            yield resampled(read_frame(self.paths[row], (camera.width, camera.height)), camera, self.common)


def require_one_camera(frames: object) -> None:
    """Check that one set of intrinsics can describe all frames.

    Raises:
        InvalidCamera: the frames were resampled from pictures of several sizes or lenses.
    """
    if isinstance(frames, UnifiedPictures):
        sizes = Counter(f"{camera.width}×{camera.height}" for camera in frames.cameras)
        named = ", ".join(size for size, _ in sizes.most_common(_NAMED))
        raise InvalidCamera(
            f"One camera is given for pictures of several sizes or lenses ({named}).",
            "Leave it out to have them measured, or map the pictures of one camera alone.",
        )


def common_camera(cameras: Sequence[Camera]) -> Camera:
    """Camera without distortion with the union of all ``cameras``' fields of view, at their median focal length.

    A full panorama if any camera is one; else a fisheye if any is one; else a pinhole, cut off at 61° from the axis.
    The principal point is the image's centre.
    """
    focal = float(np.median([camera.focal for camera in cameras]))
    lenses = {camera.lens for camera in cameras}
    if Lens.EQUIRECTANGULAR in lenses:
        height = round(math.pi * focal)
        return Camera.panorama(2 * height, height)
    lens = Lens.FISHEYE if Lens.FISHEYE in lenses else Lens.PINHOLE
    extents = np.array([_extent(camera, lens) for camera in set(cameras)]).max(axis=0)
    width, height = (round(2 * focal * extent) for extent in extents)
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, lens=lens)


def resampled(image: ByteArray, camera: Camera, common: Camera) -> ByteArray:
    """Resample an image (H, W, 3) or (H, W) from ``camera`` to ``common``, which share the pose. Pixels
    outside ``camera``'s image repeat its edge. For equal cameras, the image itself.
    """
    if camera == common:
        return image
    shrunk = common.focal / camera.focal
    if shrunk < 1 / _SHRINKING:
        size = round(camera.width * shrunk), round(camera.height * shrunk)
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        camera = camera.resized(*size)
    if (camera.lens, camera.distortion) == (common.lens, common.distortion) and camera.lens is not Lens.EQUIRECTANGULAR:
        return _zoomed(image, camera, common)
    horizontal, vertical = _maps(camera, common)
    found = cv2.remap(image, horizontal, vertical, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, dtype=np.uint8)


def _zoomed(image: ByteArray, camera: Camera, common: Camera) -> ByteArray:
    """Resample between cameras that differ in focal lengths and principal point alone."""
    across, down = camera.fx / common.fx, camera.fy / common.fy
    places = np.array([[across, 0, camera.cx - across * common.cx], [0, down, camera.cy - down * common.cy]])
    size, flags = (common.width, common.height), cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    found = cv2.warpAffine(image, places, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, dtype=np.uint8)


@lru_cache(_MAPS)
def _maps(camera: Camera, common: Camera) -> tuple[ByteArray, ByteArray]:
    """Coordinates in the camera's image of each pixel of the common camera, in OpenCV's fixed-point form; cached."""
    u, v = np.meshgrid(np.arange(common.width), np.arange(common.height))
    found = camera.project(common.rays(np.column_stack([u.ravel(), v.ravel()])))
    far = 2.0 * max(camera.width, camera.height)
    places = np.clip(np.nan_to_num(found, nan=-far), -far, far).astype(np.float32)
    shape = common.height, common.width
    horizontal, vertical = (np.ascontiguousarray(axis.reshape(shape)) for axis in places.T)
    maps = cv2.convertMaps(horizontal, vertical, cv2.CV_16SC2)
    return maps[0], maps[1]  # type: ignore[return-value]


def _extent(camera: Camera, lens: Lens) -> FloatArray:
    """Maximum horizontal and vertical distance (2,) of the image from its axis, projected by an undistorted ``lens``,
    in focal lengths; at most 1.8 for a pinhole.
    """
    across, down = np.linspace(-0.5, camera.width - 0.5, 9), np.linspace(-0.5, camera.height - 0.5, 9)
    edge = np.concatenate(
        [np.column_stack([across, np.full(9, place)]) for place in (down[0], down[-1])]
        + [np.column_stack([np.full(9, place), down]) for place in (across[0], across[-1])]
    )
    rays = camera.rays(edge)
    if lens is Lens.PINHOLE:
        return np.asarray(np.minimum(np.abs(on_plane(rays)).max(axis=0), _MAX_EXTENT))
    return np.asarray(np.abs(places_of(lens, rays, ())).max(axis=0))


@dataclass(frozen=True, eq=False)
class SteadyFrames:
    """Another source's frames resampled to one camera, see :class:`rholoc.recordings.FrameSource`.

    Attributes:
        source: N frames.
        cameras: N cameras of these.
        common: the camera of the resampled frames.
    """

    source: FrameSource
    cameras: tuple[Camera, ...]
    common: Camera

    @property
    def times(self) -> FloatArray:
        """(N,) seconds, or rows."""
        return self.source.times

    @property
    def timed(self) -> bool:
        """Whether the times were measured."""
        return self.source.timed

    @property
    def numbers(self) -> IntArray:
        """Numbers (N,) of the source's frames."""
        return self.source.numbers

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.common.width, self.common.height

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        """Iterate over the images (H, W, 3) BGR of the rows, which must increase, resampled to the common camera.

        Raises InvalidRecording if a frame cannot be decoded.
        """
        for row, image in zip(rows, self.source.images(rows), strict=True):
            yield resampled(image, self.cameras[row], self.common)


def with_logged_intrinsics(recording: Recording) -> Recording:
    """The recording with a camera from its logged intrinsics, and all frames resampled to it.

    If every frame's intrinsics are within 0.2 % (focal lengths) and 1 px (principal point) of their medians, nothing is
    resampled: the recording keeps its own camera, or gets one with the medians. Otherwise the camera gets the medians,
    with the distortion and lens of the recording's own camera, if it has one.

    The recording is returned unchanged if a frame has no intrinsics, or if the medians are implausible: a focal length
    not 0.3 to 4 × the longer side, or a principal point more than 0.1 × the longer side off the centre.
    """
    logged, (width, height) = recording.frame_intrinsics, recording.frames.size
    if logged is None or not np.isfinite(logged).all() or 0 in (width, height):
        return recording
    middle = np.median(logged, axis=0)
    focals = middle[:2] / max(width, height)
    off_centre = np.abs(middle[2:] / max(width, height) - np.array([width, height]) / 2 / max(width, height))
    if not (_FOCALS[0] < focals.min() <= focals.max() < _FOCALS[1] and off_centre.max() < _MAX_OFF_CENTRE):
        return recording
    base = recording.camera or Camera(width, height, *middle.tolist())
    changes = np.abs(logged - middle) > (*(_STEADY * middle[:2]), _STEADY_PX, _STEADY_PX)
    if not changes.any():
        return replace(recording, camera=base)
    common, *cameras = (
        replace(base, fx=fx, fy=fy, cx=cx, cy=cy) for fx, fy, cx, cy in np.vstack([middle, logged]).tolist()
    )
    return replace(recording, camera=common, frames=SteadyFrames(recording.frames, tuple(cameras), common))
