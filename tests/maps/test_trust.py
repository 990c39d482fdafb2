"""What a map's report says of its trust, whatever it says."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from rholoc.maps import Map, trust_of

GOOD = {"trusted": True, "why": "Two reconstructions agree."}
BAD = {"trusted": False, "why": "Two reconstructions disagree."}


@pytest.mark.parametrize(
    ("report", "trusted", "reason"),
    [
        ({"trajectories": [GOOD]}, True, "Two reconstructions agree."),
        ({"trajectories": [GOOD, BAD]}, False, "Two reconstructions disagree."),
        ({"trajectories": [BAD, BAD]}, False, "Two reconstructions disagree."),
        ({"trajectories": [GOOD], "learned": [{"frames_found": 3}]}, True, "Two reconstructions agree."),
        ({"trajectories": [GOOD], "learned": [BAD]}, False, "Two reconstructions disagree."),
    ],
)
def test_a_map_is_trusted_where_every_walk_is(
    room_map: Map, report: dict[str, Any], trusted: bool, reason: str
) -> None:
    trust = trust_of(replace(room_map.info, report=report))
    assert (trust.trusted, trust.reason) == (trusted, reason)


@pytest.mark.parametrize(
    "report", [{}, {"trajectories": "good"}, {"trajectories": [3]}, {"trajectories": [{"trusted": "yes"}]}]
)
def test_a_map_that_does_not_say_is_neither(room_map: Map, report: dict[str, Any]) -> None:
    assert trust_of(replace(room_map.info, report=report)).trusted is None
