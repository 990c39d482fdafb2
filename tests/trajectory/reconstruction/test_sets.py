"""Which of several reconstructions of a set of pictures is taken, and when none is."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from scene import CAMERA, arc, cloud, on_plane

from rholoc.errors import MappingFailed
from rholoc.geometry import BoolArray, FloatArray, IntArray
from rholoc.progress import silent
from rholoc.recordings import Waypoint
from rholoc.trajectory.checks.agreement import Agreement
from rholoc.trajectory.initialization.mapper_starts import Mapper
from rholoc.trajectory.optimization.problem import GIVEN, Problem, State
from rholoc.trajectory.optimization.rounds import AdjustmentProgress
from rholoc.trajectory.reconstruction import from_pictures
from rholoc.trajectory.reconstruction.part import Part as _Part
from rholoc.trajectory.reconstruction.part import Pictured
from rholoc.trajectory.visual.matching import VerifiedPair
from rholoc.trajectory.visual.tracks import Observations

COUNT = 20
NOT_COMPARED = Agreement(np.nan, np.nan, np.nan, 0, COUNT)


@dataclass(frozen=True, eq=False)
class _Pixels:
    """Features of which only the places count."""

    pixels: FloatArray


Compared = Callable[["Part", "Part"], Agreement]


@dataclass(frozen=True, eq=False)
class Part:
    """A reconstruction of some pictures, of which nothing else is looked at here."""

    members: IntArray
    in_metres: bool = False
    apart: tuple[()] = ()
    by_waypoints: tuple[int, ...] = ()
    inliers: int = 0

    @property
    def start(self) -> tuple[None, IntArray]:
        """Its pictures without poses."""
        return None, self.members


@dataclass(frozen=True)
class Frame:
    """Its map frame."""

    doubts: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Result:
    """What becomes of it."""

    part: Part
    covariances: FloatArray
    placed: BoolArray
    agreement: Agreement | None = None
    note: str = ""
    disputed: BoolArray | None = None
    frame: Frame = Frame()

    @property
    def median_depth(self) -> float:
        """Of its points."""
        return 2.0

    @property
    def T_map_camera(self) -> FloatArray:
        """Along a line of 19 m."""
        T = np.tile(np.eye(4), (COUNT, 1, 1))
        T[:, 0, 3] = np.arange(COUNT)
        return T


def taken(
    sizes: dict[Mapper, int],
    compared: Compared,
    monkeypatch: pytest.MonkeyPatch,
    sigma_m: float = 0.01,
    held: bool | BoolArray = True,
    waypoints: Sequence[tuple[Waypoint, ...]] = (),
    off_m: FloatArray | None = None,
    final: Agreement = NOT_COMPARED,
    cores: Sequence[Part] = (),
    turned: Callable[[Part], Part] = lambda part: part,
    pairs: Sequence[VerifiedPair] = (),
) -> Result:
    """The result of a set whose mappers place so many pictures each, which sightings hold or do not. The second
    reconstruction has the pictures ``off_m`` (20,) beside where the first has them at last, and agrees with it so.
    Where there would be no map, ``cores`` are what all of them agree on. Depths that seem reversed are ``turned``.
    """
    aside = np.outer(np.zeros(COUNT) if off_m is None else off_m, [0.0, 1.0, 0.0])
    placed = np.zeros(COUNT, np.bool_) | held
    covariances = np.tile(sigma_m**2 * np.eye(6), (COUNT, 1, 1))
    parts = {mapper: Part(np.arange(size)) for mapper, size in sizes.items()}
    evidence: Any = type("Evidence", (), {"observations": lambda *_: None, "sequential": pairs})()
    seen = {
        "depth": None,
        "rows": np.arange(COUNT),
        "times": np.arange(COUNT),
        "is_film": False,
        "camera": None,
        "features": [],
    }
    sights: Any = type("Sights", (), seen)()
    monkeypatch.setattr(from_pictures, "PycolmapStarts", MagicMock())
    monkeypatch.setattr(from_pictures, "_placed_by", lambda mapper, *_: parts.get(mapper))
    monkeypatch.setattr(from_pictures, "agreement_of", compared)
    monkeypatch.setattr(from_pictures, "agreeing_cores", lambda *_: cores)
    monkeypatch.setattr(from_pictures, "unreversed", lambda part, *_: turned(part))
    monkeypatch.setattr(
        from_pictures, "comparison_with", lambda T, *_: replace(final, second_positions=T[:, :3, 3] + aside)
    )
    monkeypatch.setattr(from_pictures, "_refined", lambda part, walk, whole, *_: (part, walk, whole))
    # Once, zooms were measured although more features contradicted the poses: a focal length of 311 px became 406.
    monkeypatch.setattr(from_pictures, "_unzoomed", lambda *_: pytest.fail("nothing was refined"))
    monkeypatch.setattr(from_pictures, "_finished", lambda walk, part, _: Result(part, covariances, placed))
    found: Any = from_pictures.solve_from_set(Pictured(sights, CAMERA, evidence, waypoints), AdjustmentProgress(silent))
    assert isinstance(found, Result)
    return found


def agreeing(one: Part, other: Part) -> Agreement:
    """Equal on all pictures of the smaller one."""
    common = min(len(one.members), len(other.members))
    return Agreement(0.001, 0.002, 0.1, common, common)


def pieces_given(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sizes of the pieces that are given to be joined, of which none is."""
    sizes: list[int] = []

    def joined(part: Part, pieces: Sequence[tuple[None, IntArray]], *_: object) -> Part:
        sizes.extend(len(members) for _, members in pieces)
        return part

    monkeypatch.setattr(from_pictures, "with_pieces_joined", joined)
    return sizes


@pytest.mark.parametrize(("confirmed", "larger"), [(12, [20]), (18, [])])
def test_pictures_that_one_reconstruction_adds_are_joined_to_a_map_that_is_not_trusted_anyway(
    confirmed: int, larger: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a bedroom at half a picture a second two mappers placed all 73 pictures, and 13 of them differently: those
    were left out, because the third placed the other 60.
    """
    pieces = pieces_given(monkeypatch)
    found = taken({Mapper.OWN: 20, Mapper.INCREMENTAL: confirmed}, agreeing, monkeypatch)
    assert len(found.part.members) == confirmed
    assert pieces == larger
    np.testing.assert_array_equal(found.agreement.second_positions, found.T_map_camera[:, :3, 3])


def test_a_small_confirmed_part_does_not_replace_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    found = taken({Mapper.OWN: 18, Mapper.INCREMENTAL: 6}, agreeing, monkeypatch)
    assert len(found.part.members) == 18
    assert not found.agreement.same


def test_wholes_that_contradict_each_other_leave_the_part_that_both_confirm(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a corridor at a picture a second two mappers placed all pictures, each by other doors that look alike; a third
    one the six that follow each other, as both did.
    """

    def compared(one: Part, other: Part) -> Agreement:
        alone = min(len(one.members), len(other.members)) == 6
        return agreeing(one, other) if alone else Agreement(0.4, 0.6, 50.0, 18, 18)

    sizes, pieces = {Mapper.OWN: 18, Mapper.INCREMENTAL: 6, Mapper.GLOBAL: 18}, pieces_given(monkeypatch)
    assert len(taken(sizes, compared, monkeypatch).part.members) == 6
    assert pieces == []


def test_reconstructions_that_share_few_pictures_do_not_contradict_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of sixteen pictures of a corridor one mapper placed twelve, the other eight of these: the job failed."""
    apart = Agreement(np.nan, np.nan, np.nan, 6, 12)
    found = taken({Mapper.OWN: 12, Mapper.INCREMENTAL: 8}, lambda one, other: apart, monkeypatch)
    assert len(found.part.members) == 12
    assert not found.agreement.same


def test_each_of_those_that_disagree_is_tried_once_with_its_depths_reversed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both of pycolmap's mappers turned a flight's scene inside out, and confirmed each other."""
    tried = []

    def turned(part: Part) -> Part:
        tried.append(len(part.members))
        return Part(np.arange(20)) if len(part.members) == 16 else part

    def compared(one: Part, other: Part) -> Agreement:
        alike = len(one.members) == len(other.members)
        return agreeing(one, other) if alike else Agreement(0.1, 0.3, 9.0, 15, 15)

    sizes = {Mapper.DEPTH: 17, Mapper.OWN: 20, Mapper.INCREMENTAL: 16}
    found = taken(sizes, compared, monkeypatch, turned=turned)
    assert len(found.part.members) == 20
    assert found.agreement.same
    assert tried == [17, 20, 16]


def test_pycolmaps_two_are_tried_too_though_they_agree_if_there_is_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where our own start failed, a scene turned inside out by both of them was trusted."""
    tried = []

    def turned(part: Part) -> Part:
        tried.append(len(part.members))
        return Part(np.arange(20))

    found = taken({Mapper.INCREMENTAL: 19, Mapper.GLOBAL: 18}, agreeing, monkeypatch, turned=turned)
    assert tried == [19, 18]
    assert len(found.part.members) == 20


def test_two_that_agree_are_not_tried_if_one_is_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    def turned(part: Part) -> Part:
        pytest.fail("tried with its depths reversed")

    taken({Mapper.OWN: 12, Mapper.INCREMENTAL: 12, Mapper.GLOBAL: 12}, agreeing, monkeypatch, turned=turned)


def test_reconstructions_that_contradict_each_other_make_no_map(monkeypatch: pytest.MonkeyPatch) -> None:
    apart = Agreement(0.3, 0.5, 9.0, 12, 12)
    with pytest.raises(MappingFailed, match="contradict each other"):
        taken({Mapper.OWN: 12, Mapper.INCREMENTAL: 12}, lambda one, other: apart, monkeypatch)


@pytest.mark.parametrize("apart", [Agreement(0.3, 0.5, 9.0, 18, 18), Agreement(0.03, 1.2, 9.0, 18, 18), NOT_COMPARED])
def test_reconstructions_that_do_not_agree_make_an_untrusted_map_of_the_pictures_over_which_they_do(
    apart: Agreement, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a corridor at a picture in two seconds two mappers placed all 37 pictures, the first 14 alike and rightly. Of
    every sixth picture 12 were placed 4.3 m off, nine of them alike and to 5 cm.
    """
    cores, placed = [Part(np.arange(8)), Part(np.arange(8))], np.arange(COUNT) < 8

    def compared(one: Part, other: Part) -> Agreement:
        return agreeing(one, other) if len(one.members) == 8 else apart

    found = taken({Mapper.OWN: 18, Mapper.GLOBAL: 18}, compared, monkeypatch, held=placed, cores=cores)
    assert found.part is cores[0]
    assert found.frame.doubts == ("Reconstructions agree on 8 of 20 pictures only.",)
    assert found.disputed is not None
    assert np.flatnonzero(found.disputed).tolist() == list(range(8, 18))


def test_where_what_all_agree_on_hardly_overlaps_the_whole_is_taken_unless_it_is_contradicted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sizes, cores = {Mapper.OWN: 18, Mapper.GLOBAL: 18}, [Part(np.arange(8)), Part(np.arange(8))]
    monkeypatch.setattr(from_pictures, "_is_loose", lambda found: found.part is cores[0])

    def compared(apart: Agreement) -> Compared:
        return lambda one, other: agreeing(one, other) if len(one.members) == 8 else apart

    found = taken(sizes, compared(NOT_COMPARED), monkeypatch, cores=cores)
    assert len(found.part.members) == 18
    with pytest.raises(MappingFailed, match="contradict each other"):
        taken(sizes, compared(Agreement(0.3, 0.5, 9.0, 18, 18)), monkeypatch, cores=cores)


def test_a_map_of_what_all_agree_on_says_too_that_others_may_be_of_another_place(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cores, placed = [Part(np.arange(8)), Part(np.arange(8))], np.arange(COUNT) < 8
    pairs = [VerifiedPair(k, k + 1, np.zeros((40, 2), np.int64), np.eye(3)) for k in range(COUNT - 1)]
    sizes = {Mapper.OWN: 16, Mapper.GLOBAL: 16}

    def compared(one: Part, other: Part) -> Agreement:
        return agreeing(one, other) if len(one.members) == 8 else NOT_COMPARED

    found = taken(sizes, compared, monkeypatch, held=placed, cores=cores, pairs=pairs)
    assert found.note.startswith("4 further pictures fit each other, but not these")


@pytest.mark.parametrize(("sigma_m", "held"), [(3.0, True), (np.nan, True), (0.01, False)])
def test_what_nothing_confirms_and_little_ties_together_is_no_map(
    sigma_m: float, held: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a building at a picture a second, 66 of 90 pictures were published, 263 cm off. The advice must be right for
    pictures that are too close together, too: of twenty within a second more in between were asked for.
    """
    apart = Agreement(np.nan, np.nan, np.nan, 6, 12)
    with pytest.raises(MappingFailed, match=r"from places far enough apart\. Take pictures half a step apart"):
        taken({Mapper.OWN: 12, Mapper.INCREMENTAL: 8}, lambda one, other: apart, monkeypatch, sigma_m, held)


@pytest.mark.parametrize(("confirmed", "pictures"), [(True, 20), (False, 12)])
def test_pieces_are_joined_to_what_another_reconstruction_confirms(
    confirmed: bool, pictures: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(from_pictures, "with_pieces_joined", lambda *_: Part(np.arange(20)))

    def compared(one: Part, other: Part) -> Agreement:
        return agreeing(one, other) if confirmed else NOT_COMPARED

    assert len(taken({Mapper.OWN: 12, Mapper.INCREMENTAL: 12}, compared, monkeypatch).part.members) == pictures


@pytest.mark.parametrize(("confirmed", "joined", "checked"), [(18, 20, True), (16, 20, False), (17, 18, False)])
def test_pieces_that_nothing_confirms_are_no_reason_to_trust_a_map(
    confirmed: int, joined: int, checked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sixteen of twenty pictures alone are too few to be trusted; joined, they hid that nothing confirms the others."""
    monkeypatch.setattr(from_pictures, "with_pieces_joined", lambda *_: Part(np.arange(joined)))
    found = taken({Mapper.OWN: confirmed, Mapper.INCREMENTAL: confirmed}, agreeing, monkeypatch)
    assert found.agreement is not None
    assert found.agreement.same is checked
    assert found.agreement.common == confirmed


def waypoints_at(*pictures: int) -> tuple[Waypoint, ...]:
    """Waypoints that do not lie on a line, at each of the pictures."""
    return tuple(Waypoint(f"W{at}", float(at), (float(at), at * at / 30, 1.0)) for at in pictures)


@pytest.mark.parametrize(
    ("placed", "common", "joined", "waypoints"),
    [
        (18, 16, [], []),
        (18, 12, [20], []),
        (17, 16, [20], []),
        (18, 16, [], [waypoints_at(0, 5, 15)]),
        (18, 16, [20], [waypoints_at(0, 5, 19)]),
    ],
)
def test_a_map_that_may_be_trusted_alone_gets_no_pictures_that_would_take_its_trust(
    placed: int,
    common: int,
    joined: list[int],
    waypoints: list[tuple[Waypoint, ...]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of twenty pictures, 18 placed and 16 confirmed suffice for trust, until two more join that nothing confirms.
    Where the 18 miss waypoints, the others join.
    """
    pieces = pieces_given(monkeypatch)
    sizes = {Mapper.OWN: 20, Mapper.INCREMENTAL: placed}
    compared = Agreement(0.001, 0.002, 0.1, common, placed)
    found = taken(sizes, lambda *_: compared, monkeypatch, waypoints=waypoints)
    assert pieces == joined
    assert found.agreement is not None
    assert found.agreement.same is (common >= 0.7 * placed)


@pytest.mark.parametrize(("pictures", "reached"), [(18, True), (12, False)])
def test_waypoints_whose_pictures_are_missing_are_not_used_and_the_map_says_so(
    pictures: int, reached: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes = {Mapper.OWN: pictures, Mapper.INCREMENTAL: pictures}
    doubts = taken(sizes, agreeing, monkeypatch, waypoints=[waypoints_at(0, 5, 15)]).frame.doubts
    assert doubts == (() if reached else (from_pictures._WAYPOINTS_MISSED,))


def test_a_picture_that_agreeing_reconstructions_place_differently_is_left_out() -> None:
    """Of ten pictures of a kitchen one showed a small patch of what the others did, and was 51 cm off: two
    reconstructions agreed on the other nine, and the map with all ten was trusted.
    """
    found: Any = Result(Part(np.arange(COUNT)), np.zeros((COUNT, 6, 6)), np.ones(COUNT, np.bool_))
    second = found.T_map_camera[:, :3, 3].copy()
    second[[0, 3], 1] += 0.25, 0.15  # the depth is 2
    second[5] = np.nan
    left = from_pictures._without_disputed(replace(found, agreement=replace(NOT_COMPARED, second_positions=second)))
    assert np.flatnonzero(~left.placed).tolist() == np.flatnonzero(left.disputed).tolist() == [0]


@pytest.mark.parametrize(
    ("distance", "at_last", "left_out"), [(0.001, 0.001, [0]), (0.03, 0.001, []), (0.001, 0.03, []), (0.001, 0.2, [])]
)
def test_pictures_are_left_out_where_the_reconstructions_agree_on_the_others(
    distance: float, at_last: float, left_out: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    off_m = np.zeros(COUNT)
    off_m[0] = 0.25  # the depth is 2
    sizes = {Mapper.OWN: COUNT, Mapper.INCREMENTAL: COUNT}
    final = Agreement(at_last, at_last, 0.1, COUNT, COUNT)
    found = taken(
        sizes, lambda *_: Agreement(distance, distance, 0.1, COUNT, COUNT), monkeypatch, off_m=off_m, final=final
    )
    assert np.flatnonzero(~found.placed).tolist() == left_out
    assert found.agreement is not None
    assert found.agreement.same is (distance < 0.02 and at_last < 0.1)


def test_a_missing_picture_needs_a_clear_pair_beside_what_looks_alike() -> None:
    """A picture of one door was placed at another like it, 25 m off, by pairs that were weak beside its own door's."""
    pixels = np.random.default_rng(0).uniform(0, 400, (8, 2)).astype(np.float32)
    matches = np.column_stack([np.arange(8)] * 2)
    linked = [VerifiedPair(a, b, matches, np.eye(3)) for a, b in ((0, 1), (2, 3), (1, 4))]
    doors, beside = VerifiedPair(0, 2, matches, np.eye(3)), VerifiedPair(0, 4, matches, np.eye(3))
    state = State(np.tile(np.eye(4), (2, 1, 1)), np.zeros((0, 3)), CAMERA)
    part: Any = type("Part", (), {"members": np.arange(2), "adjusted": type("Adjusted", (), {"state": state})()})()
    sights: Any = type("Sights", (), {"rows": np.arange(5), "features": [_Pixels(pixels)] * 5})()
    evidence: Any = type("Evidence", (), {"sequential": linked, "weak": [doors, beside]})()
    assert from_pictures._fitting(part, Pictured(sights, CAMERA, evidence)) == [beside]


@pytest.mark.parametrize(("factor", "contradicted"), [(1.0, False), (3.3, True), (0.3, True)])
def test_pairs_contradict_a_focal_length_that_is_far_off(
    factor: float, contradicted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The adjustment, which begins at 1740 px in place of 525, found no better one near it: the map was trusted."""

    def stays(problem: Any, state: State, *_: object, **__: object) -> Any:
        return type("Adjusted", (), {"state": state, "camera_sigmas": lambda _: np.array([1.0])})()

    monkeypatch.setattr(from_pictures, "adjust", stays)
    points, undistorted = cloud(90), replace(CAMERA, distortion=())
    places = [undistorted.focal * on_plane(points, T) + (CAMERA.cx, CAMERA.cy) for T in arc(6)]
    features = [_Pixels(place) for place in places]
    pairs = [VerifiedPair(a, b, np.column_stack([np.arange(90)] * 2), np.eye(3)) for a in range(6) for b in range(a)]
    given = replace(undistorted, fx=factor * CAMERA.fx, fy=factor * CAMERA.fy)
    sights: Any = type("Sights", (), {"rows": np.arange(6), "features": features, "lenses": None})()
    evidence: Any = type("Evidence", (), {"sequential": pairs})()
    problem = Problem(np.arange(6.0), Observations(*np.zeros((2, 0), np.int64), np.zeros((0, 2))), camera_sigmas=GIVEN)
    adjusted: Any = type("Adjusted", (), {"state": State(arc(6), points, given)})()
    part = _Part(np.arange(6), problem, adjusted)
    doubts = from_pictures._doubts_about_focal(part, Pictured(sights, given, evidence), given)
    assert bool(doubts) is contradicted
    assert not contradicted or "contradict the focal length" in doubts[0]


@pytest.mark.parametrize(("linked", "said"), [(3, ""), (4, "4 further pictures fit each other, but not these")])
def test_pictures_that_fit_each_other_alone_may_be_of_another_place(linked: int, said: str) -> None:
    """Two rooms in one folder: the second one's pictures were missing without a word on why."""
    placed: Any = Result(Part(np.arange(12)), np.zeros((COUNT, 6, 6)), np.arange(COUNT) < 12)
    first = [
        VerifiedPair(k, k + 1, np.zeros((40, 2), np.int64), np.eye(3)) for k in range(12)
    ]  # the last to one without
    others = [VerifiedPair(k, k + 1, np.zeros((40, 2), np.int64), np.eye(3)) for k in range(13, 12 + linked)]
    found = from_pictures._elsewhere(placed, [*first, *others])
    assert found.startswith(said)
    assert bool(found) is bool(said)


def test_a_map_says_that_the_waypoints_alone_join_it() -> None:
    assert from_pictures._by_waypoints((76, 40, 6)) == (
        "Only the waypoints connect its pieces of 76, 40 and 6 pictures."
    )
    assert from_pictures._by_waypoints(()) == ""
