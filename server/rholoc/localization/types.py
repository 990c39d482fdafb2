"""What localization is asked and what it answers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from typing import Any

from rholoc.features import Extractor, FeatureSet, widened
from rholoc.geometry import ByteArray, Camera, FloatArray, IntArray, Pose
from rholoc.lazy import lazy
from rholoc.localization.diagnosis import Diagnosis


class Dof(Enum):
    """The degrees of freedom that are estimated."""

    AUTO = "auto"  # six; where the map's own views were upright, roll is improbable but not forbidden
    UPRIGHT = 5  # position and heading; the camera rolls by no more than a hand does: the paper's model
    FREE = 6  # position, heading and roll


class Intrinsics(StrEnum):
    """What is known of a camera."""

    GIVEN = "given"  # the query's camera holds
    UNKNOWN = "unknown"  # its focal length is only a guess, to be estimated along with the pose


class Reason(StrEnum):
    """Why there is no pose."""

    NO_FEATURES = "no_features"  # the image has too few features: blank, dark or blurred
    NO_MATCHES = "no_matches"  # too few of its features look like any of the map's
    NO_AGREEMENT = "no_agreement"  # no pose explains enough of the matches
    NOT_RECOGNIZED = "not_recognized"  # a pose was found, but it is too improbably of the right place
    TOO_INEXACT = "too_inexact"  # the place was recognized, but the pose is less exact than was asked for
    DEADLINE = "deadline"  # the deadline passed before an answer was found


@dataclass(frozen=True)
class Prior:
    """A pose that the answer is expected near. One that is elsewhere is given only where it is sure, and says so.

    Attributes:
        pose: the expected pose.
        radius_m: how far the position may be from it, metres.
        radius_rad: how far the heading may be from it, radians.
    """

    pose: Pose
    radius_m: float = 1.0
    radius_rad: float = 0.6


@dataclass(frozen=True)
class Query:
    """One frame to localize.

    Attributes:
        features: its features, by the map's own extractor.
        camera: its intrinsics.
        dof: what is estimated.
        prior: where the pose is expected, or None.
        gravity: (3,) the direction of gravity in the camera frame (down), or None. Poses that contradict it by more
            than 10° are not considered; in a map that is not known to be upright it says nothing.
        deadline_s: seconds that the answer may take, or None.
        intrinsics: whether the camera's focal length is known.
        image: the picture itself, (H, W, 3) BGR, for the diagnosis of a refusal and the features' colours; or None.
        more_features: finds more of them, and is asked where ``features`` do not suffice; None: those are all.
        max_sigma_m: the position's greatest standard deviation along any axis that is of use, metres.
        max_sigma_rad: the rotation's, radians.
    """

    features: FeatureSet
    camera: Camera
    dof: Dof = Dof.AUTO
    prior: Prior | None = None
    gravity: FloatArray | None = None
    deadline_s: float | None = None
    intrinsics: Intrinsics = Intrinsics.GIVEN
    image: ByteArray | None = None
    more_features: Callable[[], FeatureSet] | None = None
    max_sigma_m: float = math.inf
    max_sigma_rad: float = math.inf

    @classmethod
    def of_picture(cls, image: ByteArray, extractor: Extractor, camera: Camera, **others: Any) -> Query:
        """A picture (H, W, 3), BGR, its features found quickly at first; ``others`` are further attributes."""
        extractor = widened(extractor, camera)
        quick = extractor.quick
        more = None if quick is extractor else lambda: extractor.extract(image)
        return cls(quick.extract(image), camera, image=image, more_features=more, **others)

    @lazy
    def colours(self) -> ByteArray | None:
        """(N, 3) uint8, red, green and blue of the picture at each feature; None where they are not known."""
        if self.features.colours is not None or self.image is None or self.image.ndim != 3:
            return self.features.colours
        return self.features.coloured(self.image).colours


@dataclass(frozen=True)
class Belief:
    """How surely a pose is right.

    Attributes:
        recognized: 0..1, the probability that the pose is of the right place: within 50 cm and 20° of the truth.
        exact: 0..1, the probability that it is within 10 cm and 5° of the truth if the place is right.
    """

    recognized: float
    exact: float

    @property
    def confidence(self) -> float:
        """0..1, the probability that the pose is within 10 cm and 5° of the truth."""
        return self.recognized * self.exact


NO_BELIEF = Belief(0.0, 0.0)
"""Of an answer without any candidate."""


MAX_ALTERNATIVES, MIN_WEIGHT = 4, 0.01
"""How many alternatives an answer has at most, and the least weight of each."""


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another pose that the frame may have been taken from.

    Attributes:
        weight: 0..1, the probability that it is of the right place.
        pose: the pose.
        covariance: (6, 6) as of :class:`Localization`.
    """

    weight: float
    pose: Pose
    covariance: FloatArray


@dataclass(frozen=True, eq=False)
class Localization:
    """The answer for one frame.

    Attributes:
        localized: whether there is a pose to rely on.
        reason: why there is none, else None.
        pose: the pose, or None.
        covariance: (6, 6) of position (metres, map frame) and rotation (radians, a small rotation in the map frame
            applied from the left), in this order, or None. The map's own uncertainty at that place is part of it.
        belief: how surely the pose, or the one that was withheld, is right.
        matches: how many matches of features spoke.
        inliers: how many of them agree with the pose.
        inlier_pixels: (I, 2) pixels of those.
        inlier_features: (I,) their rows in the map.
        timings_ms: milliseconds by stage: extract (more features), match, seed, ascend, verify, diagnose.
        near_prior: whether the pose is where the prior expects it; None without a prior.
        camera: the camera as estimated, where its focal length was unknown.
        focal_sigma_px: one sigma of that focal length.
        diagnosis: the likeliest cause, where there is no pose.
        map_trusted: whether the frame poses that the map was built on passed every check; None where it does not say.
        expected_error_m: how far the map itself is expected to be off at the pose (root mean square, metres); None
            where the map does not know, or there is no pose.
        alternatives: at most four other poses that the frame may have been taken from, the likeliest first; a pose
            that was withheld as not recognized is the first of them. The weights of all poses add up to at most one;
            what is missing is the probability of none of them.
    """

    localized: bool
    reason: Reason | None
    pose: Pose | None
    covariance: FloatArray | None
    belief: Belief
    matches: int
    inliers: int
    inlier_pixels: FloatArray
    inlier_features: IntArray
    timings_ms: dict[str, float] = field(default_factory=dict)
    near_prior: bool | None = None
    camera: Camera | None = None
    focal_sigma_px: float | None = None
    diagnosis: Diagnosis | None = None
    map_trusted: bool | None = None
    expected_error_m: float | None = None
    alternatives: tuple[Alternative, ...] = ()

    @property
    def recognized(self) -> float:
        """0..1, the probability that the pose is of the right place: within 50 cm and 20° of the truth."""
        return self.belief.recognized

    @property
    def confidence(self) -> float:
        """0..1, the probability that the pose is within 10 cm and 5° of the truth; at most ``recognized``."""
        return self.belief.confidence
