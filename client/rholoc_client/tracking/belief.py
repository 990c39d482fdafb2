"""The belief about a camera's pose in the map, a Gaussian: propagated by odometry, corrected by answers.

A Kalman filter on the error of the pose. The error is a small motion in the map frame (:mod:`.rigid`), as in the
service's covariances, so that an answer is a measurement of the whole state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from rholoc_client.tracking.rigid import FloatArray, carried, inverse, motion_between, moved, rotation

_AVERAGED = 4.0  # successive answers have correlated errors, so that none ever weighs less than a fifth of the belief
_FADING_S = 1.5  # without odometry, the assumed velocity decays over this time
_FOLLOWING_S = 0.1  # over which the velocity follows odometry's
_LEARNED, _MIN_BLIND_S = 0.8, 0.2  # how much of a wrong guess is attributed to the velocity
_WANDER_M_S, _WANDER_RAD_S = 0.4, 0.6  # by how much a hand's velocity changes while there is no odometry


@dataclass(frozen=True)
class OdometryNoise:
    """How accurate odometry is.

    Attributes:
        drift: one sigma of a distance travelled, as a share of it: 0.02 is 2 %.
        turn_drift: one sigma of an angle turned, as a share of it.
        heading_drift_deg_m: one sigma of the heading after a metre travelled, degrees.
        step_m, step_deg: one sigma of what every single step adds, however small: the noise of the sensor.
    """

    drift: float = 0.02
    turn_drift: float = 0.01
    heading_drift_deg_m: float = 0.5
    step_m: float = 0.0005
    step_deg: float = 0.02


@dataclass(frozen=True, eq=False)
class Step:
    """How a camera moved since the frame before.

    Attributes:
        duration_s: how long it took.
        T_before_now: (4, 4) the camera's pose in that of the frame before; None where it is not known.
    """

    duration_s: float
    T_before_now: FloatArray | None


class Belief(Protocol):
    """The belief about a camera's pose in the map."""

    @property
    def T_map_camera(self) -> FloatArray:
        """(4, 4)."""
        ...

    @property
    def covariance(self) -> FloatArray:
        """(6, 6) of the pose: position in metres, rotation in radians."""
        ...

    def corrected(self, T_map_camera: FloatArray, covariance: FloatArray) -> Belief:
        """After an answer (4, 4) of some covariance (6, 6)."""
        ...


@dataclass(frozen=True, eq=False)
class PoseBelief:
    """A pose propagated by odometry.

    Attributes:
        T_map_camera: (4, 4).
        covariance: (6, 6).
        noise: the odometry's.
        velocity: (6,) the motion of a second in the camera frame, for when odometry fails.
        travelled_m, turned_rad: since the last answer: drift grows with the distance, not with its root.
        blind_s: for how long the camera's motion has not been known.
    """

    T_map_camera: FloatArray
    covariance: FloatArray
    noise: OdometryNoise
    velocity: FloatArray
    travelled_m: float = 0.0
    turned_rad: float = 0.0
    blind_s: float = 0.0

    @classmethod
    def at(cls, T_map_camera: FloatArray, covariance: FloatArray, noise: OdometryNoise) -> PoseBelief:
        """The belief after a first answer."""
        return cls(T_map_camera, covariance, noise, np.zeros(6))

    def advanced(self, step: Step) -> PoseBelief:
        """After the camera moved."""
        return self._guessed(step.duration_s) if step.T_before_now is None else self._carried(step)

    def _carried(self, step: Step) -> PoseBelief:
        assert step.T_before_now is not None
        T = self.T_map_camera @ step.T_before_now
        motion = motion_between(np.eye(4), step.T_before_now)
        moved_m, turned_rad = float(np.linalg.norm(motion[:3])), float(np.linalg.norm(motion[3:]))
        noise, way_m, way_rad = self.noise, self.travelled_m + moved_m, self.turned_rad + turned_rad
        position = _grown(noise.drift, self.travelled_m, way_m) + noise.step_m**2
        angle = (
            _grown(noise.turn_drift, self.turned_rad, way_rad)
            + _grown(math.radians(noise.heading_drift_deg_m), self.travelled_m, way_m)
            + math.radians(noise.step_deg) ** 2
        )
        covariance = carried(self.covariance, T[:3, 3] - self.T_map_camera[:3, 3])
        covariance = covariance + np.diag([position] * 3 + [angle] * 3)
        share = min(1.0, step.duration_s / _FOLLOWING_S)
        velocity = (1 - share) * self.velocity + share * motion / max(step.duration_s, 1e-6)
        return replace(
            self,
            T_map_camera=T,
            covariance=covariance,
            velocity=velocity,
            travelled_m=way_m,
            turned_rad=way_rad,
            blind_s=0.0,
        )

    def _guessed(self, duration_s: float) -> PoseBelief:
        """After some time without odometry, in which the camera is assumed to go on as before and slow down."""
        fading = math.exp(-self.blind_s / _FADING_S)
        motion = self.velocity * fading * duration_s
        T = self.T_map_camera.copy()
        T[:3, 3] += T[:3, :3] @ motion[:3]
        T[:3, :3] = T[:3, :3] @ rotation(motion[3:])
        blind_s = self.blind_s + duration_s
        # The velocity's error grows as the square root of time, and the position's error is its integral.
        position, angle = (
            (wander * blind_s**1.5) ** 2 - (wander * self.blind_s**1.5) ** 2 for wander in (_WANDER_M_S, _WANDER_RAD_S)
        )
        covariance = carried(self.covariance, T[:3, 3] - self.T_map_camera[:3, 3])
        covariance = covariance + np.diag([position] * 3 + [angle] * 3)
        return replace(self, T_map_camera=T, covariance=covariance, blind_s=blind_s)

    def corrected(self, T_map_camera: FloatArray, covariance: FloatArray) -> PoseBelief:
        """After an answer."""
        prior = self.covariance + covariance / _AVERAGED
        gain = prior @ np.linalg.inv(prior + covariance)
        motion = gain @ motion_between(self.T_map_camera, T_map_camera)
        posterior = symmetric((np.eye(6) - gain) @ prior)
        T, velocity = moved(self.T_map_camera, motion), self.velocity
        if self.blind_s > 0:  # what was wrong in that time was the guessed velocity
            missed = np.concatenate([T[:3, :3].T @ motion[:3], T[:3, :3].T @ motion[3:]])
            velocity = velocity + _LEARNED * missed / max(self.blind_s, _MIN_BLIND_S)
        return replace(
            self, T_map_camera=T, covariance=posterior, velocity=velocity, travelled_m=0.0, turned_rad=0.0, blind_s=0.0
        )


def squared_distance(belief: Belief, T_map_camera: FloatArray, covariance: FloatArray) -> float:
    """The squared Mahalanobis distance between an answer and the belief, by the covariances of both: χ² with six
    degrees of freedom if both are right."""
    apart = motion_between(belief.T_map_camera, T_map_camera)
    spread = belief.covariance + covariance * (1 + 1 / _AVERAGED)
    return float(apart @ np.linalg.solve(spread, apart))


def alignment(belief: Belief, T_odom_camera: FloatArray) -> tuple[FloatArray, FloatArray]:
    """T_map_odom (4, 4) and its covariance (6, 6), of the origin of odometry's frame."""
    T_map_odom = belief.T_map_camera @ inverse(T_odom_camera)
    return T_map_odom, carried(belief.covariance, T_map_odom[:3, 3] - belief.T_map_camera[:3, 3])


def symmetric(matrix: FloatArray) -> FloatArray:
    """A matrix without the asymmetry that comes from rounding."""
    return np.asarray((matrix + matrix.T) / 2)


def _grown(rate: float, before: float, after: float) -> float:
    """By how much a variance grows whose sigma is ``rate`` times the distance."""
    return rate**2 * (after**2 - before**2)
