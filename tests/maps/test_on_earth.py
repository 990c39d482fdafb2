"""A map's or a site's place on Earth: by points and by a heading, and after its frame moved."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidInput
from rholoc.geometry import Similarity
from rholoc.geometry.earth import enu_of
from rholoc.maps import SiteOnEarth

TRUE = SiteOnEarth(52.52, 13.405, 74.0, 33.0)
POINTS = np.array([[0.0, 0.0, 0.0], [12.0, 3.0, 1.0], [-4.0, 7.0, 2.5]])


def apart_m(a, b):
    return float(np.linalg.norm(enu_of(a, b)))


@pytest.mark.parametrize("heading_deg", [0.0, 33.0, 180.0, 271.0])
@pytest.mark.parametrize("count", [2, 3])
def test_points_give_it(heading_deg, count):
    true = SiteOnEarth(-33.9, 151.2, 12.0, heading_deg)
    found, missed_m = SiteOnEarth.through(POINTS[:count], [true.place(point) for point in POINTS[:count]])
    assert missed_m < 1e-4
    assert apart_m(found.origin, true.origin) < 1e-3
    assert (found.heading_deg - heading_deg + 180) % 360 - 180 == pytest.approx(0, abs=1e-3)


def test_a_point_and_a_heading_give_it():
    found, missed_m = SiteOnEarth.through(POINTS[1:2], [TRUE.place(POINTS[1])], heading_deg=33.0)
    assert missed_m < 1e-4
    assert apart_m(found.origin, TRUE.origin) < 1e-4


@pytest.mark.parametrize(
    ("points", "places", "words"),
    [
        (POINTS[:1], [TRUE.place(POINTS[0])], "two points"),
        (POINTS[[0, 0]], [TRUE.place(POINTS[0])] * 2, "no direction"),
        (POINTS[:2], [TRUE.place(POINTS[0]), TRUE.place(2 * POINTS[1])], "times as far apart"),
    ],
)
def test_points_that_do_not_give_it_are_refused(points, places, words):
    with pytest.raises(InvalidInput, match=words):
        SiteOnEarth.through(points, places)


@given(st.floats(-180, 180), st.tuples(*[st.floats(-100, 100)] * 3))
def test_points_stay_where_they_are_when_the_frame_moves(turn_deg, shift):
    similarity = Similarity(1.0, Rotation.from_euler("z", turn_deg, degrees=True).as_matrix(), np.array(shift))
    moved = TRUE.moved(similarity)
    for point in POINTS:
        # Over 150 m the Earth curves by 2 mm, and meridians converge by 3e-5 rad, which is 5 mm.
        assert apart_m(moved.place(similarity.points(point[None])[0]), TRUE.place(point)) < 1e-2


def test_the_origin_stays_where_it_is_when_the_scale_changes():
    assert apart_m(TRUE.moved(Similarity(1.3, np.eye(3), np.zeros(3))).origin, TRUE.origin) < 1e-6


def test_a_tilted_frame_has_none():
    tilted = Similarity(1.0, Rotation.from_euler("x", 20, degrees=True).as_matrix(), np.zeros(3))
    assert TRUE.moved(tilted) is None
