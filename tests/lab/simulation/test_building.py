"""The building of many rooms: one can walk through it and see into its rooms by the doors, not through its walls."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rholoc.geometry import FloatArray, Pose
from rholoc.recordings import check_waypoints_fix_frame
from rholoc.simulation import (
    PHONE_CAMERA,
    Building,
    Renderer,
    make_walk,
    measure_waypoints,
    render_view,
)
from rholoc.simulation.scene import Box
from rholoc_lab.simulation.rearrangement import rearranged
from rholoc_lab.simulation.sites import Site, make_site, make_site_walk

SECONDS = 600.0
CAMERA = PHONE_CAMERA.resized(160, 120)


@pytest.fixture(scope="module")
def building(made_once: Any) -> Building:
    return made_once("building", lambda: make_site(Site.BUILDING, 0))


@pytest.fixture(scope="module")
def renderer(building: Building) -> Renderer:
    return Renderer(building, [face.paint.albedo for face in building.faces])


def room_names(building: Building, points: FloatArray) -> list[str]:
    return [building.names[i] for i in building.outside(points).argmin(axis=0)]


@pytest.mark.slow
def test_boxes_stand_in_their_rooms_and_do_not_overlap(building: Building) -> None:
    samples = np.random.default_rng(0).uniform(-0.499, 0.499, (30, 3))
    for name, room in zip(building.names, building.rooms, strict=True):
        centres, sizes, axes = (
            np.array([getattr(box, attribute) for box in room.boxes]) for attribute in ("centre", "size", "axes")
        )
        for i, box in enumerate(room.boxes):
            points = box.centre + (samples * box.size) @ box.axes
            inside = np.abs((points - room.room.centre) @ room.room.axes.T) - 0.5 * room.room.size
            assert inside.max() < 1e-6, (name, i)
            along = (points - centres[:, None]) @ axes.transpose(0, 2, 1)
            depth = 0.5 * sizes[:, None] - np.abs(along)  # (boxes, points, 3)
            overlapping = np.flatnonzero((depth > 1e-6).all(axis=2).any(axis=1))
            assert overlapping.tolist() == [i], name


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 2])
def test_the_walks_keep_to_the_rooms_and_clear_of_what_stands_there(building: Building, number: int) -> None:
    walk = make_site_walk(Site.BUILDING, number, SECONDS, 0)
    times = np.arange(0, SECONDS, 0.2)
    positions = walk.positions(times)
    assert building.outside(positions).min(axis=0).max() < 0.005
    visited = set(room_names(building, positions))
    assert sum(name.startswith("room") for name in visited) == 14
    assert {"corridor 0", "corridor 1", "stairs"} <= visited
    where = building.outside(positions).argmin(axis=0)
    for index, room in enumerate(building.rooms):
        inside = positions[where == index]
        for box in room.boxes if len(inside) else ():
            off = np.maximum(np.abs((inside - box.centre) @ box.axes.T) - 0.5 * box.size, 0)
            assert np.linalg.norm(off, axis=1).min() > 0.15, (building.names[index], box.centre)


def test_the_walks_are_those_of_a_person() -> None:
    walk = make_site_walk(Site.BUILDING, 1, SECONDS, 0)
    times = np.arange(0, SECONDS, 0.02)
    speed = np.linalg.norm(np.gradient(walk.positions(times), times, axis=0), axis=1)
    turning_deg_s = np.degrees(np.linalg.norm(walk.angular_velocities(times), axis=1))
    assert 0.3 < np.median(speed) < 0.8
    assert speed.max() < 1.3
    assert turning_deg_s.max() < 140
    assert np.abs(walk.accelerations(times)).max() < 4
    climbed = walk.positions(times)[:, 2]
    assert climbed.max() - climbed.min() == pytest.approx(3.0, abs=0.4)


@pytest.mark.slow
@pytest.mark.parametrize(("seconds", "rooms", "waypoints"), [(30.0, 1, 3), (120.0, 4, 4), (600.0, 14, 12)])
def test_shorter_walks_visit_fewer_rooms(building: Building, seconds: float, rooms: int, waypoints: int) -> None:
    walk = make_site_walk(Site.BUILDING, 1, seconds, 0)
    visited = set(room_names(building, walk.positions(np.arange(0, seconds, 0.1))))
    assert sum(name.startswith("room") for name in visited) == rooms
    measured = measure_waypoints(walk, seconds)
    assert len(measured) == waypoints
    check_waypoints_fix_frame(measured)
    for waypoint in measured:
        around = walk.positions(waypoint.time + np.linspace(-0.3, 0.3, 7))
        assert np.linalg.norm(around - waypoint.position, axis=1).max() < 0.06


def test_a_walk_of_any_length_begins_at_the_origin() -> None:
    for seconds in (30.0, 200.0):
        start = make_site_walk(Site.BUILDING, 1, seconds, 3).positions(np.zeros(1))
        np.testing.assert_allclose(start, 0, atol=1e-6)


@pytest.mark.slow
def test_what_is_seen_lies_where_the_ray_meets_it_first(building: Building, renderer: Renderer) -> None:
    """Every pixel's point is on its ray, and nothing stands before it in any of the rooms the ray passes."""
    walk = make_site_walk(Site.BUILDING, 1, SECONDS, 0)
    rng = np.random.default_rng(0)
    for T in walk.T_map_camera(rng.uniform(2, SECONDS - 2, 8)):
        pose = Pose(T)
        seen = renderer.surface(CAMERA, pose)
        pixels = rng.integers((0, 0), (CAMERA.height, CAMERA.width), (40, 2))
        points = seen.points[pixels[:, 0], pixels[:, 1]]
        assert building.outside(points).min(axis=0).max() < 0.01
        share = np.linspace(0, 1, 200)[None, 1:-1, None] * 0.995
        between = (pose.position + share * (points[:, None] - pose.position)).reshape(-1, 3)
        assert np.quantile(building.outside(between).min(axis=0), 0.999) < 0.005  # through doors, never through walls
        for room in building.rooms:
            assert room.blocked(np.tile(pose.position, (len(points), 1)), points, margin=5e-3).mean() < 0.06


@pytest.mark.slow
def test_a_room_is_seen_through_its_door(building: Building, renderer: Renderer) -> None:
    room = next(i for i, name in enumerate(building.names) if name == "room 001")
    way = building.portals[room][0]
    middle = way.corners.mean(axis=0)
    corridor = building.rooms[0].room.centre
    eye = np.array([middle[0], corridor[1], corridor[2]])
    heading = middle - eye
    seen = renderer.surface(CAMERA, Pose.from_heading(eye, heading / np.linalg.norm(heading)))
    names = set(room_names(building, seen.points.reshape(-1, 3)))
    assert "room 001" in names
    assert not names & {f"room {other}" for other in ("002", "003", "005", "101")}


def around(building: Building, room: int) -> Building:
    """The part of a building that one room opens into, and that room."""
    kept = [room, *sorted({way.into for way in building.portals[room]})]
    portals = [
        tuple(replace(way, into=kept.index(way.into)) for way in building.portals[one] if way.into in kept)
        for one in kept
    ]
    return Building(tuple(building.rooms[i] for i in kept), tuple(building.names[i] for i in kept), tuple(portals))


@pytest.mark.slow
def test_white_walls_are_white_and_rooms_are_lit(building: Building) -> None:
    room = building.names.index("room 004")
    (pose,) = make_site_walk(Site.BUILDING, 1, SECONDS, 0).poses(np.array([240.0]))
    assert building.outside(pose.position[None]).argmin() == room
    picture = render_view(around(building, room), CAMERA, pose)
    assert 70 < picture.mean() < 190
    assert np.ptp(picture.reshape(-1, 3).mean(axis=0)) < 25


@pytest.fixture(scope="module")
def way():
    """Places on a walk half as wide again as the demo's, so that pieces would stand in it if nobody looked."""
    walked = make_walk(1).positions(np.linspace(0, 30, 60))
    middle = walked.mean(axis=0)
    return middle + 1.5 * (walked - middle)


@pytest.fixture(scope="module")
def rearrangement(site, way):
    """The room with a third of its furniture moved, and what was."""
    return rearranged(site, 1 / 3, 1, way)


def overlap(a: Box, b: Box) -> bool:
    """Whether two boxes share more than a millimetre, by the separating axes of both."""
    corners_a, corners_b = a.corners, b.corners
    for axis in np.concatenate([a.axes, b.axes]):
        on_a, on_b = corners_a @ axis, corners_b @ axis
        if on_a.max() <= on_b.min() + 1e-3 or on_b.max() <= on_a.min() + 1e-3:
            return False
    return True


def test_a_third_of_the_furniture_stands_elsewhere(site, rearrangement):
    moved, names = rearrangement
    pieces = {box.piece for box in site.boxes if box.piece}
    assert len(names) == len(set(names)) == int(np.ceil(len(pieces) / 3))
    before, after = ({piece: [b for b in s.boxes if b.piece == piece] for piece in pieces} for s in (site, moved))
    for piece in pieces:
        assert len(before[piece]) == len(after[piece])
        shift = [float(np.linalg.norm(b.centre - a.centre)) for b, a in zip(before[piece], after[piece], strict=True)]
        assert (min(shift) > 0.3) if piece in names else (max(shift) == 0)
        assert [b.centre[2] for b in before[piece]] == [a.centre[2] for a in after[piece]]


def test_what_was_moved_overlaps_nothing_and_stands_in_nobodys_way(way, rearrangement):
    moved, names = rearrangement
    for box in moved.boxes:
        if box.piece in names:
            assert not any(overlap(box, other) for other in moved.boxes if other.piece != box.piece)
            inside = np.abs((box.corners - moved.room.centre) @ moved.room.axes.T) <= 0.5 * moved.room.size + 1e-6
            assert inside.all()
            gaps = np.abs((way - box.centre) @ box.axes.T) - 0.5 * box.size
            assert gaps.max(axis=1).min() > 0.25


def test_the_same_seed_moves_the_same(site, way):
    (_, names), (_, again) = (rearranged(site, 1 / 6, 4, way) for _ in range(2))
    assert names == again


@pytest.mark.slow
def test_a_room_without_space_says_so(site):
    grid = np.stack(np.meshgrid(np.arange(-2, 5, 0.5), np.arange(-1, 5, 0.5), [0.0]), axis=-1).reshape(-1, 3)
    with pytest.raises(ValueError, match="find another place"):
        rearranged(site, 1.0, 0, grid)
