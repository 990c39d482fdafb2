"""What a map's report says of its trust, whatever it says."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rholoc.maps import Map, trust_of
from rholoc.reports import LearningReport, MapReport, TrajectoryReport

GOOD = TrajectoryReport("visual", 9, trusted=True, why="Two reconstructions agree.")
BAD = TrajectoryReport("visual", 9, trusted=False, why="Two reconstructions disagree.")
LEARNED = LearningReport(2, frames_found=3)
LEARNED_BADLY = LearningReport(2, trusted=False, why="Two reconstructions disagree.")


@pytest.mark.parametrize(
    ("report", "trusted", "reason"),
    [
        (MapReport(trajectories=(GOOD,)), True, "Two reconstructions agree."),
        (MapReport(trajectories=(GOOD, BAD)), False, "Two reconstructions disagree."),
        (MapReport(trajectories=(BAD, BAD)), False, "Two reconstructions disagree."),
        (MapReport(trajectories=(GOOD,), learned=(LEARNED,)), True, "Two reconstructions agree."),
        (MapReport(trajectories=(GOOD,), learned=(LEARNED_BADLY,)), False, "Two reconstructions disagree."),
    ],
)
def test_a_map_is_trusted_where_every_walk_is(room_map: Map, report: MapReport, trusted: bool, reason: str) -> None:
    trust = trust_of(replace(room_map.info, report=report))
    assert (trust.trusted, trust.reason) == (trusted, reason)


@pytest.mark.parametrize("report", [MapReport(), MapReport(trajectories=(TrajectoryReport("visual", 9),))])
def test_a_map_that_does_not_say_is_neither(room_map: Map, report: MapReport) -> None:
    assert trust_of(replace(room_map.info, report=report)).trusted is None
