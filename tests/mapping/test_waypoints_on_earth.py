"""Waypoints on Earth: recordings share one frame, and the map's place follows from them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rholoc.geometry.earth import EarthPlace, enu_of, place_at
from rholoc.mapping.build.pipeline import _earth, _in_one_frame
from rholoc.recordings import Recording, Waypoint

ORIGIN = EarthPlace(52.52, 13.405, 74.0)
POINTS = np.array([[0.0, 0.0, 1.5], [4.0, 1.0, 1.5], [6.0, 5.0, 1.4]])


def waypoints(points, origin=ORIGIN):
    """As the reader makes them: metres around the first one."""
    places = [place_at(point, origin) for point in points]
    return tuple(
        Waypoint(f"W{number}", float(number), tuple(enu_of(place, places[0])), earth=place)
        for number, place in enumerate(places)
    )


def recording(points):
    return Recording("walk", Path("walk"), None, waypoints=waypoints(points))


def test_recordings_with_other_first_waypoints_share_a_frame():
    first, second = _in_one_frame([recording(POINTS), recording(POINTS[::-1])])
    for one, other in zip(first.waypoints, second.waypoints[::-1], strict=True):
        assert one.position == pytest.approx(other.position, abs=1e-6)
    assert first.waypoints[0].position == pytest.approx((0, 0, 0), abs=1e-6)


def test_waypoints_in_metres_stay_as_they_are():
    plain = recording(POINTS)
    plain = replace(plain, waypoints=tuple(replace(one, earth=None) for one in plain.waypoints))
    assert _in_one_frame([plain])[0].waypoints == plain.waypoints
    assert _earth(plain.waypoints) is None
    assert _earth(()) is None


def test_the_maps_frame_is_east_north_up_at_the_first_waypoint():
    found = _earth(_in_one_frame([recording(POINTS)])[0].waypoints)
    first = place_at(POINTS[0], ORIGIN)
    assert np.linalg.norm(enu_of(found.origin, first)) < 1e-3
    assert (found.heading_deg + 180) % 360 - 180 == pytest.approx(0, abs=1e-3)
