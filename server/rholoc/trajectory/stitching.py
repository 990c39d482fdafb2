"""Pieces of a walk, each of a shape that pictures show but of unknown scale and place → one metric, upright walk.

What joins them is the IMU. With all rotations known, the equations of motion between keyframes are linear in the
keyframes' velocities, gravity, the accelerometer's bias and each piece's scale and place: one sparse least-squares
problem, however many pieces there are, and where pictures show nothing for a second or two the IMU alone carries the
walk across.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve

from rholoc.geometry import FloatArray, IntArray
from rholoc.recordings import Imu
from rholoc.trajectory.gyroscope import GyroCalibration, orientations
from rholoc.trajectory.inertial_alignment import GRAVITY
from rholoc.trajectory.tracks import Observations

_FEWEST_SHARED = 10  # points that two keyframes see, for them to be of one piece
_LEAST_PIECE = 3  # keyframes; smaller ones have no shape of their own
_BIAS_SIGMA = 0.3  # m/s²
_GRAVITY_SIGMA = 0.05  # m/s², once its direction is known
_NOISE = 0.03  # m/s² / √Hz, of the accelerometer and of all that the model leaves out
_PLACE_SIGMA_M = 0.004  # of a keyframe within its piece
_ROUNDS = 6
_CAUCHY = 2.0
_TOO_LONG_S = 10.0  # without a keyframe: the IMU carries nothing that far


@dataclass(frozen=True, eq=False)
class Stitched:
    """A walk in one frame, z up, metres.

    Attributes:
        up: (3,) in the frame of the rotations.
        positions: (K, 3) of the cameras, in the frame of the rotations.
        velocities: (K, 3).
        scales: (P,) metres per unit of each piece.
        scale_sigma: relative, of the largest piece.
        accelerometer_bias: (3,) m/s².
        residual: of the accelerations, rms, in units of the noise that is expected.
    """

    up: FloatArray
    positions: FloatArray
    velocities: FloatArray
    scales: FloatArray
    scale_sigma: float
    accelerometer_bias: FloatArray
    residual: float


def pieces_of(count: int, observations: Observations) -> IntArray:
    """The piece (K,) of each keyframe: keyframes that see ten points together are of one; -1 without one.

    Pieces are numbered from the largest on.
    """
    seen = coo_matrix(
        (np.ones(len(observations), np.float32), (observations.keyframes, observations.tracks)),
        shape=(count, max(observations.points, 1)),
    ).tocsr()
    shared = (seen @ seen.T).tocoo()
    strong = shared.data >= _FEWEST_SHARED
    graph = coo_matrix((shared.data[strong], (shared.row[strong], shared.col[strong])), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    sizes = np.bincount(label)
    order = np.argsort(-sizes, kind="stable")
    number = np.full(len(sizes), -1)
    large = order[sizes[order] >= _LEAST_PIECE]
    number[large] = np.arange(len(large))
    return number[label]


def stitch(
    times: FloatArray, R: FloatArray, positions: FloatArray, piece: IntArray, imu: Imu, gyro: GyroCalibration
) -> Stitched | None:
    """One walk from pieces; None where IMU and keyframes have too little time in common.

    Args:
        times: (K,) seconds, of the keyframes.
        R: (K, 3, 3) their rotations, in one frame for all pieces.
        positions: (K, 3) each in its piece's own frame and scale, turned as the rotations are.
        piece: (K,) which piece; keyframes of none are carried by the IMU alone.
    """
    t = times + gyro.time_offset_s
    inside = np.flatnonzero((t >= imu.times[0]) & (t <= imu.times[-1]))
    if len(inside) < 2 * _LEAST_PIECE or np.diff(t[inside]).max() > _TOO_LONG_S:
        return None
    a, b = inside[:-1], inside[1:]
    dt = t[b] - t[a]
    speed, way, by_bias_v, by_bias_p = _integrated(imu, gyro, t, R, a, b)
    count, pieces = len(times), int(piece.max()) + 1
    # unknowns: gravity, bias, each piece's scale and place, all velocities, positions of keyframes without a piece
    alone = np.flatnonzero(piece < 0)
    first_velocity = 6 + 4 * pieces
    first_alone = first_velocity + 3 * count
    place_of_alone = np.full(count, -1)
    place_of_alone[alone] = first_alone + 3 * np.arange(len(alone))
    unknowns = first_alone + 3 * len(alone)
    rows: list[IntArray] = []
    columns: list[IntArray] = []
    entries: list[FloatArray] = []

    def put(equation: IntArray, column: IntArray, entry: FloatArray) -> None:
        rows.append(equation.ravel())
        columns.append(np.broadcast_to(column, equation.shape).ravel())
        entries.append(np.broadcast_to(entry, equation.shape).ravel())

    n, axes = len(a), np.arange(3)
    of_speed = 3 * np.arange(n)[:, None] + axes
    of_way = 3 * n + of_speed
    put(of_speed, first_velocity + 3 * b[:, None] + axes, np.ones((n, 3)))
    put(of_speed, first_velocity + 3 * a[:, None] + axes, -np.ones((n, 3)))
    put(of_speed, axes, -dt[:, None] * np.ones((n, 3)))
    put(of_way, first_velocity + 3 * a[:, None] + axes, -dt[:, None] * np.ones((n, 3)))
    put(of_way, axes, -0.5 * dt[:, None] ** 2 * np.ones((n, 3)))
    for axis in range(3):
        put(of_speed, np.array(3 + axis), -by_bias_v[:, :, axis])
        put(of_way, np.array(3 + axis), -by_bias_p[:, :, axis])
    for ends, sign in ((b, 1.0), (a, -1.0)):
        with_piece = piece[ends] >= 0
        some, whose = ends[with_piece], piece[ends[with_piece]]
        put(of_way[with_piece], (6 + 4 * whose)[:, None], sign * positions[some])
        put(of_way[with_piece], (7 + 4 * whose)[:, None] + axes, np.full((len(some), 3), sign))
        lonely = ends[~with_piece]
        put(of_way[~with_piece], place_of_alone[lonely][:, None] + axes, np.full((len(lonely), 3), sign))
    measured = np.concatenate([speed.ravel(), way.ravel()])
    A = coo_matrix(
        (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))), shape=(6 * n, unknowns)
    ).tocsr()
    sigma_v = _NOISE * np.sqrt(dt)
    sigma_p = np.hypot(_NOISE * dt**1.5 / 1.7, _PLACE_SIGMA_M)
    weight = 1 / np.concatenate([np.repeat(sigma_v, 3), np.repeat(sigma_p, 3)])
    prior = np.full(unknowns, 1e-9)
    prior[3:6] = _BIAS_SIGMA**-2
    prior[7:10] = 1e6  # the first piece stays where it is
    toward = np.zeros(unknowns)
    robust = np.ones(2 * n)
    for round_ in range(_ROUNDS):
        weighted = diags_array(weight * np.sqrt(np.repeat(robust, 3))) @ A
        information = (weighted.T @ weighted).tocsc()
        information.setdiag(information.diagonal() + prior)
        right = weighted.T @ (measured * weight * np.sqrt(np.repeat(robust, 3))) + prior * toward
        x = spsolve(information, right)
        off = np.linalg.norm(((A @ x - measured) * weight).reshape(-1, 3), axis=1)
        typical = max(float(np.median(off)), 1.0)
        robust = 1 / (1 + (off / (_CAUCHY * typical)) ** 2)
        if round_ > 0:
            toward[:3] = x[:3] * GRAVITY / max(float(np.linalg.norm(x[:3])), 1e-9)
            prior[:3] = _GRAVITY_SIGMA**-2
    scales = x[6 : 6 + 4 * pieces : 4]
    own = np.zeros(unknowns)
    own[6] = 1
    sigma = float(np.sqrt(max(float(spsolve(information, own)[6]), 0.0))) * float(np.sqrt(np.mean(off**2) / 3))
    place = np.zeros((count, 3))
    known = piece >= 0
    place[known] = scales[piece[known], None] * positions[known] + x[7 + 4 * piece[known][:, None] + axes]
    place[alone] = x[place_of_alone[alone][:, None] + axes]
    velocities = x[first_velocity:first_alone].reshape(-1, 3)
    outside = np.setdiff1d(np.arange(count), inside)
    velocities[outside] = 0
    return Stitched(
        -x[:3] / np.linalg.norm(x[:3]),
        place,
        velocities,
        scales,
        sigma / max(abs(float(scales[0])), 1e-12),
        x[3:6],
        float(np.sqrt(np.mean(off**2) / 3)),
    )


def _integrated(
    imu: Imu, gyro: GyroCalibration, t: FloatArray, R: FloatArray, a: IntArray, b: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """What the force felt between keyframes ``a`` and ``b`` (N,) does: changes of velocity and displacements (N, 3).

    In the frame of the rotations; and their derivatives (N, 3, 3) by the accelerometer's bias.
    """
    R_start_imu = orientations(imu, gyro.bias).as_matrix()
    speed, way = np.zeros((len(a), 3)), np.zeros((len(a), 3))
    by_v, by_p = np.zeros((len(a), 3, 3)), np.zeros((len(a), 3, 3))
    for n, (i, j) in enumerate(zip(a.tolist(), b.tolist(), strict=True)):
        first = max(int(np.searchsorted(imu.times, t[i], side="right")) - 1, 0)
        last = max(int(np.searchsorted(imu.times, t[j])), first + 1)
        spans = np.minimum(imu.times[first + 1 : last + 1], t[j]) - np.maximum(imu.times[first:last], t[i])
        spans = np.maximum(spans, 0.0)
        R_world_start = R[i] @ gyro.R_camera_imu @ R_start_imu[first].T
        turned = R_world_start @ R_start_imu[first:last]
        here = np.minimum(np.arange(first, last) + 1, len(imu.times) - 1)
        felt = np.einsum("nij,nj->ni", turned, 0.5 * (imu.acceleration[first:last] + imu.acceleration[here]))
        v, w = np.zeros(3), np.zeros((3, 3))
        p, q = np.zeros(3), np.zeros((3, 3))
        for dt, f, Q in zip(spans.tolist(), felt, turned, strict=True):
            p += v * dt + 0.5 * f * dt * dt
            q += w * dt - 0.5 * Q * dt * dt
            v += f * dt
            w = w - Q * dt
        speed[n], way[n], by_v[n], by_p[n] = v, p, w, q
    return speed, way, by_v, by_p
