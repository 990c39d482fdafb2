"""Tracks and landmarks against the points they should be."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from rholoc.errors import MappingFailed
from rholoc.features import Metric, get_extractor
from rholoc.mapping.build.landmarks import (
    Landmarks,
    are_stable,
    expected_sightings,
    extend_and_merge,
    representative_rows,
    triangulate,
    with_ranged,
)
from rholoc.mapping.build.pipeline import reconstruct
from rholoc.mapping.build.tracks import Views, link_observations, neighbour_pairs
from rholoc.progress import silent


@pytest.fixture(scope="module")
def landmarks(walked: Views) -> Landmarks:
    return triangulate(walked, link_observations(walked, Metric.HAMMING))


def test_landmarks_are_the_rooms_points(landmarks: Landmarks, point_room: Any) -> None:
    distance, _ = cKDTree(point_room.points).query(landmarks.positions)
    assert len(landmarks) > 600
    assert np.median(distance) < 0.02
    # honest uncertainty: errors of a few sigma, not of many
    sigma = np.sqrt(np.trace(landmarks.covariances, axis1=1, axis2=2))
    assert np.percentile(distance / sigma, 95) < 3


def test_no_landmark_is_seen_twice_in_a_view(landmarks: Landmarks, walked: Views) -> None:
    rows = landmarks.observed_rows
    seen = np.column_stack([landmarks.labels[rows], walked.view_of[rows]])
    assert len(np.unique(seen, axis=0)) == len(seen)


def test_positions_follow_from_the_information(landmarks: Landmarks) -> None:
    solved = np.linalg.solve(landmarks.information, landmarks.eta[..., None])[..., 0]
    np.testing.assert_allclose(landmarks.positions, solved, atol=1e-6)


def test_extension_finds_more_and_loses_no_accuracy(landmarks: Landmarks, walked: Views, point_room: Any) -> None:
    # half of the observations are hidden: looking where landmarks should be must find them again
    labels = landmarks.labels.copy()
    hidden = np.flatnonzero(labels >= 0)[::2]
    labels[hidden] = -1
    thinned = triangulate(walked, labels)
    extended = extend_and_merge(walked, thinned, Metric.HAMMING)
    assert extended.view_counts.sum() > 1.7 * thinned.view_counts.sum()
    distance, _ = cKDTree(point_room.points).query(extended.positions)
    assert np.median(distance) < 0.02


def test_split_tracks_are_merged(landmarks: Landmarks, walked: Views) -> None:
    labels = landmarks.labels.copy()
    late = (walked.view_of >= 30) & (labels >= 0)
    labels[late] += len(landmarks)
    kept = labels >= 0
    labels[kept] = np.unique(labels[kept], return_inverse=True)[1]
    split = triangulate(walked, labels)
    merged = extend_and_merge(walked, split, Metric.HAMMING)
    assert len(merged) < len(split)


def test_pictures_from_nearly_one_place_make_no_map_and_the_message_says_why(walked: Views) -> None:
    """Of pictures a few centimetres apart the message was "Only 1 features are stable", the advice to walk slower."""
    still = replace(walked, T_map_camera=np.repeat(walked.T_map_camera[:1], len(walked.T_map_camera), axis=0))
    with pytest.raises(MappingFailed, match=r"Too few points .*: 0 of the 60 .* farther and sideways"):
        reconstruct(still, get_extractor("gray"), silent)


def test_wrong_observations_lose_their_label(walked: Views, landmarks: Landmarks) -> None:
    labels = landmarks.labels.copy()
    victim = int(np.argmax(landmarks.view_counts))
    elsewhere = ~np.isin(walked.view_of, walked.view_of[labels == victim])
    intruder = int(np.flatnonzero((labels >= 0) & elsewhere)[0])
    labels[intruder] = victim
    again = triangulate(walked, labels)
    assert again.labels[intruder] == -1


def test_selection_keeps_what_is_seen_often(landmarks: Landmarks, walked: Views) -> None:
    few = landmarks.keep(are_stable(walked, landmarks, per_view=20))
    all_ = landmarks.keep(are_stable(walked, landmarks, per_view=10_000))
    assert len(few) < len(all_) <= len(landmarks)
    assert few.view_counts.min() >= 3
    assert few.view_counts.mean() > all_.view_counts.mean()


def test_of_several_walks_what_persists_is_chosen(landmarks: Landmarks, walked: Views) -> None:
    """Half of the landmarks are seen on the first of two walks alone, and there in every view."""
    count = len(landmarks)
    walks = (np.arange(len(walked)) % 2).astype(np.int64)
    fading = np.arange(count) % 2 == 0
    labels = landmarks.labels.copy()
    labels[(labels >= 0) & fading[labels] & (walks[walked.view_of] == 1)] = -1
    lasting_rows = np.flatnonzero((labels >= 0) & ~fading[labels])
    labels[lasting_rows[::2]] = -1  # they are seen less often in all, but on both walks
    seen = Landmarks(landmarks.information, landmarks.eta, labels, landmarks.positions, landmarks.covariances)

    expected = expected_sightings(walked, seen, walks)
    enough = landmarks.view_counts >= 8
    assert np.median(expected[fading & enough]) == pytest.approx(1 / 2)  # of two walks one
    assert np.median(expected[~fading & enough]) == pytest.approx(3 / 4)  # of two both

    def lasting_share(chosen: Landmarks) -> float:
        rows = chosen.observed_rows
        both = np.zeros((len(chosen), 2), dtype=bool)
        both[chosen.labels[rows], walks[walked.view_of[rows]]] = True
        return float(both.all(axis=1).mean())

    assert lasting_share(seen.keep(are_stable(walked, seen, 5, walks))) > 0.9
    assert lasting_share(seen.keep(are_stable(walked, seen, 5))) < 0.8


def test_a_walk_that_did_not_pass_says_nothing(landmarks: Landmarks, walked: Views) -> None:
    walks = np.zeros(len(walked), dtype=np.int64)
    alone = expected_sightings(walked, landmarks, walks)
    assert np.unique(alone).tolist() == [pytest.approx(2 / 3)]
    np.testing.assert_array_equal(
        landmarks.keep(are_stable(walked, landmarks, 20, walks)).positions,
        landmarks.keep(are_stable(walked, landmarks, 20)).positions,
    )


def test_what_two_views_saw_stays_only_where_views_have_little_else(landmarks: Landmarks, walked: Views) -> None:
    labels = landmarks.labels.copy()
    often = np.argsort(-landmarks.view_counts)[:40]
    for landmark in often:
        rows = np.flatnonzero(labels == landmark)
        labels[rows[1:-1]] = -1  # the first and the last view stay: the widest baseline
    thinned = triangulate(walked, labels)
    twice = thinned.view_counts == 2
    sigma = np.sqrt(np.linalg.eigvalsh(thinned.covariances)[:, -1])
    assert (twice & (sigma < 0.05)).sum() > 20
    assert are_stable(walked, thinned, 10_000)[twice & (sigma < 0.05)].all()  # no view has a hundred
    assert not are_stable(walked, thinned, 20)[twice].any()


def test_a_range_makes_a_landmark_of_one_view_and_a_wrong_one_spoils_none(
    landmarks: Landmarks, walked: Views, point_room: Any
) -> None:
    depths = np.linalg.norm(landmarks.positions[landmarks.labels] - walked.positions[walked.view_of], axis=1)
    tracked = landmarks.labels >= 0
    few = np.where(walked.view_of % 6 == 0, landmarks.labels, -1)
    ranged = replace(walked, ranges_m=np.where(tracked, depths, np.nan))
    labels = with_ranged(ranged, few)
    assert (labels[few >= 0] == few[few >= 0]).all()
    assert ((labels >= 0) == tracked).all()
    found = triangulate(ranged, labels)
    once = found.view_counts == 1
    assert once.sum() > 1000
    distance, _ = cKDTree(point_room.points).query(found.positions[once])
    assert np.percentile(distance, 95) < 0.06
    wrong = replace(walked, ranges_m=np.where(np.arange(len(depths)) % 5 == 0, 2 * depths, np.nan))
    spoiled = triangulate(wrong, landmarks.labels)
    often = landmarks.view_counts >= 5
    assert len(spoiled) == len(landmarks)
    moved_m = np.linalg.norm(spoiled.positions - landmarks.positions, axis=1)[often]
    assert np.percentile(moved_m, 99) < 0.02


def test_representatives_start_with_the_medoid(landmarks: Landmarks, walked: Views) -> None:
    rows = representative_rows(walked, landmarks.labels, len(landmarks), Metric.HAMMING, most=2)
    assert len(rows) == len(landmarks)
    for landmark, chosen in list(enumerate(rows))[:20]:
        assert 1 <= len(chosen) <= 2
        assert (landmarks.labels[chosen] == landmark).all()


def test_neighbours_are_near_in_time_or_alike(walked: Views) -> None:
    pairs = neighbour_pairs(walked)
    assert (pairs[:, 0] < pairs[:, 1]).all()
    assert {(0, 1), (10, 15)} <= set(map(tuple, pairs.tolist()))


def test_where_nothing_is_tracked_there_are_no_landmarks(walked: Views) -> None:
    none = triangulate(walked, np.full(len(walked.features), -1))
    for landmarks in (none, extend_and_merge(walked, none, Metric.HAMMING), none.keep(are_stable(walked, none, 500))):
        assert len(landmarks) == 0
        assert len(landmarks.labels) == len(walked.features)

    untriangulated = np.full(len(walked.features), -1)
    untriangulated[0] = 0  # seen once: no landmark either
    assert len(triangulate(walked, untriangulated)) == 0
