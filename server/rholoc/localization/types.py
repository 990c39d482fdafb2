"""Queries to a localizer, and its answers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, StrEnum
from typing import Any

import numpy as np

from rholoc.features import Extractor, FeatureSet, widened
from rholoc.geometry import ByteArray, Camera, FloatArray, IntArray, Pose
from rholoc.lazy import lazy
from rholoc.localization.diagnosis import Diagnosis


class Dof(Enum):
    """Degrees of freedom to estimate."""

    AUTO = "auto"  # six; where the map's own views were upright, roll is improbable but not forbidden
    UPRIGHT = 5  # position and heading; the camera rolls by no more than a hand does: the paper's model
    FREE = 6  # position, heading and roll


class Intrinsics(StrEnum):
    """Knowledge of the camera's focal length."""

    GIVEN = "given"  # the query's camera holds
    UNKNOWN = "unknown"  # its focal length is only a guess, to be estimated along with the pose


class Reason(StrEnum):
    """Reason for a refusal."""

    NO_FEATURES = "no_features"  # the image has too few features: blank, dark or blurred
    NO_MATCHES = "no_matches"  # too few of its features look like any of the map's
    NO_AGREEMENT = "no_agreement"  # no pose explains enough of the matches
    NOT_RECOGNIZED = "not_recognized"  # a pose was found, but it is too improbably of the right place
    TOO_INEXACT = "too_inexact"  # the place was recognized, but the pose is less exact than was asked for
    DEADLINE = "deadline"  # the deadline passed before an answer was found


@dataclass(frozen=True)
class Prior:
    """Expected pose. A pose elsewhere is only returned if it is conclusive; ``near_prior`` is then False.

    Attributes:
        pose: the expected pose.
        radius_m: maximum distance of the position from it.
        radius_rad: maximum deviation of the heading from it.
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
        dof: degrees of freedom to estimate.
        prior: expected pose, or None.
        gravity: (3,) direction of gravity in the camera frame, pointing down, or None. Poses that deviate by more than
            10° are discarded. Ignored if the map is not known to be upright.
        deadline_s: time budget of the answer, or None.
        intrinsics: whether the camera's focal length is known.
        image: (H, W, 3) BGR, for the diagnosis of a refusal and for colours, or None.
        more_features: extracts more features if ``features`` do not suffice; None if ``features`` are complete.
        max_sigma_m: maximum standard deviation of the position along any axis.
        max_sigma_rad: maximum standard deviation of the rotation about any axis.
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
        """Query for a picture (H, W, 3) BGR. The extractor's quick features come first; more are extracted if they do
        not suffice.

        The extractor is widened for a panorama. ``others`` are further attributes of the query.
        """
        extractor = widened(extractor, camera)
        quick = extractor.quick
        more = None if quick is extractor else lambda: extractor.extract(image)
        return cls(quick.extract(image), camera, image=image, more_features=more, **others)

    @lazy
    def colours(self) -> ByteArray | None:
        """Red, green, blue (N, 3) uint8 at each feature; None if neither a colour picture nor colours were sent."""
        if self.features.colours is not None or self.image is None or self.image.ndim != 3:
            return self.features.colours
        return self.features.coloured(self.image).colours


@dataclass(frozen=True)
class Belief:
    """Belief in a pose.

    Attributes:
        recognized: probability 0 to 1 that the pose is of the right place: within 50 cm and 20° of the truth.
        exact: probability 0 to 1 that the pose is within 10 cm and 5° of the truth, given that the place is right.
    """

    recognized: float
    exact: float

    @property
    def confidence(self) -> float:
        """Probability 0 to 1 that the pose is within 10 cm and 5° of the truth."""
        return self.recognized * self.exact


NO_BELIEF = Belief(0.0, 0.0)
"""Of an answer without any candidate."""


MAX_ALTERNATIVES, MIN_WEIGHT = 4, 0.01
"""How many alternatives an answer has at most, and the least weight of each."""


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another possible pose of the frame.

    Attributes:
        weight: probability 0 to 1 that it is of the right place.
        pose: the pose.
        covariance: (6, 6) as in :class:`Localization`.
        inlier_features: (I,) rows of its inliers' landmarks in the map.
    """

    weight: float
    pose: Pose
    covariance: FloatArray
    inlier_features: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))


@dataclass(frozen=True, eq=False)
class Localization:
    """Answer for one frame.

    Attributes:
        localized: whether there is a pose to rely on.
        reason: reason for a refusal, else None.
        pose: the pose, or None.
        covariance: (6, 6) of position [m, map frame], then rotation [rad, a small rotation in the map frame from the
            left], including the map's own uncertainty there; or None.
        belief: belief in the pose, or in the one that was withheld.
        matches: number of matches considered.
        inliers: number of matches that agree with the pose.
        inlier_pixels: (I, 2) pixels of the inliers.
        inlier_features: (I,) rows of the inliers' landmarks in the map.
        timings_ms: milliseconds per stage: extract (more features), match, seed, ascend, verify, diagnose.
        near_prior: whether the pose agrees with the prior; None without a prior.
        camera: estimated camera, if its focal length was unknown.
        focal_sigma_px: standard deviation of the estimated focal length.
        diagnosis: likeliest cause of a refusal.
        map_trusted: whether the trajectory that the map was built on passed every check; None if the map does not say.
        expected_error_m: expected position error (root mean square) of the map itself at the pose; None if unknown or
            without a pose.
        alternatives: at most four other possible poses, likeliest first. A pose withheld as not recognized is the
            first. The weights of all poses add up to at most one; the remainder is the probability that none of them is
            right.
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

    @classmethod
    def refused(
        cls,
        reason: Reason,
        matches: int = 0,
        timings_ms: dict[str, float] | None = None,
        diagnosis: Diagnosis | None = None,
    ) -> Localization:
        """Answer without a pose.

        Args:
            reason: why there is none.
            matches: number of features that match the map.
            timings_ms: milliseconds by stage.
            diagnosis: the likeliest cause.
        """
        nothing = np.zeros(0, np.int64)
        return cls(
            False,
            reason,
            None,
            None,
            NO_BELIEF,
            matches,
            0,
            np.zeros((0, 2)),
            nothing,
            {} if timings_ms is None else timings_ms,
            diagnosis=diagnosis,
        )

    @property
    def recognized(self) -> float:
        """Probability 0 to 1 that the pose is of the right place: within 50 cm and 20° of the truth."""
        return self.belief.recognized

    @property
    def confidence(self) -> float:
        """Probability 0 to 1 that the pose is within 10 cm and 5° of the truth; at most ``recognized``."""
        return self.belief.confidence
