"""Walks through the building of many rooms: along the corridor, around each room, up the stairs and back."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from rholoc.geometry import FloatArray
from rholoc.simulation.walk import Motion, Wobble
from rholoc_lab.simulation.building import (
    ROOM_DEPTH_M,
    STAIRS_ENTRY_M,
    STEP_DEPTH_M,
    STEPS,
    STOREY_M,
    WALL_M,
    Plan,
    RoomPlan,
    make_plan,
)

EYE_M = 1.45  # above the floor
CORRIDOR_SPEED_M_S = 0.9
ROOM_SPEED_M_S = 0.45
STAIRS_SPEED_M_S = 0.45  # over the ground
_HURRIED, _SLOWEST = 0.7, 1.3  # times as long as at these speeds a walk is made to last
_BRISK = 0.85  # times as long may a walk of one room more last, to be taken
_WAYPOINT_PAUSE_S = 2.4  # half of it to slow down and to set off again
_GLANCE_S = 5.0  # that the walker stands in a room and looks around
_PITCH_RAD = np.radians(-9.0)
_GLANCE_RAD = np.radians(60.0)  # half of it once it is smooth
_STEP_S = 0.02
_KNOT_EVERY = 5  # steps
_SMOOTH_WAY_S = 0.3  # nobody turns a corner at once
_SMOOTH_GAZE_S = 1.0
_MIN_WAYPOINTS, _MAX_WAYPOINTS = 3, 12
_SECONDS_PER_WAYPOINT = 60.0
_START_X_M = 0.45
_END_M = 1.8  # from the start


@dataclass(frozen=True)
class _Node:
    """A place on the way.

    Attributes:
        place: (x, y, z) of the camera, metres, building frame.
        speed: metres a second over the ground, on the way here.
        pause_s: how long the walker stands here.
        glance: how far the walker looks to one side and then the other while standing, radians.
    """

    place: FloatArray
    speed: float
    pause_s: float = 0.0
    glance: float = 0.0


@dataclass(frozen=True, eq=False)
class BuildingWalk(Motion):
    """A way through the building.

    Attributes:
        path: seconds → (x, y, z); ``gaze``: seconds → (yaw, pitch) in radians.
        end_s: when the walker has arrived.
        stops: the middles of the pauses at the waypoints, seconds.
    """

    path: CubicSpline
    gaze: CubicSpline
    end_s: float
    stops: tuple[float, ...]

    @property
    def pause_times(self) -> FloatArray:
        """Seconds: the middle of the pause at each waypoint."""
        return np.array(self.stops)

    @property
    def waypoint_names(self) -> tuple[str, ...]:
        """``START``, ``W1`` … ``E``."""
        return ("START", *(f"W{i}" for i in range(1, len(self.stops) - 1)), "E")

    def way(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N,) seconds → where the way leads (N, 3) metres, and metres a second over the ground (N,)."""
        there = np.clip(times, 0.0, self.end_s)
        inside = ((times > 0) & (times < self.end_s)).astype(float)
        return self.path(there), inside * np.linalg.norm(self.path(there, 1)[:, :2], axis=1)

    def gaze_at(self, times: FloatArray) -> FloatArray:
        """(N,) seconds → (N, 2) yaw and pitch, radians."""
        return np.asarray(self.gaze(np.clip(times, 0.0, self.end_s)))


def make_building_walk(number: int = 1, seconds: float = 600.0, seed: int = 0) -> BuildingWalk:
    """A walk of about ``seconds`` through as many rooms as that leaves time for, and back to where it began.

    Walk 1 starts at the map frame's origin. Others visit the rooms of a walk of these ``seconds`` in another order and
    the other way around, higher or lower, at other speeds and looking elsewhere. Waypoints: the start, rooms at even
    steps of the way and the end, one a minute, 3 to 12 of them.
    """
    plan = make_plan(seed)
    rng = np.random.default_rng([seed, number, 102])
    visited = _rooms_within(plan, seconds)
    nodes = _route(plan, visited, number, rng, _waypoint_rooms(len(visited), seconds))
    lasting_s = _times(nodes)[-1]
    stretch = float(np.clip((seconds - 0.5 * _WAYPOINT_PAUSE_S) / lasting_s, _HURRIED, _SLOWEST))
    times = stretch * _times(nodes)
    path, gaze, end_s = _smooth(nodes, times, rng)
    hand = np.random.default_rng([seed, number, 103])  # of its own, so that the origin is that of a walk of any length
    stops = [t - 0.5 * stretch * n.pause_s for t, n in zip(times.tolist(), nodes, strict=True) if _is_waypoint(n)]
    walk = BuildingWalk(
        number=number,
        sway=Wobble.draw(hand, np.array([0.006, 0.006, 0.003]), 0.3, 2.0),
        tremble=Wobble.draw(hand, np.radians([0.6, 0.5, 0.5]), 0.3, 2.5),
        origin=np.zeros(3),
        path=path,
        gaze=gaze,
        end_s=end_s,
        stops=tuple(stops),
    )
    if number == 1:
        return replace(walk, origin=walk.positions(np.zeros(1))[0])
    first = make_building_walk(1, seconds, seed)
    return replace(walk, origin=first.origin)


def _start(plan: Plan) -> FloatArray:
    return np.array([_START_X_M, plan.corridor_y, EYE_M])


def _is_waypoint(node: _Node) -> bool:
    return node.pause_s > 0 and node.glance == 0


def _rooms_within(plan: Plan, seconds: float) -> tuple[RoomPlan, ...]:
    """The first rooms of the plan that can be visited in the time, at least one."""
    for count in range(len(plan.rooms), 1, -1):
        visited = plan.rooms[:count]
        nodes = _route(plan, visited, 1, np.random.default_rng(0), _waypoint_rooms(count, seconds))
        if _BRISK * _times(nodes)[-1] <= seconds - 0.5 * _WAYPOINT_PAUSE_S:
            return visited
    return plan.rooms[:1]


def _waypoint_rooms(count: int, seconds: float) -> frozenset[int]:
    """Which of ``count`` visited rooms have a waypoint."""
    wanted = int(np.clip(2 + seconds / _SECONDS_PER_WAYPOINT, _MIN_WAYPOINTS, _MAX_WAYPOINTS)) - 2
    wanted = min(wanted, count)
    return frozenset(np.round((np.arange(wanted) + 0.5) * count / wanted - 0.5).astype(int).tolist())


def _route(
    plan: Plan, visited: Sequence[RoomPlan], number: int, rng: np.random.Generator, with_waypoint: frozenset[int]
) -> list[_Node]:
    """The way's nodes: up the building and back to the start."""
    other = number != 1
    lift = float(rng.uniform(-0.12, 0.12)) if other else 0.0
    side = float(rng.uniform(0.15, 0.3)) * (1 if number % 2 else -1) if other else 0.0
    order = list(range(len(visited)))
    if other:
        order = [i for storey in (0, 1) for i in order[::-1] if visited[i].storey == storey]

    def at(x: float, y: float, floor: float) -> FloatArray:
        return np.array([x, y, floor + EYE_M + lift])

    def corridor(x: float, storey: int) -> _Node:
        aside = float(rng.uniform(-0.15, 0.15)) + side
        return _Node(at(x, plan.corridor_y + aside, storey * STOREY_M), CORRIDOR_SPEED_M_S)

    nodes = [_Node(_start(plan) + np.array([0.0, side, lift]), CORRIDOR_SPEED_M_S, _WAYPOINT_PAUSE_S)]
    storey = 0
    for position, i in enumerate(order):
        room = visited[i]
        if room.storey != storey:
            nodes += _stairs(plan, rng, lift, up=True)
            storey = room.storey
        nodes.append(corridor(float(room.place(room.door, 0)[0]), storey))
        nodes += _around(room, rng, lift, clockwise=(position + number) % 2 == 0, waypoint=i in with_waypoint)
        nodes.append(corridor(float(room.place(room.door, 0)[0]), storey))
    if storey == 1:
        nodes += _stairs(plan, rng, lift, up=False)
    nodes.append(_Node(_start(plan) + np.array([_END_M, side + 0.1, lift]), CORRIDOR_SPEED_M_S, _WAYPOINT_PAUSE_S))
    return nodes


def _around(room: RoomPlan, rng: np.random.Generator, lift: float, clockwise: bool, waypoint: bool) -> list[_Node]:
    """Through the door, once around the middle of the room, a stop at a waypoint or to look around, and out."""
    inset = 1.25 + rng.uniform(-0.08, 0.12)
    near, far = 1.1 + rng.uniform(0, 0.2), ROOM_DEPTH_M - 1.25 + rng.uniform(-0.1, 0.1)
    corners = [(inset, near), (inset, far), (room.width - inset, far), (room.width - inset, near)]
    if not clockwise:
        corners = [corners[0], *corners[:0:-1]]

    def node(x: float, y: float, speed: float, pause_s: float = 0.0, glance: float = 0.0) -> _Node:
        height = EYE_M + lift + float(rng.uniform(-0.06, 0.06))
        return _Node(room.place(x, y, height), speed, pause_s, glance)

    through = [node(room.door, y, 0.7) for y in (-WALL_M - 0.3, 0.55)]
    ways = [node(x, y, ROOM_SPEED_M_S * rng.uniform(0.9, 1.1)) for x, y in corners]
    glance = float(rng.choice([-1, 1])) * _GLANCE_RAD * float(rng.uniform(0.8, 1.2))
    if waypoint:
        ways[2] = replace(ways[2], pause_s=_WAYPOINT_PAUSE_S)
    else:
        ways[1] = replace(ways[1], pause_s=_GLANCE_S, glance=glance)
    out = [node(room.door, y, 0.7) for y in (0.55, -WALL_M - 0.3)]
    return [*through, *ways, *out]


def _stairs(plan: Plan, rng: np.random.Generator, lift: float, up: bool) -> list[_Node]:
    """From the corridor of one floor to the other's."""
    left, right = plan.flight_x
    y0, y1 = plan.north_y + STAIRS_ENTRY_M, plan.north_y + STAIRS_ENTRY_M + (STEPS - 1) * STEP_DEPTH_M
    landing = y1 + 0.65
    half = 0.5 * STOREY_M
    places = [
        (left, plan.corridor_y, 0.0, CORRIDOR_SPEED_M_S),
        (left, plan.north_y - WALL_M - 0.3, 0.0, 0.7),
        (left, y0 - 0.15, 0.0, 0.7),
        (left, y1, half, STAIRS_SPEED_M_S),
        (left, landing, half, STAIRS_SPEED_M_S),
        (right, landing, half, STAIRS_SPEED_M_S),
        (right, y1, half, STAIRS_SPEED_M_S),
        (right, y0 - 0.15, STOREY_M, STAIRS_SPEED_M_S),
        (right, plan.north_y - WALL_M - 0.3, STOREY_M, 0.7),
        (right, plan.corridor_y, STOREY_M, 0.7),
    ]
    if not up:
        speeds = [place[3] for place in places]
        places = [
            (*place[:3], speed) for place, speed in zip(places[::-1], [CORRIDOR_SPEED_M_S, *speeds[:0:-1]], strict=True)
        ]
    aside = rng.uniform(-0.08, 0.08)
    return [_Node(np.array([x + aside, y, z + EYE_M + lift]), speed) for x, y, z, speed in places]


def _times(nodes: Sequence[_Node]) -> FloatArray:
    """When the walker leaves each node, seconds; the pause there comes before."""
    steps = [np.linalg.norm((b.place - a.place)[:2]) / b.speed for a, b in pairwise(nodes)]
    return np.cumsum([nodes[0].pause_s, *(step + node.pause_s for step, node in zip(steps, nodes[1:], strict=True))])


def _smooth(
    nodes: Sequence[_Node], leaves: FloatArray, rng: np.random.Generator
) -> tuple[CubicSpline, CubicSpline, float]:
    """The way and the gaze as smooth functions of time, and when they end."""
    stretch = leaves[-1] / _times(nodes)[-1]
    pauses = stretch * np.array([node.pause_s for node in nodes])
    places = np.array([node.place for node in nodes])
    t = np.arange(0.0, leaves[-1] + _STEP_S, _STEP_S)
    knots = np.stack([leaves - pauses - 1e-9, leaves], axis=1).ravel()
    way = np.stack([np.interp(t, knots, np.repeat(axis, 2)) for axis in places.T], axis=1)
    way = gaussian_filter1d(way, _SMOOTH_WAY_S / _STEP_S, axis=0, mode="nearest")

    legs = np.diff(places[:, :2], axis=0)
    yaw = np.unwrap(np.arctan2(legs[:, 1], legs[:, 0]))
    leg = np.clip(np.searchsorted(leaves, t, side="right") - 1, 0, len(legs) - 1)
    yaw_at = yaw[leg]
    for node, left, pause in zip(nodes, leaves.tolist(), pauses.tolist(), strict=True):
        if node.glance:
            share = np.clip((t - (left - pause)) / pause, 0, 1)
            yaw_at = yaw_at + node.glance * np.sin(2 * np.pi * share)
    look = Wobble.draw(rng, np.radians([14.0, 3.0]), 0.04, 0.15)(t)
    climb = np.arctan2(np.gradient(way[:, 2], t), np.maximum(np.hypot(*np.gradient(way[:, :2], t, axis=0).T), 0.2))
    pitch_at = _PITCH_RAD + 0.35 * np.clip(climb, -0.6, 0.6)
    gaze = np.stack([yaw_at + look[:, 0], pitch_at + look[:, 1]], axis=1)
    gaze = gaussian_filter1d(gaze, _SMOOTH_GAZE_S / _STEP_S, axis=0, mode="nearest")
    some = slice(None, None, _KNOT_EVERY)
    end_s = float(t[some][-1])
    return (
        CubicSpline(t[some], way[some], bc_type="clamped"),
        CubicSpline(t[some], gaze[some], bc_type="clamped"),
        end_s,
    )
