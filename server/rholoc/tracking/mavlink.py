"""A track for flight controllers: MAVLink 2's ODOMETRY over UDP, 40 times a second.

The three messages are encoded here: MAVLink's own Python library, pymavlink, is under the LGPL. Frames are forward,
right, down (FRD); where the map's place on Earth is known, the local frame is north, east,
down, and its origin is sent.
"""

from __future__ import annotations

import math
import socket
import struct
import threading
import time
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Any

import numpy as np

from rholoc.errors import InvalidInput
from rholoc.geometry import FloatArray, pose_matrix
from rholoc.maps import SiteOnEarth
from rholoc.tracking.follow import Step
from rholoc_client.tracking import TrackStatus
from rholoc_client.tracking.rigid import carried, in_radians, inverse, motion_between, moved, quaternion_of

RATE_HZ = 40.0
"""Messages a second; PX4 fuses nothing slower than 30."""

_HINT = "Give --mavlink HOST:PORT, such as 192.168.1.2:14550."
_SILENT_S = 0.3  # after a frame of this age nothing is sent
_ORIGIN_TIMES = 5  # at one a second: UDP loses messages
_R_FRD_FLU = np.diag([1.0, -1.0, -1.0])
_R_NED_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])

_SYSTEM, _COMPONENT = 1, 197  # MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY
_LOCAL_FRD, _BODY_FRD = 20, 12  # MAV_FRAME
_ESTIMATOR_VISION = 2
_ONBOARD_CONTROLLER, _NO_AUTOPILOT, _ACTIVE = 18, 8, 4


@dataclass(frozen=True)
class _Kind:
    """A message: its id, the seed of its checksum, and the layout of its fields in wire order."""

    id: int
    seed: int
    layout: str


_HEARTBEAT = _Kind(0, 50, "<IBBBBB")
_SET_ORIGIN = _Kind(48, 41, "<iiiBQ")
_ODOMETRY = _Kind(331, 91, "<Q3f4f3f3f21f21fBBBBb")


class Encoder:
    """Numbers and encodes messages of one sender."""

    def __init__(self) -> None:
        self._sequence = 0

    def heartbeat(self) -> bytes:
        """HEARTBEAT of an onboard computer; takes the next sequence number."""
        return self._encoded(_HEARTBEAT, 0, _ONBOARD_CONTROLLER, _NO_AUTOPILOT, 0, _ACTIVE, 3)

    def origin(self, earth: SiteOnEarth, time_s: float) -> bytes:
        """SET_GPS_GLOBAL_ORIGIN at ``time_s`` [s since 1970].

        The message's altitude should be above mean sea level. Without a model of the geoid it is the height above the
        ellipsoid of WGS 84 as given, which differs by the geoid's height: -106 m to 85 m.
        """
        degrees = (round(earth.latitude_deg * 1e7), round(earth.longitude_deg * 1e7))
        return self._encoded(_SET_ORIGIN, *degrees, round(earth.height_m * 1000), _SYSTEM, round(time_s * 1e6))

    def odometry(
        self, time_s: float, T_local_body: FloatArray, covariance: FloatArray, reset_counter: int, quality: float
    ) -> bytes:
        """ODOMETRY without velocities.

        Args:
            time_s: since 1970.
            T_local_body: (4, 4), both forward, right, down.
            covariance: (6, 6) of position [m] and rotation [rad] along the local axes.
            reset_counter: of the track.
            quality: 0 to 1.
        """
        x, y, z, w = quaternion_of(T_local_body[:3, :3])
        unknown = [math.nan] * 6
        return self._encoded(
            _ODOMETRY, round(time_s * 1e6), *T_local_body[:3, 3].tolist(), w, x, y, z, *unknown,
            *covariance[np.triu_indices(6)].tolist(), math.nan, *[0.0] * 20,
            _LOCAL_FRD, _BODY_FRD, reset_counter % 256, _ESTIMATOR_VISION, max(1, round(100 * quality)),
        )  # fmt: skip

    def _encoded(self, kind: _Kind, *fields: float) -> bytes:
        """A MAVLink 2 packet; takes the next sequence number."""
        payload = struct.pack(kind.layout, *fields).rstrip(b"\0") or b"\0"
        header = struct.pack("<BBBBBB", len(payload), 0, 0, self._sequence, _SYSTEM, _COMPONENT)
        body = header + kind.id.to_bytes(3, "little") + payload
        self._sequence = (self._sequence + 1) % 256
        return b"\xfd" + body + _checksum(body + bytes([kind.seed])).to_bytes(2, "little")


def _checksum(data: bytes) -> int:
    """CRC-16/MCRF4XX of the data."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0x8408 if crc & 1 else crc >> 1
    return crc


@dataclass(frozen=True, eq=False)
class _Known:
    """The last pose, the arrival time of its frame on the monotonic clock [s], and the velocity (6,) [m/s, rad/s]."""

    time_s: float
    arrived_s: float
    T_local_body: FloatArray
    covariance: FloatArray
    reset_counter: int
    quality: float
    velocity: FloatArray

    def at(self, now_s: float) -> tuple[float, FloatArray]:
        """Time [s] and pose (4, 4) at ``now_s`` of the monotonic clock, extrapolated at constant velocity."""
        since_s = now_s - self.arrived_s
        return self.time_s + since_s, moved(self.T_local_body, self.velocity * since_s)


class MavlinkSender:
    """Sends a track's poses from a thread, between frames at constant velocity; silent while searching or lost.

    Raises:
        InvalidInput: the address is malformed, or its host is unknown.

    Args:
        address: ``HOST:PORT`` of the flight controller or its router.
        T_base_camera: (4, 4) the camera's mounting; base has x forward, y left, z up.
        earth: the map's pose on Earth, or None.
    """

    def __init__(self, address: str, T_base_camera: FloatArray, earth: SiteOnEarth | None) -> None:
        host, _, port = address.rpartition(":")
        if not host or not port.isdecimal() or not 0 < int(port) < 65536:
            raise InvalidInput(f"'{address}' is not HOST:PORT.", _HINT)
        try:
            family, kind, _, _, found = socket.getaddrinfo(host, int(port), type=socket.SOCK_DGRAM)[0]
        except (OSError, UnicodeError) as error:
            raise InvalidInput(f"There is no host {host}.", _HINT) from error
        self._address: Any = found
        self._socket = socket.socket(family, kind)
        self._T_camera_base, self._earth = inverse(T_base_camera), earth
        self._R_local_map = _R_FRD_FLU if earth is None else _R_NED_ENU @ earth.R_enu_site
        self._encoder = Encoder()
        self._known: _Known | None = None
        self._quality = 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._send, name="mavlink", daemon=True)

    def __enter__(self) -> MavlinkSender:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()

    def take(self, step: Step) -> None:
        """Send the step's pose from now on, with the velocity since the last step; nothing unless it is tracking.

        The velocity is 0 after a reset, or if the last step is 0.3 s older or more.
        """
        if step.answer is not None and step.answer.localization is not None:
            self._quality = step.answer.localization.recognized
        tracked, before = step.tracked, self._known
        if tracked.status is not TrackStatus.TRACKING or tracked.pose is None or tracked.covariance is None:
            self._known = None
            return
        T_map_camera = np.array(tracked.pose.T_map_camera)
        T_map_base = T_map_camera @ self._T_camera_base
        covariance = carried(in_radians(tracked.covariance), T_map_base[:3, 3] - T_map_camera[:3, 3])
        turn = np.kron(np.eye(2), self._R_local_map)
        local = pose_matrix(self._R_local_map, np.zeros(3)) @ T_map_base @ pose_matrix(_R_FRD_FLU, np.zeros(3))
        now = _Known(
            step.moment.time_s, time.monotonic(), local, turn @ covariance @ turn.T, tracked.reset_counter,
            self._quality, np.zeros(6),
        )  # fmt: skip
        if before is not None and before.reset_counter == now.reset_counter:
            passed_s = now.time_s - before.time_s
            if 0 < passed_s < _SILENT_S:
                now = replace(now, velocity=motion_between(before.T_local_body, local) / passed_s)
        self._known = now

    def _send(self) -> None:
        """Until stopped, send odometry at ``RATE_HZ``, each second a heartbeat, and five times the origin."""
        begun_s, count, origins = time.monotonic(), 0, 0
        while not self._stop.wait(max(0.0, begun_s + count / RATE_HZ - time.monotonic())):
            known, now_s = self._known, time.monotonic()
            messages = []
            if count % round(RATE_HZ) == 0:
                messages.append(self._encoder.heartbeat())
                if known is not None and self._earth is not None and origins < _ORIGIN_TIMES:
                    messages.append(self._encoder.origin(self._earth, known.at(now_s)[0]))
                    origins += 1
            if known is not None and now_s - known.arrived_s < _SILENT_S:
                time_s, T = known.at(now_s)
                messages.append(self._encoder.odometry(time_s, T, known.covariance, known.reset_counter, known.quality))
            for message in messages:
                self._deliver(message)
            count += 1

    def _deliver(self, message: bytes) -> None:
        """Send over UDP, ignoring errors."""
        try:
            self._socket.sendto(message, self._address)
        except OSError:  # nobody listens yet, or the network is down: the next message may arrive
            return
