"""Convert requests to queries: images and descriptor sets, intrinsics, priors."""

import base64
import binascii
import math
from collections.abc import Sized
from dataclasses import dataclass
from typing import Any

import numpy as np

from rholoc.errors import InvalidCamera, InvalidDescriptors, InvalidInput
from rholoc.features import Extractor, FeatureSet
from rholoc.geometry import ByteArray, Camera, FloatArray, Lens, Pose
from rholoc.localization import Intrinsics, Prior
from rholoc.recordings.frames.image_decoding import visited_pixels
from rholoc.service.frames.request_models import FeaturesIn, LocalizeOptions, PriorIn
from rholoc.service.http.models import CameraIn
from rholoc.service.threads.compute import Effort

_CAMERA_HINT = "Send fx, fy, cx, cy (and distortion) of the image, in pixels."

_ORDINARY_PIXELS = 2_500_000  # Full HD, and a little more
_ORDINARY_FEATURES = 3000

_GUESSED_FOCAL = 0.8  # of the longer side: phones and webcams are near it


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame as it was sent: either an encoded image or a descriptor set, and the options.

    ``stored`` is the camera named in the options, if any; ``effort`` is the expected localization effort.
    """

    options: LocalizeOptions
    image: bytes | None = None
    features: FeaturesIn | None = None
    stored: Camera | None = None
    effort: Effort = Effort.ORDINARY


def effort_of(image: bytes) -> Effort:
    """Expected localization effort for an encoded picture, by its header: LARGE above 2.5 megapixels."""
    return Effort.LARGE if visited_pixels(image) > _ORDINARY_PIXELS else Effort.ORDINARY


def effort_of_set(body: bytes) -> Effort:
    """Expected effort for a descriptor set: LARGE if its JSON has over 3000 lists, one per feature."""
    return Effort.LARGE if body.count(b"[") > _ORDINARY_FEATURES else Effort.ORDINARY


def camera_for(frame: Frame, size: tuple[int, int], map_camera: Camera) -> Camera:
    """Intrinsics of a frame of ``size`` (width, height) [px]: of the named camera, or given, or guessed, or the map's
    own.

    Given ones need only fx: fy is then fx, and the principal point the image's centre. Without fx, a picture given as
    equirectangular is a whole panorama, and others have the map's camera. Intrinsics for another size of the same
    aspect ratio are scaled. If the options call them unknown, the principal point is the image's centre and the focal
    length 0.8 × the longer side.

    Raises:
        InvalidCamera: the intrinsics are impossible, without fx, given twice, or for another aspect ratio.
    """
    if min(size) < 1:
        raise InvalidCamera(f"The camera's image size {size[0]}×{size[1]} is not possible.", _CAMERA_HINT)
    given, stored = frame.options.camera, frame.stored
    if frame.options.intrinsics is Intrinsics.UNKNOWN:
        if stored is not None or _has_intrinsics(given):
            raise InvalidCamera(
                "The intrinsics are both given and unknown.", "Send the intrinsics, or intrinsics 'unknown'."
            )
        guess = _GUESSED_FOCAL * max(size)
        return Camera(*size, guess, guess, (size[0] - 1) / 2, (size[1] - 1) / 2)
    if stored is not None:
        if _has_intrinsics(given):
            raise InvalidCamera("The camera is both named and given.", "Send its name, or its intrinsics.")
        return stored.fitted(*size)
    if given.fx is None:
        others = given.fy, given.cx, given.cy, given.distortion or None
        if any(one is not None for one in others) or given.lens is Lens.FISHEYE:
            raise InvalidCamera("The camera has no fx.", _CAMERA_HINT)
        if given.lens is Lens.EQUIRECTANGULAR:
            return Camera.panorama(*size)
        try:
            return map_camera.fitted(*size)
        except InvalidCamera as error:
            raise InvalidCamera(
                f"No intrinsics were sent, and the map's own camera ({map_camera.width}×{map_camera.height}) "
                f"cannot have taken an image of {size[0]}×{size[1]}.",
                f"{_CAMERA_HINT} Or send intrinsics 'unknown'.",
            ) from error
    width, height = given.width or size[0], given.height or size[1]
    camera = Camera(
        width,
        height,
        given.fx,
        given.fx if given.fy is None else given.fy,
        (width - 1) / 2 if given.cx is None else given.cx,
        (height - 1) / 2 if given.cy is None else given.cy,
        tuple(given.distortion),
        given.lens,
    )
    return camera.fitted(*size)


def _has_intrinsics(given: CameraIn) -> bool:
    """Whether any of the intrinsics is given, distortion and a lens other than the pinhole included."""
    figures = given.fx, given.fy, given.cx, given.cy
    return any(value is not None for value in figures) or bool(given.distortion) or given.lens is not Lens.PINHOLE


def prior_of(given: PriorIn | None) -> Prior | None:
    """The prior as the localizer takes it, radius in radians; None for None.

    Raises:
        InvalidInput: values are not finite, or there is not exactly one of heading and quaternion.
    """
    if given is None:
        return None
    position = finite("prior.position", given.position)
    if (given.heading is None) == (given.quaternion_xyzw is None):
        raise InvalidInput("A prior needs either a heading or a quaternion.", "Send prior.heading.")
    if given.heading is not None:
        pose = Pose.from_heading(position, direction("prior.heading", given.heading))
    else:
        pose = Pose.from_quaternion(position, direction("prior.quaternion_xyzw", given.quaternion_xyzw or []))
    radius_rad = math.radians(float(finite("prior.radius_deg", [given.radius_deg])[0]))
    return Prior(pose, float(finite("prior.radius_m", [given.radius_m])[0]), radius_rad)


def gravity_of(given: list[float] | None) -> FloatArray | None:
    """Gravity's direction in the camera frame (3,), unit length; None for None.

    Raises:
        InvalidInput: it has no direction, or is not finite.
    """
    return None if given is None else direction("gravity", given)


def max_sigmas(options: LocalizeOptions) -> tuple[float, float]:
    """Maximum accepted standard deviations of a request [m] and [rad]; infinite by default."""
    max_deg = math.inf if options.max_sigma_deg is None else options.max_sigma_deg
    return math.inf if options.max_sigma_m is None else options.max_sigma_m, math.radians(max_deg)


def finite(name: str, values: list[float]) -> FloatArray:
    """Values as an array (N,), for the member ``name`` of a request.

    Raises:
        InvalidInput: one of them is not finite, or beyond ±1e9.
    """
    array = np.asarray(values, dtype=np.float64)
    if not np.isfinite(array).all() or np.abs(array).max() > 1e9:
        raise InvalidInput(f"{name} must consist of finite numbers.", "Send numbers.")
    return array


def direction(name: str, values: list[float]) -> FloatArray:
    """Values as a vector of unit length, for the member ``name`` of a request.

    Raises:
        InvalidInput: they are not finite, or shorter than 1e-9.
    """
    array = finite(name, values)
    length = float(np.linalg.norm(array))
    if length < 1e-9:
        raise InvalidInput(f"{name} has no direction: its length is 0.", "Send a unit vector.")
    return np.asarray(array / length)


def feature_set(given: FeaturesIn, extractor: Extractor, max_features: int) -> FeatureSet:
    """A descriptor set as the localizer takes it.

    Raises:
        InvalidDescriptors: it has over ``max_features``, its lists differ in length, a value is not finite, a size is
            negative, a pixel or size is beyond ±1e6 px, or it is not of the extractor's kind.
    """
    n = len(given.pixels)
    if n > max_features:
        raise InvalidDescriptors(f"{n} features; at most {max_features} are taken.", "Send the strongest ones.")
    sizes, angles = _sizes(given.sizes_px, n), _angles(given.angles_deg, n)
    descriptors = _descriptors(given.descriptors, n, extractor)
    if max(np.abs(given.pixels).max(initial=0.0), np.abs(sizes).max(initial=0.0)) > 1e6:
        raise InvalidDescriptors("A feature lies outside any image.", "Send pixels of the image.")
    return FeatureSet(
        np.asarray(given.pixels, dtype=np.float32).reshape(-1, 2),
        _channels(given.channels, n, extractor),
        descriptors,
        sizes.astype(np.float32),
        angles.astype(np.float32),
    )


def _check_one_each(given: Sized, n: int, named: str, hint: str) -> None:
    """Raise InvalidDescriptors with ``hint`` unless ``given``, called ``named``, has ``n`` entries."""
    if len(given) != n:
        raise InvalidDescriptors(f"{len(given)} {named} for {n} pixels.", hint)


def _sizes(given: list[float] | None, n: int) -> FloatArray:
    """Diameters (N,) [px], 0 where unknown or if ``given`` is None. Raises InvalidDescriptors: not ``n``, or one is
    negative or not finite.
    """
    if given is None:
        return np.zeros(n)
    _check_one_each(given, n, "sizes_px", "Send one per feature, 0 where unknown.")
    sizes = np.asarray(given, dtype=np.float64)
    if not np.isfinite(sizes).all():
        raise InvalidDescriptors("A feature's size is not a finite number.", "Send 0 in sizes_px where unknown.")
    if (sizes < 0).any():
        raise InvalidDescriptors("A feature's size is negative.", "Send its diameter in pixels, 0 where unknown.")
    return sizes


def _angles(given: list[float | None] | None, n: int) -> FloatArray:
    """Angles (N,) [rad] in [0, 2 π), NaN where unknown or if ``given`` is None. Raises InvalidDescriptors: not ``n``,
    or one is infinite.
    """
    if given is None:
        return np.full(n, np.nan)
    _check_one_each(given, n, "angles_deg", "Send one per feature, null where unknown.")
    angles = np.asarray(given, dtype=np.float64)  # None becomes NaN
    if np.isinf(angles).any():
        raise InvalidDescriptors("A feature's angle is not a finite number.", "Send null in angles_deg where unknown.")
    return np.radians(angles % 360)


def _descriptors(given: list[str] | str, n: int, extractor: Extractor) -> ByteArray:
    """Descriptors (N, D) from N hexadecimal strings or one base64 string. Raises InvalidDescriptors: another length."""
    length = extractor.descriptor_bytes
    hint = f"This map takes '{extractor.name}' features: {length} bytes each, as hex strings or one base64 string."
    if isinstance(given, str):
        try:
            blob = base64.b64decode(given, validate=True)
        except (binascii.Error, ValueError) as error:
            raise InvalidDescriptors("The descriptors are not base64.", hint) from error
        if len(blob) != n * length:
            raise InvalidDescriptors(f"{len(blob)} bytes of descriptors for {n} features.", hint)
    else:
        wrong = next((row for row in given if len(row) != 2 * length), None)
        if wrong is not None:
            raise InvalidDescriptors(f"A descriptor has {len(wrong) / 2:g} bytes.", hint)
        _check_one_each(given, n, "descriptors", hint)
        try:
            blob = bytes.fromhex("".join(given))
        except ValueError as error:
            raise InvalidDescriptors("A descriptor contains characters other than hex digits.", hint) from error
        if len(blob) != n * length:
            raise InvalidDescriptors("A descriptor contains characters other than hex digits.", hint)
    return np.frombuffer(blob, dtype=np.uint8).reshape(n, length)


def _channels(given: list[int | str] | None, n: int, extractor: Extractor) -> ByteArray:
    """Channels (N,) by number or name; ``given`` may be None if the extractor has only one. Raises
    InvalidDescriptors: there are not ``n``, or the extractor lacks one.
    """
    names = ", ".join(f"{channel.value} {channel.name}" for channel in extractor.channels)
    hint = f"This map's '{extractor.name}' features come from the channels {names}."
    if given is None:
        if len(extractor.channels) != 1:
            raise InvalidDescriptors("The features have no channels.", hint)
        return np.full(n, extractor.channels[0], dtype=np.uint8)
    _check_one_each(given, n, "channels", hint)
    known: dict[Any, int] = {channel.name: channel.value for channel in extractor.channels}
    known |= {channel.value: channel.value for channel in extractor.channels}
    strange = next((channel for channel in given if channel not in known), None)
    if strange is not None:
        raise InvalidDescriptors(f"'{strange}' is not a channel of this map.", hint)
    return np.asarray([known[channel] for channel in given], dtype=np.uint8).reshape(n)
