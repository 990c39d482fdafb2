"""The map as localization needs it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rholoc.features import FeatureSet, Metric
from rholoc.features.matching import LIMITS
from rholoc.geometry import ByteArray, Pose
from rholoc.localization import Localizer
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.index.matches import guided_chances
from rholoc.maps import Map


def test_what_was_seen_alike_is_what_the_views_that_share_most_saw(localizer: Localizer, room_map: Map) -> None:
    of_view = np.split(room_map.observations.features, room_map.view_offsets[1:-1])
    seen = localizer.index.seen_alike(of_view[7], 1)
    np.testing.assert_array_equal(np.flatnonzero(seen), np.unique(of_view[7]))

    more = localizer.index.seen_alike(of_view[7], 3)
    assert (more & seen).sum() == seen.sum()
    assert localizer.index.seen_alike(of_view[7], len(of_view)).sum() == len(np.unique(room_map.observations.features))


_COUNTS = np.array([1, 3, 2, 1, 4, 2])  # of descriptors, by landmark
_OWNERS = np.repeat(np.arange(6), _COUNTS)


@pytest.fixture
def small(room_map: Map) -> MapIndex:
    """Six landmarks with several descriptors each, the last two on another channel, seen by five views."""
    rng = np.random.default_rng(4)
    descriptors = rng.integers(0, 256, (len(_OWNERS), 32), dtype=np.uint8)
    views = np.repeat(np.arange(5), 3)
    features = np.concatenate([[0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 5], [0, 4, 5]])
    return MapIndex(
        replace(
            room_map,
            landmarks=replace(
                room_map.landmarks,
                channels=np.array([0, 0, 0, 0, 1, 1], np.uint8),
                positions=room_map.landmarks.positions[:6],
                covariances=room_map.landmarks.covariances[:6],
            ),
            descriptors=replace(room_map.descriptors, values=descriptors, features=_OWNERS.astype(np.int32)),
            views=replace(room_map.views, times=room_map.views.times[:5], T_map_camera=room_map.views.T_map_camera[:5]),
            observations=replace(
                room_map.observations, views=views.astype(np.int32), features=features.astype(np.int32)
            ),
        )
    )


def _hamming(a: ByteArray, b: ByteArray) -> int:
    return int(np.unpackbits(a ^ b).sum())


def test_rows_of_descriptors_are_those_of_the_landmarks(small: MapIndex) -> None:
    for asked in ([0], [4, 1], [5, 5, 2], [3, 0, 4]):
        expected = np.concatenate([np.flatnonzero(landmark == _OWNERS) for landmark in asked])
        np.testing.assert_array_equal(small.descriptor_rows(np.array(asked)), expected)


def test_a_landmark_is_as_far_as_its_nearest_descriptor_and_never_across_channels(small: MapIndex) -> None:
    rng = np.random.default_rng(1)
    channels = np.array([0, 1, 0, 1], np.uint8)
    zeros = np.zeros(4, np.float32)
    features = FeatureSet(np.zeros((4, 2), np.float32), channels, rng.integers(0, 256, (4, 32), np.uint8), zeros, zeros)
    detections, landmarks = (pairs.ravel() for pairs in np.meshgrid(np.arange(4), np.arange(6), indexing="ij"))
    found = small.distances_to(features, detections, landmarks)
    alone = [
        small.distances_to(features, *pair)[0] for pair in zip(detections[:, None], landmarks[:, None], strict=True)
    ]
    np.testing.assert_array_equal(alone, found)
    for detection, landmark, distance in zip(detections, landmarks, found, strict=True):
        if channels[detection] != small.map.landmarks.channels[landmark]:
            assert distance == np.inf
            continue
        own = small.map.descriptors.values[landmark == _OWNERS]
        assert distance == min(_hamming(features.descriptors[detection], one) for one in own)
    across = small.distances_to(features, np.array([0]), np.array([5]))
    np.testing.assert_array_equal(across, [np.inf])


def test_what_views_saw(small: MapIndex) -> None:
    np.testing.assert_array_equal(small.seen_from(np.array([0])), [0, 1, 2])
    np.testing.assert_array_equal(small.seen_from(np.array([4, 1])), [0, 1, 2, 3, 4, 5])
    np.testing.assert_array_equal(small.seen_from(np.zeros(0, np.int64)), [])
    expected = [[3, 2, 1, 0, 1], [2, 3, 2, 1, 0], [1, 2, 3, 2, 1], [0, 1, 2, 3, 2], [1, 0, 1, 2, 3]]
    np.testing.assert_array_equal([small.shared_with(view) for view in range(5)], expected)


def test_the_maps_covariance_is_of_the_views_that_saw_most(small: MapIndex) -> None:
    assert small.map_covariance(np.array([0]), np.zeros(3), 2) is None
    sigmas_m = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    known = np.array([np.diag([s**2] * 3 + [0.0] * 3) for s in sigmas_m]).astype(np.float32)
    index = MapIndex(replace(small.map, views=replace(small.map.views, covariances=known)))
    first = index.map_covariance(np.array([0, 1, 2]), np.zeros(3), 1)
    assert first is not None
    np.testing.assert_allclose(first, known[0], rtol=1e-6)
    both = index.map_covariance(np.array([1, 2, 3]), np.zeros(3), 2)  # view 1 saw three of them, view 0 two
    assert both is not None
    np.testing.assert_allclose(np.diag(both)[:3], (3 * 4.0 + 2 * 1.0) / 5, rtol=1e-6)


def test_matches_near_a_pose_are_mutual_near_and_alike(localizer: Localizer, point_room: Any) -> None:
    """Against all pairs, one by one."""
    index, truth, radius_px = localizer.index, point_room.walk(9)[4], 12.0
    features = point_room.see(truth, 42)
    found, by_chance = index.match_near(features, point_room.camera, truth.T_map_camera, radius_px)
    pixels = point_room.camera.project((index.landmarks - truth.position) @ truth.R_map_camera)
    may_be = index.present(truth.position) & point_room.camera.contains(pixels)
    apart = np.linalg.norm(features.pixels[:, None] - pixels, axis=2)
    close = (apart <= radius_px) & may_be
    np.testing.assert_allclose(by_chance, 1 - (1 - index.chance_of_likeness) ** close.sum(axis=1))
    distances = np.full(apart.shape, np.inf)
    rows = np.nonzero(close)
    distances[rows] = index.distances_to(features, *rows)
    distances[distances > LIMITS[Metric.HAMMING].loose] = np.inf
    best = np.isfinite(distances) & (distances == distances.min(1, keepdims=True)) & (distances == distances.min(0))
    assert len(found) > 80
    order = np.lexsort((found.landmarks, found.detections))
    np.testing.assert_array_equal(np.column_stack([found.detections, found.landmarks])[order], np.argwhere(best))
    np.testing.assert_allclose(found.chances[order], guided_chances(distances[best], Metric.HAMMING))
    nothing = features.take(np.zeros(0, np.int64))
    for some, pose in ((nothing, truth), (features, Pose.from_heading(np.array([90.0, 0, 0]), truth.heading))):
        none, chances = index.match_near(some, point_room.camera, pose.T_map_camera, radius_px)
        assert len(none) == 0
        np.testing.assert_array_equal(chances, np.zeros(len(some)))


def test_chance_finds_no_likeness_among_random_descriptors_and_all_among_equal_ones(small: MapIndex) -> None:
    assert small.chance_of_likeness == 0.0
    equal = MapIndex(
        replace(
            small.map, descriptors=replace(small.map.descriptors, values=np.zeros_like(small.map.descriptors.values))
        )
    )
    assert equal.chance_of_likeness == 1.0
    half = small.map.descriptors.values.copy()
    half[:6] = 0  # the landmarks 0, 1 and 2: of the pairs of strangers on one channel …
    pairs = [(a, b) for a in range(13) for b in range(13) if _OWNERS[a] != _OWNERS[b] and (a < 7) == (b < 7)]
    alike = np.mean([a < 6 and b < 6 for a, b in pairs])
    assert MapIndex(
        replace(small.map, descriptors=replace(small.map.descriptors, values=half))
    ).chance_of_likeness == pytest.approx(alike, abs=0.02)


@pytest.mark.parametrize(("roll_deg", "upright", "seen"), [(2.0, True, True), (6.0, True, False), (2.0, False, False)])
def test_a_map_of_upright_views(room_map: Map, roll_deg: float, upright: bool, seen: bool) -> None:
    poses = [Pose.from_heading(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.deg2rad(roll_deg)).T_map_camera] * 60
    info = replace(room_map.info, upright=upright)
    assert (
        MapIndex(replace(room_map, info=info, views=replace(room_map.views, T_map_camera=np.array(poses)))).seen_upright
        == seen
    )


def test_a_map_without_views_was_seen_by_nobody_upright(room_map: Map) -> None:
    none = np.zeros(0, np.int32)
    map_ = replace(
        room_map,
        views=replace(room_map.views, times=room_map.views.times[:0], T_map_camera=room_map.views.T_map_camera[:0]),
        observations=replace(room_map.observations, views=none, features=none),
    )
    assert not MapIndex(map_).seen_upright


def _features(descriptors: ByteArray, channels: list[int]) -> FeatureSet:
    zeros = np.zeros(len(descriptors), np.float32)
    return FeatureSet(
        np.zeros((len(descriptors), 2), np.float32), np.array(channels, np.uint8), descriptors, zeros, zeros
    )


def test_the_four_nearest_landmarks_are_looked_up_by_their_first_descriptors(small: MapIndex) -> None:
    rng = np.random.default_rng(9)
    features = _features(rng.integers(0, 256, (5, 32), dtype=np.uint8), [0, 0, 1, 0, 1])
    first = small.map.descriptors.values[np.searchsorted(_OWNERS, np.arange(6))]
    for some in (None, np.array([4, 1])):
        found = small.nearest_everywhere(features, some)
        assert found.detections.tolist() == (list(range(5)) if some is None else [4, 1])
        for row, detection in enumerate(found.detections):
            mine = [m for m in range(6) if small.map.landmarks.channels[m] == features.channels[detection]]
            far = {m: _hamming(features.descriptors[detection], first[m]) for m in mine}
            nearest = sorted(far, key=lambda m: far[m])
            assert sorted(found.distances[row][np.isfinite(found.distances[row])]) == sorted(far.values())
            assert found.landmarks[row].tolist()[: len(mine)] == nearest or len(set(far.values())) < len(mine)
            assert found.landmarks[row].tolist()[len(mine) :] == [-1] * (4 - len(mine))


def test_within_a_place_all_descriptors_count_or_the_first_ones_of_some_features(small: MapIndex) -> None:
    own = small.map.descriptors.values[1:4]  # all of the landmark 1
    features = _features(np.concatenate([own, small.map.descriptors.values[4:5]]), [0] * 4)  # and the first of 2
    found = small.match_within(features, np.array([1, 2]))
    assert set(zip(found.detections.tolist(), found.landmarks.tolist(), strict=True)) == {
        (0, 1),
        (1, 1),
        (2, 1),
        (3, 2),
    }
    by_first = small.match_within(features, np.array([1, 2]), some=np.array([3, 2, 0]))
    assert set(zip(by_first.detections.tolist(), by_first.landmarks.tolist(), strict=True)) == {(3, 2), (0, 1)}
    only = small.match_within(features, np.array([0]))
    assert len(only) == 0
    alone = small.match_within(_features(small.map.descriptors.values[:1], [0]), np.array([0]))
    assert alone.landmarks.tolist() == [0]


def test_of_two_features_alike_the_more_alike_has_the_landmark_and_of_two_landmarks_the_feature(
    room_map: Map, point_room: Any
) -> None:
    """Two landmarks a centimetre apart, of descriptors eight bits apart, each seen again four bits off."""
    pose, camera = Pose(room_map.views.T_map_camera[20]), point_room.camera
    descriptor = np.random.default_rng(0).integers(0, 256, 32, dtype=np.uint8)
    other, between = descriptor.copy(), descriptor.copy()
    other[0] ^= 0xFF
    between[0] ^= 0x03
    places = pose.position + 3 * pose.heading + np.array([[0.0, 0, 0], [0, 0, 0.01]])
    map_ = replace(
        room_map,
        landmarks=replace(
            room_map.landmarks,
            channels=np.zeros(2, np.uint8),
            positions=places.astype(np.float32),
            covariances=room_map.landmarks.covariances[:2],
        ),
        descriptors=replace(
            room_map.descriptors, values=np.stack([descriptor, other]), features=np.arange(2, dtype=np.int32)
        ),
        views=replace(
            room_map.views, times=room_map.views.times[19:21], T_map_camera=room_map.views.T_map_camera[19:21]
        ),
        observations=replace(
            room_map.observations, views=np.array([0, 0, 1, 1], np.int32), features=np.array([0, 1, 0, 1], np.int32)
        ),
    )
    index = MapIndex(map_, chance=0.25)
    pixels = camera.project((places - pose.position) @ pose.R_map_camera)
    features = replace(_features(np.stack([between, descriptor]), [0, 0]), pixels=pixels[[0, 0]].astype(np.float32))
    found, by_chance = index.match_near(features, camera, pose.T_map_camera, 10.0)
    assert list(zip(found.detections.tolist(), found.landmarks.tolist(), strict=True)) == [(1, 0)]
    np.testing.assert_allclose(by_chance, 1 - 0.75**2)
    first, by_chance = index.match_near(features, camera, pose.T_map_camera, 10.0, some=np.array([0]))
    assert list(zip(first.detections.tolist(), first.landmarks.tolist(), strict=True)) == [(0, 0)]
    np.testing.assert_allclose(by_chance, [1 - 0.75**2, 0.0])
    apart_px = float(np.linalg.norm(pixels[1] - pixels[0]))
    _, near_only = index.match_near(features, camera, pose.T_map_camera, 0.9 * apart_px)
    np.testing.assert_allclose(near_only, 0.25)


def test_four_fifths_of_upright_views_make_a_map_upright(room_map: Map) -> None:
    heading = np.array([0.6, 0.8, 0.0])
    for leaning, upright in ((9, True), (15, False)):
        for roll_deg, expected in ((5.0, upright), (3.0, True), (-5.0, upright)):
            rolls = np.deg2rad(np.where(np.arange(60) < leaning, roll_deg, 0.0))
            poses = [Pose.from_heading(np.zeros(3), heading, roll).T_map_camera for roll in rolls]
            assert (
                MapIndex(replace(room_map, views=replace(room_map.views, T_map_camera=np.array(poses)))).seen_upright
                is expected
            )
