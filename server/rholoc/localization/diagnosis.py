"""Diagnosis of a refused frame: the likeliest cause, from the picture and from the best pose that the search found."""

import math
from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from rholoc.geometry import ByteArray
from rholoc.maps import Map

_DARK = 30.0  # of 255, the mean grey level
_DARKER, _BRIGHTER = 0.5, 1.8  # against the pictures that the map was made of
_TINT = 30.0  # of LAB's A and B together: beyond what lamps that are called white do to a room
_PERHAPS = 0.1  # minimum probability of the right place for a picture that may show the map after all
_WORK_WIDTH_PX = 640
_COARSE_PX = 8
_FLAT = 1.0  # grey levels of coarse contrast: below it there is nothing to be sharp or blurred
_BLUR_RATIO = 0.15  # fine against coarse contrast; a sharp picture of a room has more


class Cause(StrEnum):
    """Likeliest cause of a refusal."""

    TOO_DARK = "too_dark"  # the picture is nearly black
    BLURRED = "blurred"  # the camera moved or was out of focus
    TOO_LITTLE_TEXTURE = "too_little_texture"  # it shows a bare wall, floor or ceiling
    OTHER_LIGHT = "other_light"  # the light is far from that of the map's recording
    WRONG_CAMERA = "wrong_camera"  # another focal length explains the picture, the given one does not
    ROLLED = "rolled"  # the camera was rolled, and only upright poses were asked for
    WRONG_GRAVITY = "wrong_gravity"  # the only pose found contradicts the gravity that was sent
    WRONG_MOTION = "wrong_motion"  # several frames contradict the relative poses that were sent with them
    TOO_LITTLE_TIME = "too_little_time"  # the deadline passed
    INEXACT_MAP = "inexact_map"  # the place was found, but the map is not exact enough there
    TOO_INEXACT = "too_inexact"  # the place was recognized, but the pose is less exact than was asked for
    UNKNOWN_PLACE = "unknown_place"  # nothing of the map is to be seen


@dataclass(frozen=True)
class Diagnosis:
    """Likeliest cause of a refusal.

    Attributes:
        cause: for programs.
        message: one sentence for people: what is wrong.
        hint: one sentence for people: what to try.
    """

    cause: Cause
    message: str
    hint: str


INEXACT_MAP = Diagnosis(
    Cause.INEXACT_MAP,
    "The place was found, but the map itself may be off by more than half a metre there.",
    "Walk there again and update the map, or lower RHOLOC_MIN_RECOGNIZED.",
)
TOO_LITTLE_TIME = Diagnosis(
    Cause.TOO_LITTLE_TIME, "The deadline passed before all places were searched.", "Allow more time."
)


@dataclass(frozen=True)
class Agreement:
    """Agreement of a picture with the best pose that the search found.

    Attributes:
        inliers: number of matches that agree with the pose.
        matches: number of all matches.
        recognized: probability that the pose is of the right place, 0 to 1.
    """

    inliers: int
    matches: int
    recognized: float

    def __str__(self) -> str:
        if not self.matches:
            return "This picture does not show this map: nothing in it looks like anything there."
        count = f"{self.inliers} of {self.matches} matches agree"
        if self.recognized >= _PERHAPS:
            return f"Too little in this picture shows this map to be sure of the place: {count}."
        return f"This picture does not show this map: {count}, no better than chance."


@dataclass(frozen=True)
class Sight:
    """Photometric measurements of a picture.

    Attributes:
        brightness: mean grey level, 0 to 255.
        tint: distance of the mean colour from grey, in units of LAB's A and B.
        sharpness: contrast between adjacent pixels divided by contrast eight pixels apart, in the blurrier direction.
    """

    brightness: float
    tint: float
    sharpness: float


def sight_of(image: ByteArray) -> Sight:
    """Brightness, tint (0 for grey) and sharpness of an image (H, W, 3) BGR or (H, W), first shrunk to 640 px width."""
    height, width = image.shape[:2]
    if width > _WORK_WIDTH_PX:
        size = (_WORK_WIDTH_PX, max(1, round(height * _WORK_WIDTH_PX / width)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
    tint = 0.0
    if image.ndim == 3:
        mean = np.round(cv2.mean(image)[:3]).astype(np.uint8)
        lab = np.asarray(cv2.cvtColor(mean[None, None], cv2.COLOR_BGR2LAB))[0, 0].astype(np.float64)
        tint = float(np.hypot(lab[1] - 128, lab[2] - 128))
        image = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
    grey = np.asarray(cv2.GaussianBlur(image.astype(np.float32), (0, 0), 0.7), dtype=np.float32)
    return Sight(cv2.mean(grey)[0], tint, _sharpness(grey))


def diagnose_picture(image: ByteArray | None, map_: Map, features: int, fewest: int, agreement: Agreement) -> Diagnosis:
    """Likeliest cause of a refusal: darkness, blur and unusual light in the picture first, then too few features.
    Otherwise an unknown place.

    Args:
        image: the picture; None if only its features were sent.
        map_: the map in which it was localized.
        features: number of features in the picture.
        fewest: fewer features than this count as too little texture.
        agreement: agreement with the best pose found, from which the text on an unknown place is made.
    """
    if image is not None and (found := _from_sight(sight_of(image), map_, agreement)) is not None:
        return found
    if features < fewest:
        return Diagnosis(
            Cause.TOO_LITTLE_TEXTURE,
            "The picture shows hardly anything but a bare surface.",
            "Turn the camera towards furniture, pictures or shelves.",
        )
    return Diagnosis(
        Cause.UNKNOWN_PLACE,
        str(agreement),
        "Check that it is the right map, and look where the recording looked; or extend the map by a walk from here.",
    )


def too_inexact(sigma_m: float, sigma_rad: float, max_sigma_m: float, max_sigma_rad: float) -> Diagnosis:
    """Diagnosis of a pose whose standard deviations [m, rad] exceed the query's limits; names the position if that
    exceeds its limit.
    """
    if sigma_m > max_sigma_m:
        known, wanted, option = f"{sigma_m:.2g} m", f"{max_sigma_m:.2g} m", "max_sigma_m"
    else:
        known, wanted = f"{np.degrees(sigma_rad):.2g}°", f"{np.degrees(max_sigma_rad):.2g}°"
        option = "max_sigma_deg"
    return Diagnosis(
        Cause.TOO_INEXACT,
        f"The place was recognized, but the pose is only known to {known} (1σ); at most {wanted} was asked for.",
        f"Show more of the room, or closer things, or allow a larger {option}.",
    )


def wrong_camera(given_px: float, fitting_px: float) -> Diagnosis:
    """Diagnosis of a picture that another focal length [px] than the given one explains better."""
    return Diagnosis(
        Cause.WRONG_CAMERA,
        f"The camera's focal length looks wrong: about {fitting_px:.0f} px fits better than {given_px:.0f} px.",
        "Send the intrinsics of the picture as it is sent, after scaling and cropping; or ask with intrinsics unknown.",
    )


def wrong_motion(frame: int, apart_m: float, turned_rad: float) -> Diagnosis:
    """Diagnosis of a frame, counted from 0, that alone is somewhere else [m, rad] than with its relative pose."""
    return Diagnosis(
        Cause.WRONG_MOTION,
        f"Frame {frame} contradicts its relative pose: localized alone, it is {apart_m:.2f} m and "
        f"{np.degrees(turned_rad):.0f}° away.",
        "Send each frame's own position and rotation, camera to common frame (x right, y down, z forward), in metres; "
        "larger sigmas if they are inexact.",
    )


def _from_sight(sight: Sight, map_: Map, agreement: Agreement) -> Diagnosis | None:
    """Darkness, blur or light unlike the recording's; None if it is none of these."""
    if sight.brightness < _DARK:
        return Diagnosis(
            Cause.TOO_DARK,
            f"The picture is nearly black: its mean grey level is {sight.brightness:.0f} of 255.",
            "Switch on a light, or let the camera expose longer while it stands still.",
        )
    if sight.sharpness < _BLUR_RATIO:
        return Diagnosis(
            Cause.BLURRED,
            "The picture is blurred.",
            "Hold the camera still for the next picture, or shorten its exposure.",
        )
    was = _brightness_of(map_)
    if sight.tint > _TINT or (was and not _DARKER < sight.brightness / was < _BRIGHTER):
        than = f" (mean grey level {sight.brightness:.0f}, the recording's {was:.0f})" if was else ""
        return Diagnosis(
            Cause.OTHER_LIGHT,
            f"{agreement} Its light is unlike that of the map's recording{than}.",
            "Check that it is the right map; if it is, extend it by a walk in this light.",
        )
    return None


def _brightness_of(map_: Map) -> float:
    """Mean grey level of the recordings of a map; 0 if unknown."""
    known = [walk.figures.brightness for walk in map_.info.report.coaching]
    levels = [level for level in known if level is not None]
    return float(np.mean(levels)) if levels else 0.0


def _sharpness(grey: NDArray[np.float32]) -> float:
    """Fine contrast divided by coarse contrast, in the blurrier of the two directions (motion blurs along one). A
    direction with a coarse contrast of at most one grey level, as of a bare wall, is left out. Returns 1.0 if both are
    left out, or if a side is 8 px or shorter.
    """
    if min(grey.shape) <= _COARSE_PX:
        return 1.0
    planes = (grey, np.ascontiguousarray(grey.T))
    contrasts = [(_contrast(plane, 1), _contrast(plane, _COARSE_PX)) for plane in planes]
    return min((fine / coarse for fine, coarse in contrasts if coarse > _FLAT), default=1.0)


def _contrast(plane: NDArray[np.float32], apart: int) -> float:
    """Root mean square difference between rows that are ``apart`` rows from each other."""
    above, below = plane[:-apart], plane[apart:]
    return float(cv2.norm(above, below, cv2.NORM_L2)) / math.sqrt(above.size)
