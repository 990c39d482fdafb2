"""A pose propagated by an IMU alone: acceleration and rotation rate, integrated (strapdown navigation).

An error-state Kalman filter (Solà 2017, "Quaternion kinematics for the error-state Kalman filter", section 5, with the
rotation's error from the left): position, velocity, rotation, and the biases of both sensors. Good for a second or two;
answers correct it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rholoc_client.tracking.belief import symmetric
from rholoc_client.tracking.rigid import FloatArray, cross, motion_between, pose, rotation

GRAVITY_M_S2 = 9.81
_AVERAGED = 4.0
_VELOCITY, _ROTATION, _GYRO, _ACCELERATION = slice(3, 6), slice(6, 9), slice(9, 12), slice(12, 15)
_POSE = [0, 1, 2, 6, 7, 8]  # of the state, what an answer measures


@dataclass(frozen=True)
class ImuNoise:
    """How accurate an IMU is; the defaults are a phone's.

    Attributes:
        acceleration_m_s2, rate_rad_s: one sigma of a reading, times √second.
        acceleration_bias_m_s2, rate_bias_rad_s: one sigma of the biases at the start.
        acceleration_wander, rate_wander: by how much the biases change in a second (one sigma).
        velocity_m_s: one sigma of the velocity at the start, about which an answer says nothing.
    """

    acceleration_m_s2: float = 0.05
    rate_rad_s: float = 0.003
    acceleration_bias_m_s2: float = 0.2
    rate_bias_rad_s: float = 0.01
    acceleration_wander: float = 0.01
    rate_wander: float = 0.0005
    velocity_m_s: float = 0.7


@dataclass(frozen=True, eq=False)
class ImuReading:
    """One reading, in the camera's axes (x right, y down, z forward).

    Attributes:
        duration_s: the time that it covers.
        acceleration: (3,) m/s²; at rest it is gravity's reaction, 9.81 upwards.
        rate: (3,) the angular velocity, rad/s.
    """

    duration_s: float
    acceleration: FloatArray
    rate: FloatArray


@dataclass(frozen=True, eq=False)
class InertialBelief:
    """A pose propagated by an IMU; the map's z axis points up.

    Attributes:
        T_map_camera: (4, 4).
        velocity: (3,) m/s, map frame.
        rate_bias, acceleration_bias: (3,) each, in the camera's axes.
        state_covariance: (15, 15) of position, velocity, rotation and the two biases.
    """

    T_map_camera: FloatArray
    velocity: FloatArray
    rate_bias: FloatArray
    acceleration_bias: FloatArray
    state_covariance: FloatArray
    noise: ImuNoise

    @classmethod
    def at(cls, T_map_camera: FloatArray, covariance: FloatArray, noise: ImuNoise) -> InertialBelief:
        """The belief after a first answer, which says nothing about velocity and biases."""
        P = np.zeros((15, 15))
        P[_VELOCITY, _VELOCITY] = np.eye(3) * noise.velocity_m_s**2
        P[_GYRO, _GYRO] = np.eye(3) * noise.rate_bias_rad_s**2
        P[_ACCELERATION, _ACCELERATION] = np.eye(3) * noise.acceleration_bias_m_s2**2
        P[np.ix_(_POSE, _POSE)] = covariance
        return cls(T_map_camera, np.zeros(3), np.zeros(3), np.zeros(3), P, noise)

    @property
    def covariance(self) -> FloatArray:
        """(6, 6) of the pose."""
        return np.asarray(self.state_covariance[np.ix_(_POSE, _POSE)])

    def advanced(self, reading: ImuReading) -> InertialBelief:
        """After the time that a reading covers."""
        dt, R = reading.duration_s, self.T_map_camera[:3, :3]
        turn = (reading.rate - self.rate_bias) * dt
        midway = R @ rotation(turn / 2)
        force = midway @ (reading.acceleration - self.acceleration_bias)  # in the map frame
        acceleration = force - (0.0, 0.0, GRAVITY_M_S2)
        position = self.T_map_camera[:3, 3] + self.velocity * dt + acceleration * dt**2 / 2
        F = np.eye(15)
        F[:3, _VELOCITY] = np.eye(3) * dt
        F[_VELOCITY, _ROTATION] = -cross(force) * dt
        F[_VELOCITY, _ACCELERATION] = -midway * dt
        F[_ROTATION, _GYRO] = -midway * dt
        noise = self.noise
        added = np.zeros(15)
        added[_VELOCITY] = noise.acceleration_m_s2**2 * dt
        added[_ROTATION] = noise.rate_rad_s**2 * dt
        added[_GYRO] = noise.rate_wander**2 * dt
        added[_ACCELERATION] = noise.acceleration_wander**2 * dt
        return replace(
            self,
            T_map_camera=pose(R @ rotation(turn), position),
            velocity=self.velocity + acceleration * dt,
            state_covariance=symmetric(F @ self.state_covariance @ F.T) + np.diag(added),
        )

    def corrected(self, T_map_camera: FloatArray, covariance: FloatArray) -> InertialBelief:
        """After an answer."""
        P = self.state_covariance.copy()
        P[np.ix_(_POSE, _POSE)] += covariance / _AVERAGED
        H = np.zeros((6, 15))
        H[range(6), _POSE] = 1.0
        gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + covariance)
        error = gain @ motion_between(self.T_map_camera, T_map_camera)
        R = rotation(error[_ROTATION]) @ self.T_map_camera[:3, :3]
        return replace(
            self,
            T_map_camera=pose(R, self.T_map_camera[:3, 3] + error[:3]),
            velocity=self.velocity + error[_VELOCITY],
            rate_bias=self.rate_bias + error[_GYRO],
            acceleration_bias=self.acceleration_bias + error[_ACCELERATION],
            state_covariance=symmetric((np.eye(15) - gain @ H) @ P),
        )
