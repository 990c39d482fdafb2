"""Hand-held walks through the test site, smooth enough that accelerations are finite, and what an IMU measures."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from rholoc.geometry import FloatArray, Pose, pose_matrix
from rholoc.recordings import GRAVITY, Imu, Waypoint

WAYPOINT_NAMES = ("START", "W1", "W2", "W3", "E")
SHORTEST_WALK_S = 30.0  # in less, the way could not be walked at a walking phone's speed
PAUSE_S = 1.2
R_CAMERA_IMU = np.diag([1.0, -1.0, -1.0])  # a phone's x points right, y up, z out of its screen, at the user

# Where the camera is at the waypoints, metres in the map frame; E is the last.
_STATIONS_M = np.array(
    [[0.0, 0.0, 0.0], [0.05, 1.45, 0.06], [0.65, 2.45, -0.05], [2.15, 2.6, 0.05], [3.35, 2.5, -0.02]]
)
# Where it looks there and half-way between; yaw from the map's x axis, counter-clockwise.
_YAW_DEG = np.array([65.0, 25.0, 85.0, 150.0, 205.0, 265.0, 322.0, 382.0, 432.0])
_PITCH_DEG = np.array([-6.0, -12.0, -6.0, -10.0, -9.0, -5.0, -12.0, -8.0, -5.0])
_RAMP = 0.28  # the share of a leg in which the walker speeds up, and again slows down
_BOB_M = 0.012
_BOB_HZ = 1.8
_BOB_SPEED_M_S = 0.15  # at which the bob is two thirds of its full height
_STEP_S = 1e-3  # of numerical differentiation
_TONES = 7  # sinusoids of each channel of a wobble
_WAYPOINT_NOISE_M = 0.005


@dataclass(frozen=True, eq=False)
class Wobble:
    """Smooth small motion: sums of sinusoids, (channels, tones)."""

    amplitudes: FloatArray
    frequencies_hz: FloatArray
    phases: FloatArray

    @classmethod
    def draw(cls, rng: np.random.Generator, rms: FloatArray, low_hz: float, high_hz: float) -> Wobble:
        """Random wobble with a channel for each root mean square in ``rms``, its tones between these frequencies."""
        amplitudes = rng.uniform(0.5, 1.0, (len(rms), _TONES))
        amplitudes *= (np.asarray(rms) * np.sqrt(2) / np.linalg.norm(amplitudes, axis=1))[:, None]
        frequencies = np.exp(rng.uniform(np.log(low_hz), np.log(high_hz), amplitudes.shape))
        return cls(amplitudes, frequencies, rng.uniform(0, 2 * np.pi, amplitudes.shape))

    def __call__(self, times: FloatArray) -> FloatArray:
        """Values (N, channels) at times (N,) [s]."""
        angle = 2 * np.pi * self.frequencies_hz * np.asarray(times)[:, None, None] + self.phases
        return np.asarray((self.amplitudes * np.sin(angle)).sum(axis=2))


@dataclass(frozen=True, eq=False)
class Motion(ABC):
    """Motion of a carried phone, with poses in the map frame at any time.

    Attributes:
        number: 1 is the walk that the map frame's origin belongs to.
        sway: metres, 3 channels; ``tremble``: radians, of yaw, pitch and roll.
        origin: (3,) metres, taken off all positions.
    """

    number: int
    sway: Wobble
    tremble: Wobble
    origin: FloatArray

    @property
    @abstractmethod
    def pause_times(self) -> FloatArray:
        """Times [s] of the middle of the pause at each waypoint."""

    @property
    @abstractmethod
    def waypoint_names(self) -> tuple[str, ...]:
        """The name of the waypoint of each pause."""

    @abstractmethod
    def way(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions on the path (N, 3) [m], without sway, and speeds (N,) [m/s], at times (N,) [s]."""

    @abstractmethod
    def gaze_at(self, times: FloatArray) -> FloatArray:
        """Yaw and pitch (N, 2) [rad] at times (N,) [s]."""

    def positions(self, times: FloatArray) -> FloatArray:
        """Positions (N, 3) [m] of the camera, map frame, at times (N,) [s]: the way, with sway and bobbing."""
        times = np.asarray(times, dtype=np.float64)
        way, speed = self.way(times)
        position = way + self.sway(times)
        lift = 1 - np.exp(-((speed / _BOB_SPEED_M_S) ** 2))
        position[:, 2] += _BOB_M * lift * np.sin(2 * np.pi * _BOB_HZ * times)
        return np.asarray(position - self.origin)

    def rotations(self, times: FloatArray) -> FloatArray:
        """R_map_camera (N, 3, 3) at times (N,) [s]."""
        times = np.asarray(times, dtype=np.float64)
        yaw, pitch = self.gaze_at(times).T
        d_yaw, d_pitch, roll = self.tremble(times).T
        yaw, pitch = yaw + d_yaw, pitch + d_pitch
        zero = np.zeros_like(yaw)
        z = np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)], axis=1)
        x = np.stack([np.sin(yaw), -np.cos(yaw), zero], axis=1)
        y = np.cross(z, x)
        upright = np.stack([x, y, z], axis=2)
        return np.asarray(upright @ Rotation.from_rotvec(np.stack([zero, zero, roll], axis=1)).as_matrix())

    def T_map_camera(self, times: FloatArray) -> FloatArray:
        """T_map_camera (N, 4, 4) at times (N,) [s]."""
        return pose_matrix(self.rotations(times), self.positions(times))

    def poses(self, times: FloatArray) -> list[Pose]:
        """List of N poses at times (N,) [s]."""
        return [Pose(T) for T in self.T_map_camera(times)]

    def accelerations(self, times: FloatArray) -> FloatArray:
        """Accelerations (N, 3) [m/s²] in the map frame, without gravity, at times (N,) [s]."""
        p = [self.positions(np.asarray(times) + k * _STEP_S) for k in (-2, -1, 0, 1, 2)]
        return np.asarray((-p[0] + 16 * p[1] - 30 * p[2] + 16 * p[3] - p[4]) / (12 * _STEP_S**2))

    def angular_velocities(self, times: FloatArray) -> FloatArray:
        """Angular velocities (N, 3) [rad/s] in the camera frame at times (N,) [s]."""
        before = Rotation.from_matrix(self.rotations(np.asarray(times) - _STEP_S))
        after = Rotation.from_matrix(self.rotations(np.asarray(times) + _STEP_S))
        return np.asarray((before.inv() * after).as_rotvec() / (2 * _STEP_S))


@dataclass(frozen=True, eq=False)
class Walk(Motion):
    """Path through the test site, and its timing.

    Attributes:
        departures, arrivals: (4,) seconds, of each leg; in between and at both ends the walker stands still.
        path: metres walked → (x, y, z); ``gaze``: metres walked → (yaw, pitch) in radians.
        stations: (5,) metres walked at the waypoints.
    """

    departures: FloatArray
    arrivals: FloatArray
    stations: FloatArray
    path: CubicSpline
    gaze: CubicSpline

    @property
    def pause_times(self) -> FloatArray:
        """Times (5,) [s] of the middle of the pause at each waypoint; the last counts as ``PAUSE_S`` long."""
        return np.concatenate(
            [
                [0.5 * self.departures[0]],
                0.5 * (self.arrivals[:-1] + self.departures[1:]),
                [self.arrivals[-1] + 0.5 * PAUSE_S],
            ]
        )

    @property
    def waypoint_names(self) -> tuple[str, ...]:
        """``START``, ``W1`` … ``E``."""
        return WAYPOINT_NAMES

    def way(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions on the path (N, 3) [m], without sway, and speeds (N,) [m/s], at times (N,) [s]."""
        walked, speed = self._progress(times)
        return self.path(walked), speed

    def gaze_at(self, times: FloatArray) -> FloatArray:
        """Yaw and pitch (N, 2) [rad] at times (N,) [s]."""
        return np.asarray(self.gaze(self._progress(times)[0]))

    def _progress(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Metres walked (N,) and speeds (N,) [m/s] at times (N,) [s]."""
        walked = np.full(len(times), self.stations[0])
        speed = np.zeros(len(times))
        for start, end, a, b in zip(self.departures, self.arrivals, self.stations[:-1], self.stations[1:], strict=True):
            share, rate = _leg((times - start) / (end - start))
            walked += (b - a) * share
            speed += (b - a) / (end - start) * rate
        return walked, speed


def make_walk(number: int = 1, seconds: float = 30.0, seed: int = 0) -> Walk:
    """The walk ``START``, ``W1``, ``W2``, ``W3``, ``E``, with a pause at each, that takes ``seconds``.

    Walk 1 starts at the map frame's origin. The others go the same way, 0.2–0.5 m to the side, at other speeds and
    looking elsewhere at other times. A walk takes at least ``SHORTEST_WALK_S``; a shorter recording ends on the way.
    """
    rng = np.random.default_rng([seed, number])
    seconds = max(seconds, SHORTEST_WALK_S)
    stations_m, yaw_deg, pitch_deg = _STATIONS_M.copy(), _YAW_DEG.copy(), _PITCH_DEG.copy()
    if number != 1:
        side = 1.0 if number % 2 == 0 else -1.0
        along = np.gradient(stations_m[:, :2], axis=0)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        across = np.column_stack([along[:, 1], -along[:, 0]]) * side
        stations_m[:, :2] += across * rng.uniform(0.22, 0.36, (5, 1)) + along * rng.uniform(-0.15, 0.15, (5, 1))
        stations_m[:, 2] += rng.uniform(-0.08, 0.08, 5)
        yaw_deg += rng.uniform(-4, 4, len(yaw_deg)) + rng.uniform(-12, 12)
        pitch_deg += rng.uniform(-3, 3, len(pitch_deg))
    lengths = np.linalg.norm(np.diff(stations_m, axis=0), axis=1)
    walked = np.concatenate([[0.0], np.cumsum(lengths)])
    turned = np.abs(np.diff(yaw_deg)).reshape(-1, 2).sum(axis=1)
    weights = np.maximum(lengths / 0.3, turned / 20.0) * rng.uniform(0.95, 1.05, len(lengths))
    legs_s = weights / weights.sum() * (seconds - len(stations_m) * PAUSE_S)
    departures = PAUSE_S * np.arange(1, len(lengths) + 1) + np.concatenate([[0.0], np.cumsum(legs_s)[:-1]])
    knots = np.interp(np.arange(len(yaw_deg)) / 2, np.arange(len(walked)), walked)
    walk = Walk(
        number=number,
        departures=departures,
        arrivals=departures + legs_s,
        stations=walked,
        path=CubicSpline(walked, stations_m),
        gaze=CubicSpline(knots, np.radians(np.column_stack([yaw_deg, pitch_deg]))),
        sway=Wobble.draw(rng, np.array([0.003, 0.003, 0.002]), 0.3, 2.0),
        tremble=Wobble.draw(rng, np.radians([0.35, 0.35, 0.3]), 0.3, 2.0),
        origin=np.zeros(3),
    )
    if number != 1:
        return walk
    return replace(walk, origin=walk.positions(np.zeros(1))[0])


def measure_waypoints(walk: Motion, seconds: float, seed: int = 0) -> tuple[Waypoint, ...]:
    """The waypoints that the first ``seconds`` of the walk reach, as a person would measure them (with 5 mm of noise).

    The first walk's ``START`` is the origin by definition. Other walks stop at other places, named ``2.W1`` and so on.
    """
    rng = np.random.default_rng([seed, walk.number, 1])
    times = walk.pause_times
    measured = walk.positions(times) + rng.normal(0, _WAYPOINT_NOISE_M, (len(times), 3))
    if walk.number == 1:
        measured[0] = 0.0
    prefix = "" if walk.number == 1 else f"{walk.number}."
    return tuple(
        Waypoint(prefix + name, float(time), (float(p[0]), float(p[1]), float(p[2])))
        for name, time, p in zip(walk.waypoint_names, times, measured, strict=True)
        if time < seconds
    )


@dataclass(frozen=True)
class ImuErrors:
    """Errors of a phone's IMU: standard deviations of constant random biases, and white noise."""

    accelerometer_bias_m_s2: float = 0.05
    gyroscope_bias_rad_s: float = 0.005
    accelerometer_noise_m_s2: float = 0.02
    gyroscope_noise_rad_s: float = 0.002


def measure_imu(
    walk: Motion,
    seconds: float,
    rate_hz: float = 100.0,
    errors: ImuErrors | None = None,
    time_offset_s: float = 0.0,
    seed: int = 0,
) -> Imu:
    """Readings of the phone's IMU in the first ``seconds``, including gravity's reaction; ``errors`` None: a phone's
    usual ones.

    A reading stamped t was taken at t − ``time_offset_s`` on the video's clock.
    """
    errors = errors or ImuErrors()
    rng = np.random.default_rng([seed, walk.number, 2])
    times = np.arange(0.0, seconds + 0.5 / rate_hz, 1 / rate_hz)
    taken = times - time_offset_s
    R_imu_map = R_CAMERA_IMU.T @ np.swapaxes(walk.rotations(taken), 1, 2)
    force = walk.accelerations(taken) + np.array([0.0, 0.0, GRAVITY])
    acceleration = np.einsum("nij,nj->ni", R_imu_map, force)
    angular_velocity = walk.angular_velocities(taken) @ R_CAMERA_IMU
    acceleration += rng.normal(0, errors.accelerometer_bias_m_s2, 3)
    acceleration += rng.normal(0, errors.accelerometer_noise_m_s2, acceleration.shape)
    angular_velocity += rng.normal(0, errors.gyroscope_bias_rad_s, 3)
    angular_velocity += rng.normal(0, errors.gyroscope_noise_rad_s, angular_velocity.shape)
    return Imu(times, acceleration, angular_velocity, True, R_CAMERA_IMU.copy())


def _leg(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Share (N,) of a leg's path after the share ``x`` (N,) of its time, clipped to 0..1, and its derivative."""
    top = 1 / (1 - _RAMP)
    x = np.clip(x, 0.0, 1.0)
    up, down = np.clip(x / _RAMP, 0, 1), np.clip((1 - x) / _RAMP, 0, 1)
    rate = top * np.minimum(up * up * (3 - 2 * up), down * down * (3 - 2 * down))
    ramp_up = _RAMP * (up**3 - 0.5 * up**4)
    ramp_down = _RAMP * (0.5 - (down**3 - 0.5 * down**4))
    cruise = np.clip(x - _RAMP, 0, 1 - 2 * _RAMP)
    return top * (ramp_up + cruise + ramp_down), rate
