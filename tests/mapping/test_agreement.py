"""Which cameras agree: what stayed outvotes what moved, however rigid that is."""

from __future__ import annotations

import numpy as np
import pytest

from rholoc.geometry import BoolArray
from rholoc.mapping.learn.expected_sightings import Sights, agreeing

STAYED = np.arange(60)
MOVED = np.arange(60, 100)
COUNT = 100


def sights_of(seeing: list[BoolArray]) -> Sights:
    """Cameras that expect all landmarks, and see those where theirs of ``seeing`` (F,) holds, nine of ten."""
    rng = np.random.default_rng(1)
    shape = (len(seeing), COUNT)
    seen = np.array(seeing, dtype=bool).reshape(shape) & (rng.random(shape) < 0.9)
    cameras, landmarks = (grid.ravel() for grid in np.indices(shape))
    return Sights(cameras, landmarks, np.full(seen.size, 0.9), seen.ravel(), np.arange(len(seeing)), COUNT)


def seeing(landmarks: np.ndarray) -> BoolArray:
    return np.isin(np.arange(COUNT), landmarks)


def all_of(sights: Sights) -> BoolArray:
    return np.ones(sights.camera_count, dtype=bool)


@pytest.mark.parametrize("misled", [1, 5, 12])
def test_those_that_rest_on_what_moved_are_not_believed(misled: int) -> None:
    """They agree with each other, and are sure."""
    sights = sights_of([seeing(STAYED)] * 20 + [seeing(MOVED)] * misled)
    assert agreeing(sights, all_of(sights)).tolist() == [True] * 20 + [False] * misled


def test_where_nothing_moved_all_are_believed() -> None:
    sights = sights_of([seeing(np.arange(COUNT))] * 20)
    assert agreeing(sights, all_of(sights)).all()


def test_what_was_hidden_by_what_moved_speaks_against_nobody() -> None:
    """A few landmarks that all but some miss are no reason not to believe those."""
    sights = sights_of([seeing(STAYED)] * 15 + [seeing(np.append(STAYED, MOVED[:4]))] * 5)
    assert agreeing(sights, all_of(sights)).all()


def test_those_that_are_held_back_are_judged_and_do_not_judge() -> None:
    sights = sights_of([seeing(STAYED)] * 8 + [seeing(MOVED)] * 20)
    speaking = np.arange(28) < 8
    assert agreeing(sights, speaking).tolist() == speaking.tolist()


def test_one_of_whom_others_know_nothing_is_not_contradicted() -> None:
    alone = Sights(np.zeros(20, dtype=np.int64), np.arange(20), np.full(20, 0.8), np.ones(20, bool), np.zeros(1), 20)
    assert agreeing(alone, all_of(alone)).all()


def test_no_cameras_are_no_trouble() -> None:
    nobody = sights_of([])
    assert agreeing(nobody, all_of(nobody)).shape == (0,)
