"""Maps that learn from the queries they answered: what is new, what is gone, and what is not believed."""

import json
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from rholoc.errors import Conflict, InvalidInput, MappingFailed
from rholoc.geometry import BoolArray, Pose
from rholoc.localization import Dof, Localizer, Query
from rholoc.mapping.build.stored_observations import keep_features
from rholoc.mapping.edit.sources import forget_recording
from rholoc.mapping.learn import from_queries as user_learning
from rholoc.mapping.learn.answered_query import AnsweredQuery
from rholoc.mapping.learn.expected_sightings import Sights, agreeing
from rholoc.mapping.learn.from_queries import learn_from_queries
from rholoc.maps import Map, map_to_bytes, without_memory
from rholoc.progress import silent
from rholoc.reports import QueriesReport, report_from_json, report_to_json

HOUR_S = 3600.0


@pytest.fixture(scope="module")
def room_map(point_room: Any) -> Map:
    """Of half of the room."""
    return point_room.map_of(point_room.walk(60)[:30], "walk")


@pytest.fixture(scope="module")
def is_moved(point_room: Any) -> BoolArray:
    """A third of the points, in pieces like furniture: those of some stretches of the walls."""
    along = np.arctan2(point_room.points[:, 1], point_room.points[:, 0])
    return np.floor(along / (2 * np.pi) * 15).astype(int) % 3 == 0


@pytest.fixture(scope="module")
def changed_room(point_room: Any, is_moved: BoolArray) -> Any:
    """The room with the points of those stretches replaced by others."""
    rng = np.random.default_rng(5)
    points, descriptors = point_room.points.copy(), point_room.descriptors.copy()
    points[is_moved, 2] = 3.0 - points[is_moved, 2]
    descriptors[is_moved] = rng.integers(0, 256, descriptors[is_moved].shape, dtype=np.uint8)
    return replace(point_room, points=points, descriptors=descriptors)


def beside(room: Any, count: int, sideways_m: float = 0.1) -> list[Pose]:
    """Poses beside the walk through half of the room."""
    return room.walk(2 * count, sideways_m)[:count]


def asked(room: Any, count: int = 60, asker: str = "a", apart_s: float = HOUR_S) -> list[AnsweredQuery]:
    """Queries by cameras beside the walk, answered with their true poses."""
    return [
        AnsweredQuery(
            room.see(pose, 5000 + number),
            room.camera,
            pose.T_map_camera,
            1e-6 * np.eye(6),
            0.97,
            1e9 + apart_s * number,
            f"{asker}{number % 3}",
        )
        for number, pose in enumerate(beside(room, count))
    ]


def recall(map_: Map, room: Any, poses: Sequence[Pose]) -> float:
    localizer, right = Localizer(map_), 0
    for seed, pose in enumerate(poses):
        answer = localizer.localize(Query(room.see(pose, 9000 + seed, share=0.25), room.camera, Dof.FREE))
        right += answer.pose is not None and float(np.linalg.norm(answer.pose.position - pose.position)) < 0.05
    return right / len(poses)


@pytest.fixture(scope="module")
def queries(changed_room: Any) -> list[AnsweredQuery]:
    return asked(changed_room, count=60)


@pytest.fixture(scope="module")
def learned(made_once: Any, room_map: Map, queries: list[AnsweredQuery]) -> Map:
    return made_once("learned", lambda: learn_from_queries(room_map, queries))


def test_what_moved_is_forgotten_and_what_came_is_learned(
    room_map: Map, point_room: Any, changed_room: Any, is_moved: BoolArray
) -> None:
    """From queries at their true poses."""
    queries = asked(changed_room, count=90)
    placed = [user_learning._Placed(one, one.T_map_camera, one.covariance, n) for n, one in enumerate(queries)]
    learned = user_learning._lesson(Localizer(room_map), placed, silent).map_
    before, after = cKDTree(room_map.landmarks.positions), cKDTree(learned.landmarks.positions)
    gone, came = point_room.points[is_moved], changed_room.points[is_moved]
    known_before = np.isfinite(before.query(gone, distance_upper_bound=0.1)[0])
    still_known = np.isfinite(after.query(gone[known_before], distance_upper_bound=0.05)[0])
    assert still_known.mean() < 0.5
    came = came[np.isfinite(before.query(came, distance_upper_bound=0.5)[0])]  # where the walk looked
    assert np.isfinite(after.query(came, distance_upper_bound=0.05)[0]).mean() > 0.4
    turned, octaves = changed_room.patch_errors(learned)
    assert np.median(turned) < 10
    assert np.median(octaves) < 0.2
    stays = point_room.points[~is_moved]
    stays = stays[np.isfinite(before.query(stays, distance_upper_bound=0.05)[0])]
    assert np.isfinite(after.query(stays, distance_upper_bound=0.05)[0]).mean() > 0.98


@pytest.mark.slow
def test_the_report_says_what_was_learned(room_map: Map, learned: Map, queries: list[AnsweredQuery]) -> None:
    assert (learned.info.id, learned.info.version) == (room_map.info.id, room_map.info.version + 1)
    report = learned.info.report.learned[-1]
    assert report.queries.kept == len(queries)
    assert report.queries.askers == 3
    assert report.queries.recall_after >= report.queries.recall_before
    assert report.features_new is not None
    assert report.features_new > 0


@pytest.mark.parametrize(("before", "after", "refused"), [(None, 0.1, False), (0.1, None, True), (None, None, False)])
def test_a_map_that_finds_nothing_any_more_is_refused(before: float | None, after: float | None, refused: bool) -> None:
    """Of queries that were neither right nor wrong before."""
    answers = [user_learning._Answers(20, 0, 0, median_m) for median_m in (before, after)]
    with pytest.raises(MappingFailed, match="none of 20 queries any more") if refused else nullcontext():
        user_learning._check_no_worse(*answers, "queries")


def test_a_report_reads_back_where_nothing_held_back_was_found(room_map: Map) -> None:
    """Medians of nothing were written as null, which was no number: the map could not be opened again."""
    none = user_learning._answers(Localizer(room_map), [])
    report = QueriesReport(30, 30, 3, 2, 0, 0, none.recall, none.recall, none.median_m, none.median_m)
    assert report_from_json(QueriesReport, json.loads(json.dumps(report_to_json(report)))) == report


@pytest.mark.slow
def test_the_changed_room_is_found_again(room_map: Map, learned: Map, changed_room: Any) -> None:
    poses = beside(changed_room, 15, -0.1)
    found = recall(learned, changed_room, poses)
    assert found >= recall(room_map, changed_room, poses)
    assert found > 0.8


@pytest.fixture(scope="module")
def second_night(queries: list[AnsweredQuery], changed_room: Any) -> list[user_learning._Placed]:
    """Some of the first night's queries, and new ones."""
    night = [*queries[::2], *asked(changed_room, 40, apart_s=HOUR_S + 1)]
    return [user_learning._Placed(one, one.T_map_camera, one.covariance, n) for n, one in enumerate(night)]


@pytest.fixture(scope="module")
def second_lesson(learned: Map, second_night: list[user_learning._Placed]) -> user_learning._Lesson:
    return user_learning._lesson(Localizer(learned), second_night, silent)


def test_a_query_becomes_a_view_once_and_a_map_does_not_grow_without_end(
    room_map: Map, learned: Map, second_night: list[user_learning._Placed], second_lesson: user_learning._Lesson
) -> None:
    again = second_lesson.map_
    assert 0 < second_lesson.views < len(second_night)
    assert len(np.unique(again.views.times)) == len(again.views) == len(learned.views)
    assert [(source.name, source.views) for source in again.info.sources] == [("walk", 30), ("queries", 30)]
    for map_ in (learned, again):
        assert len(map_to_bytes(map_)) < 1.5 * len(map_to_bytes(room_map))


@pytest.mark.slow
def test_a_second_night_does_not_forget_other_places(
    learned: Map, second_night: list[user_learning._Placed], second_lesson: user_learning._Lesson
) -> None:
    """The oldest views went, wherever they were: of 31 queries held back, halves included, 24 were still found."""
    questions = user_learning._questions([one for one in second_night if user_learning._is_held_back(one.query)])
    before, after = (user_learning._answers(Localizer(map_), questions) for map_ in (learned, second_lesson.map_))
    assert after.right >= before.right > 0.9 * len(questions)


def test_views_give_way_to_newer_ones_near_them(point_room: Any) -> None:
    T, times = np.array([pose.T_map_camera for pose in beside(point_room, 6)]), np.arange(8.0)
    poses = np.concatenate([T, T[3:5]])
    assert np.flatnonzero(~user_learning._thinned(poses, times, 6)).tolist() == [3, 4]
    assert np.flatnonzero(~user_learning._thinned(poses[::-1], times[::-1], 6)).tolist() == [3, 4]
    assert user_learning._thinned(poses, times, 8).all()
    assert user_learning._thinned(poses[:0], times[:0], 6).shape == (0,)


@pytest.mark.slow
def test_what_was_learned_can_be_forgotten_like_a_recording(learned: Map) -> None:
    left = forget_recording(learned, "queries")
    assert [source.name for source in left.info.sources] == ["walk"]


@pytest.mark.slow
def test_of_a_recording_that_is_forgotten_what_users_saw_stays(learned: Map) -> None:
    left = forget_recording(learned, "walk")
    assert [source.name for source in left.info.sources] == ["queries"]
    assert 0 < len(left) < len(learned)
    assert (np.bincount(left.descriptors.features, minlength=len(left)) > 0).all()


def test_a_query_held_back_is_where_it_is_believed_to_be(queries: list[AnsweredQuery]) -> None:
    """Where two maps that are both believed disagree, it is no test of either."""

    def placed(query: AnsweredQuery, x: float) -> user_learning._Placed:
        T = np.eye(4)
        T[0, 3] = x
        return user_learning._Placed(query, T, query.covariance, 0)

    same, elsewhere, misled, never, doubted = queries[:5]
    settled = user_learning._settled(
        [placed(one, 0.0) for one in (same, elsewhere, misled, doubted)],
        believed=[placed(one, 0.0) for one in (same, elsewhere, doubted)],
        again=[placed(one, x) for one, x in ((same, 0.1), (elsewhere, 1.0), (misled, 2.0), (never, 3.0))],
    )
    assert [(one.query, one.T_map_camera[0, 3]) for one in settled] == [(same, 0.0), (misled, 2.0), (doubted, 0.0)]


@pytest.mark.slow
def test_an_hour_of_one_asker_teaches_nothing_new(room_map: Map, changed_room: Any) -> None:
    queries = [replace(one, asker="one") for one in asked(changed_room, 40, apart_s=5.0)]
    with pytest.raises(MappingFailed, match="nothing new"):
        learn_from_queries(room_map, queries)


def test_queries_that_are_not_sure_without_their_prior_teach_nothing(
    room_map: Map, queries: list[AnsweredQuery]
) -> None:
    rng = np.random.default_rng(3)
    nonsense = [
        replace(
            one,
            features=replace(
                one.features, descriptors=rng.integers(0, 256, one.features.descriptors.shape, dtype=np.uint8)
            ),
        )
        for one in queries
    ]
    with pytest.raises(MappingFailed, match=f"Only 0 of {len(queries)}"):
        learn_from_queries(room_map, nonsense)


def test_too_few_queries_are_refused(room_map: Map, queries: list[AnsweredQuery]) -> None:
    with pytest.raises(Conflict, match="12 queries are kept"):
        learn_from_queries(room_map, queries[:12])


def test_a_map_without_memory_does_not_learn(room_map: Map, queries: list[AnsweredQuery]) -> None:
    with pytest.raises(InvalidInput, match="does not keep what it was built from"):
        learn_from_queries(without_memory(room_map), queries)


def test_a_map_that_would_be_worse_is_not_made(
    room_map: Map, queries: list[AnsweredQuery], monkeypatch: pytest.MonkeyPatch
) -> None:
    def teach_badly(localizer: Localizer, *_: object) -> user_learning._Lesson:
        left = np.arange(len(localizer.map)) % 8 == 0
        return user_learning._Lesson(keep_features(localizer.map, left), ~left, views=0, seen_again=0, new=0)

    monkeypatch.setattr(user_learning, "_lesson", teach_badly)
    monkeypatch.setattr(user_learning, "_ROUNDS", 0)
    with pytest.raises(MappingFailed, match="would be worse"):
        learn_from_queries(room_map, queries[:36])


def test_a_pose_that_is_a_little_off_is_neither_right_nor_wrong(point_room: Any) -> None:
    """It is in the right place: a map that gives it where there was none before is no worse for it."""
    T = point_room.walk(3)[0].T_map_camera
    features = point_room.see(point_room.walk(3)[0], 0)
    for off_m, right, wrong in ((0.01, 1, 0), (0.06, 0, 0), (0.3, 0, 1)):
        beside = T.copy()
        beside[0, 3] += off_m
        localizer: Any = SimpleNamespace(localize=lambda query, T=beside: SimpleNamespace(pose=Pose(T)))
        answers = user_learning._answers(localizer, [(point_room.camera, T, features)])
        assert (answers.right, answers.wrong) == (right, wrong)


@pytest.mark.parametrize(
    ("right", "wrong", "is_worse"), [(50, 1, False), (49, 1, True), (53, 2, False), (52, 2, True), (60, 5, True)]
)
def test_a_wrong_answer_is_outweighed_by_three_right_ones(right: int, wrong: int, is_worse: bool) -> None:
    before, after = user_learning._Answers(90, 50, 1, 0.01), user_learning._Answers(90, right, wrong, 0.01)
    with pytest.raises(MappingFailed) if is_worse else nullcontext():
        user_learning._check_no_worse(before, after, "queries")


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
