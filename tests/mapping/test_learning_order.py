"""What a map has learned does not depend on the order of learning, and can be forgotten, to 1e-6 m."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rholoc.density import ObservedDensities
from rholoc.density.localities import Places
from rholoc.density.observed import RIDGE, observation_coefficients
from rholoc.errors import InvalidInput
from rholoc.features import FeatureSet, Metric
from rholoc.geometry import Camera, FloatArray, IntArray, Pose, Similarity
from rholoc.localization import Dof, Localizer, Query
from rholoc.mapping.build.assembly import assemble
from rholoc.mapping.build.density_fitting import fit_densities, ray_form, sightings_of
from rholoc.mapping.build.landmarks import Landmarks
from rholoc.mapping.build.recursive_densities import check_forgetting, with_learned_densities
from rholoc.mapping.build.stored_observations import with_landmarks
from rholoc.mapping.build.tracks import Views
from rholoc.mapping.edit.moving import move_map
from rholoc.mapping.edit.sources import join, without_source
from rholoc.maps import DensityKind, Map, MapInfo, Source, packed_pixels, unpacked_pixels, validate_map
from rholoc_lab.paper.equations import batch_fit
from same_maps import assert_same_tables

EXACT_M = 1e-6
CAMERA = Camera(640, 480, 520.0, 520.0, 319.5, 239.5)
POINTS = 40


@dataclass(frozen=True, eq=False)
class Tracks:
    """What recordings saw of the same points: views, the recording (K,) of each, the point (N,) of each detection."""

    views: Views
    recording_of: IntArray
    points: IntArray

    def map_of(self, recordings: Sequence[int]) -> Map:
        """All features of some recordings, assembled at once; no landmark is found yet."""
        chosen = [k for recording in recordings for k in np.flatnonzero(self.recording_of == recording)]
        views = Views.from_features(
            [CAMERA] * len(chosen),
            self.views.T_map_camera[chosen],
            self.views.times[chosen],
            [self.views.of_view(k) for k in chosen],
        )
        rows = np.concatenate([np.arange(self.views.offsets[k], self.views.offsets[k + 1]) for k in chosen])
        seen, labels = np.unique(self.points[rows], return_inverse=True)
        nowhere, unknown = np.zeros((len(seen), 3)), np.zeros((len(seen), 3, 3))
        sources = np.array([list(recordings).index(self.recording_of[k]) for k in chosen])
        landmarks = Landmarks(unknown, nowhere, labels, nowhere, unknown)
        return assemble(_info([f"walk-{r}" for r in recordings]), views, landmarks, sources, Metric.HAMMING)


def _info(names: Sequence[str]) -> MapInfo:
    sources = tuple(Source(name, f"{name}-id", CAMERA) for name in names)
    return MapInfo("0" * 32, 1, DensityKind.RAY, "gray", True, True, "2026-01-01T00:00:00Z", CAMERA, sources)


def tracks(seed: int, recordings: int = 3, views_each: int = 6) -> Tracks:
    """Points seen with noise and gross errors, not every one by every recording; descriptors tell their number."""
    rng = np.random.default_rng(seed)
    places = rng.uniform([-1.5, 3, 0.3], [1.5, 5, 2.3], (POINTS, 3))
    known = rng.random((recordings, POINTS)) < 0.7
    descriptors = np.zeros((POINTS, 32), dtype=np.uint8)
    descriptors[:, 0] = np.arange(POINTS)
    T, features, labels, recording_of = [], [], [], []
    for recording in range(recordings):
        for _ in range(views_each):
            position = rng.uniform([-1, -0.5, 1.0], [1, 0.5, 1.6])
            pose = Pose.from_heading(position, np.array([0.2 * rng.normal(), 1.0, 0.1 * rng.normal()]))
            pixels = CAMERA.project((places - position) @ pose.R_map_camera)
            seen = np.flatnonzero(CAMERA.contains(pixels) & known[recording])
            noise = rng.normal(size=(len(seen), 2)) * np.where(rng.random((len(seen), 1)) < 0.05, 30.0, 0.7)
            flat = np.zeros(len(seen), np.float32)
            detected = np.clip(pixels[seen] + noise, [0, 0], [639, 479]).astype(np.float32)
            features.append(FeatureSet(detected, flat.astype(np.uint8), descriptors[seen], flat, flat))
            T.append(pose.T_map_camera)
            labels.append(seen)
            recording_of.append(recording)
    views = Views.from_features([CAMERA] * len(T), np.array(T), np.arange(len(T)) / 10, features)
    return Tracks(views, np.array(recording_of), np.concatenate(labels))


def points_of(map_: Map) -> IntArray:
    """The point (F,) that each feature is."""
    return map_.descriptors.values[np.searchsorted(map_.descriptors.features, np.arange(len(map_)))][:, 0].astype(
        np.int64
    )


def learned(given_tracks: Tracks, order: Sequence[int]) -> Map:
    """The map that learned the recordings one after the other."""
    map_ = with_landmarks(given_tracks.map_of(order[:1]))
    for recording in order[1:]:
        other = given_tracks.map_of([recording])
        row = {int(point): row for row, point in enumerate(points_of(map_))}
        map_ = join(map_, other, np.array([row.get(int(point), -1) for point in points_of(other)]))
    return map_


def landmarks_by_point(map_: Map, sightings: IntArray) -> FloatArray:
    """(POINTS, 3), NaN where the map has no landmark, or one that was not seen as often as ``sightings`` (POINTS,)."""
    found = np.full((POINTS, 3), np.nan)
    points = points_of(map_)
    whole = np.bincount(map_.observations.features, minlength=len(map_)) == sightings[points]
    found[points[whole]] = map_.landmarks.positions[whole]
    return found


def assert_same_landmarks(a: Map, b: Map) -> None:
    """Of all points that both saw equally often, which are most: what lies at the gate may count in one map alone."""
    sightings = np.bincount(points_of(b)[b.observations.features], minlength=POINTS)
    found, wanted = landmarks_by_point(a, sightings), landmarks_by_point(b, sightings)
    both = np.isfinite(found[:, 0]) & np.isfinite(wanted[:, 0])
    assert both.sum() >= 0.75 * len(b) > 0
    np.testing.assert_allclose(found[both], wanted[both], rtol=0, atol=EXACT_M)


@settings(max_examples=15)
@given(seed=st.integers(0, 10**6), order=st.permutations([0, 1, 2]))
def test_learning_in_any_order_is_building_from_all_at_once(seed: int, order: list[int]) -> None:
    given_tracks = tracks(seed)
    assert_same_landmarks(learned(given_tracks, order), with_landmarks(given_tracks.map_of([0, 1, 2])))


@settings(max_examples=15)
@given(seed=st.integers(0, 10**6), order=st.permutations([0, 1, 2]), forgotten=st.integers(0, 2))
def test_forgetting_leaves_a_map_that_never_learned_it(seed: int, order: list[int], forgotten: int) -> None:
    given_tracks = tracks(seed)
    map_ = learned(given_tracks, order)
    left = without_source(map_, order.index(forgotten))
    others = [recording for recording in order if recording != forgotten]
    assert [source.name for source in left.info.sources] == [f"walk-{recording}" for recording in others]
    assert_same_landmarks(left, with_landmarks(given_tracks.map_of(others)))


@settings(max_examples=15)
@given(seed=st.integers(0, 10**6))
def test_forgetting_undoes_learning_to_the_last_array(seed: int) -> None:
    given_tracks = tracks(seed)
    before = learned(given_tracks, [0, 1])
    points = {int(point): row for row, point in enumerate(points_of(before))}
    other = given_tracks.map_of([2])
    after = join(before, other, np.array([points.get(int(point), -1) for point in points_of(other)]))
    assert len(after.observations) > len(before.observations.features)
    undone = without_source(after, 2)
    np.testing.assert_allclose(undone.landmarks.positions, before.landmarks.positions, rtol=0, atol=EXACT_M)
    np.testing.assert_allclose(undone.landmarks.covariances, before.landmarks.covariances, rtol=1e-4, atol=1e-9)
    exact = replace(undone.landmarks, positions=before.landmarks.positions, covariances=before.landmarks.covariances)
    assert_same_tables(replace(undone, landmarks=exact), before)


def test_a_recording_never_spoils_a_landmark_that_was_known() -> None:
    given_tracks = tracks(3)
    a, b = with_landmarks(given_tracks.map_of([0])), given_tracks.map_of([1])
    rng = np.random.default_rng(0)
    wrong = rng.permutation(len(a))[: len(b)]  # every feature taken for another one
    joined = join(a, b, np.concatenate([wrong, np.full(len(b) - len(wrong), -1)]))
    assert set(points_of(a).tolist()) <= set(points_of(joined).tolist())
    left = without_source(joined, 1)
    np.testing.assert_allclose(left.landmarks.positions, a.landmarks.positions, rtol=0, atol=EXACT_M)


def test_a_moved_map_has_moved_landmarks_and_rotated_information() -> None:
    map_ = with_landmarks(tracks(5).map_of([0, 1]))
    similarity = Similarity(
        1.0, Rotation.from_euler("zyx", [40, 5, -3], degrees=True).as_matrix(), np.array([3, -2, 1])
    )
    moved = move_map(map_, similarity)
    np.testing.assert_allclose(
        moved.landmarks.positions, similarity.points(map_.landmarks.positions.astype(np.float64)), atol=2e-5
    )
    for before, after in zip(map_.landmarks.covariances, moved.landmarks.covariances, strict=True):
        turned = similarity.rotation @ before @ similarity.rotation.T
        np.testing.assert_allclose(after, turned, rtol=0.02, atol=0.02 * np.trace(before))


@pytest.mark.parametrize("size", [(640, 480), (3840, 2160)])
def test_pixels_are_kept_to_a_fraction_of_what_a_detector_can_tell(size: tuple[int, int]) -> None:
    camera = Camera(*size, 520.0 * size[0] / 640, 520.0 * size[0] / 640, size[0] / 2, size[1] / 2)
    pixels = np.random.default_rng(0).uniform(-0.5, np.array(size) - 0.5, (1000, 2))
    np.testing.assert_allclose(unpacked_pixels(packed_pixels(pixels, camera), camera), pixels, atol=0.06)


_FIRST_VIEWS = 16


@pytest.fixture(scope="module")
def after(point_room: Any) -> Map:
    return point_room.map_of(point_room.walk(150)[:24], "walk")


@pytest.fixture(scope="module")
def before(after: Map) -> Map:
    """The map as its first views alone make it."""
    count = int(after.view_offsets[_FIRST_VIEWS])
    views = after.views.take(np.arange(_FIRST_VIEWS))
    first = replace(after, views=views, observations=after.observations.take(np.arange(count)))
    return fit_densities(first, DensityKind.OBSERVED)


@pytest.mark.parametrize("forgetting", [1.0, 0.9])
def test_one_at_a_time_is_one_batch_of_all(before: Map, after: Map, forgetting: float) -> None:
    learned = with_learned_densities(before, ray_form(after), forgetting).densities
    known = before.densities
    assert isinstance(known, ObservedDensities)
    assert isinstance(learned, ObservedDensities)
    sightings, members = sightings_of(after), Places.of(sightings_of(before)).members
    assert sightings.bearings is not None
    compared = 0
    for t in np.flatnonzero(known.counts >= 5)[:40].tolist():
        (row,) = np.flatnonzero((learned.features == known.features[t]) & (learned.places == known.places[t]).all(1))
        more = int(learned.counts[row] - known.counts[t])
        later = np.flatnonzero(sightings.features == known.features[t])
        later = later[later >= len(before.observations)]
        if more != len(later):
            continue  # some of them were of another place
        rows = np.concatenate([members[t], later])
        phi = known.position_monomials(t, sightings.positions[rows])
        values = observation_coefficients(sightings.bearings[rows] @ known.R_local_map[t].T, 2)
        weight = np.where(np.arange(len(rows)) < len(members[t]), forgetting**more, 1.0)
        weight[len(members[t]) :] = forgetting ** np.arange(more - 1, -1, -1.0)
        root = np.sqrt(weight)[:, None]
        batch = batch_fit(root * phi, root * values, RIDGE * forgetting**more)
        u, x, h = learned.coefficients.shape[1:]
        expected = batch.coefficients.reshape(x, u, h).transpose(1, 0, 2)
        assert np.allclose(learned.coefficients[row], expected, atol=2e-3 * np.abs(expected).max())
        compared += more > 0
    assert compared > 5


def test_the_map_is_whole_and_localizes(before: Map, after: Map, point_room: Any) -> None:
    map_ = with_learned_densities(before, ray_form(after), 0.98)
    validate_map(map_)
    assert set(np.unique(map_.densities.arrays()["features"]).tolist()) == set(range(len(map_)))
    pose = point_room.walk(150)[20]
    answer = Localizer(map_).localize(Query(point_room.see(pose, 5), point_room.camera, Dof.FREE))
    assert np.linalg.norm(answer.pose.position - pose.position) < 0.05


@pytest.mark.parametrize("forgetting", [0.0, -1.0, 1.5, float("nan")])
def test_an_impossible_forgetting_is_refused(before: Map, forgetting: float) -> None:
    with pytest.raises(InvalidInput, match="not a valid forgetting factor"):
        check_forgetting(before, forgetting)


def test_other_densities_do_not_forget(after: Map) -> None:
    with pytest.raises(InvalidInput, match="'ray'"):
        check_forgetting(after, 0.9)
