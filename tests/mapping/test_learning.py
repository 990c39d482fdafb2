"""Recordings and maps that find their place in a map and are learned, and those that do not and are refused."""

from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from rholoc.errors import Conflict, InvalidInput, InvalidMap, MappingFailed
from rholoc.features import FeatureSet
from rholoc.geometry import ByteArray, FloatArray, IntArray, Pose, Similarity
from rholoc.localization import Dof, Localizer, Query
from rholoc.mapping import update_map
from rholoc.mapping.build.density_fitting import fit_densities
from rholoc.mapping.edit.correcting import remove_views
from rholoc.mapping.edit.moving import move_map
from rholoc.mapping.edit.sources import forget_recording
from rholoc.mapping.learn import from_recordings as learning
from rholoc.mapping.learn.merging import merge_maps
from rholoc.maps import DensityKind, Map, check_memory, load_map, save_map, without_memory
from rholoc.recordings import GivenPoses, Recording
from rholoc.trajectory.estimate import estimate_trajectory
from rholoc.trajectory.visual.rolling_shutter import RollingShutter
from same_maps import assert_same_tables

TURN = Similarity(1.0, Rotation.from_euler("z", 70, degrees=True).as_matrix(), np.array([4.0, -1.0, 0.2]))


@dataclass(frozen=True, eq=False)
class NumberedFrames:
    """Frames whose images are their own numbers, which :class:`SeesPoints` turns into features."""

    first: int
    count: int

    @property
    def times(self) -> FloatArray:
        return np.arange(self.count) / 10 + self.first

    @property
    def timed(self) -> bool:
        return True

    @property
    def numbers(self) -> IntArray:
        return np.arange(self.count)

    @property
    def size(self) -> tuple[int, int]:
        return 640, 480

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        for row in rows:
            yield np.array([[[self.first, row, 0]]], dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class SeesPoints:
    """An extractor to which a numbered frame is what a camera at that pose of its walk sees of the room."""

    room: Any
    walks: dict[int, list[Pose]]

    def extract(self, image: ByteArray) -> FeatureSet:
        first, row, _ = image[0, 0].tolist()
        return self.room.see(self.walks[first][row], seed=1000 * first + row)


def walk_of(room: Any, first: int, poses: Sequence[Pose]) -> Recording:
    """A recording of a walk, its poses unknown."""
    return Recording(NumberedFrames(first, len(poses)), f"walk-{first}", Path(f"walk-{first}"), room.camera)


def with_poses(recording: Recording, poses: Sequence[Pose], similarity: Similarity) -> Recording:
    """The recording with poses of its own, in another frame."""
    T = similarity.poses(np.array([pose.T_map_camera for pose in poses]))
    return replace(recording, poses=GivenPoses(np.ones(len(T), dtype=bool), T))


@dataclass(frozen=True, eq=False)
class Walks:
    """The first half of a walk as a map, and the part from its middle on as a further walk."""

    room: Any
    map_: Map
    poses: list[Pose]
    recording: Recording


@pytest.fixture(scope="module")
def walks(point_room: Any) -> Walks:
    whole = point_room.walk(80)
    further = point_room.walk(80, sideways_m=0.15)[25:65:2]
    return Walks(point_room, point_room.map_of(whole[:45:2], "first"), further, walk_of(point_room, 2, further))


@pytest.fixture(scope="module", autouse=True)
def _points_are_features(walks: Walks) -> Iterator[None]:
    extractor = SeesPoints(walks.room, {2: walks.poses})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learning, "get_extractor", lambda _name: extractor)
        yield


@pytest.fixture(scope="module")
def localized(walks: Walks, _points_are_features: None) -> Map:
    """The map that has learned the further walk, whose frames were localized; nobody may change it."""
    return update_map(walks.map_, walks.recording)


@pytest.fixture(scope="module")
def aligned(walks: Walks, _points_are_features: None) -> Map:
    """The map that has learned the further walk with a trajectory of its own; nobody may change it."""
    return update_map(walks.map_, with_poses(walks.recording, walks.poses, TURN))


@pytest.fixture(scope="module")
def second(walks: Walks) -> Map:
    """A map of every other view of the further walk."""
    return walks.room.map_of(walks.poses[::2], "second")


@pytest.fixture(scope="module")
def another_room(point_room: Any) -> Any:
    """The same walls with other points on them."""
    rng = np.random.default_rng(99)
    return replace(
        point_room,
        points=rng.permutation(point_room.points) * [1, 1, 0.9],
        descriptors=rng.integers(0, 256, point_room.descriptors.shape, dtype=np.uint8),
    )


def assert_untouched(map_: Map, before: Map) -> None:
    assert map_.info == before.info
    assert_same_tables(map_, before)


def off_the_points(map_: Map, room: Any) -> float:
    """The median distance of the map's landmarks from the room's points, metres."""
    return float(np.median(cKDTree(room.points).query(map_.landmarks.positions)[0]))


def localized_share(map_: Map, room: Any, poses: Sequence[Pose]) -> float:
    """The share of poses found to 5 cm."""
    localizer, good = Localizer(map_), 0
    for seed, pose in enumerate(poses):
        answer = localizer.localize(Query(room.see(pose, 77 + seed), room.camera, Dof.FREE))
        good += answer.pose is not None and float(np.linalg.norm(answer.pose.position - pose.position)) < 0.05
    return good / len(poses)


def test_a_recording_registers_itself_and_the_map_grows(walks: Walks, tmp_path: Path) -> None:
    before = deepcopy(walks.map_)
    updated = update_map(walks.map_, walks.recording)
    assert_untouched(walks.map_, before)
    assert (updated.info.id, updated.info.version) == (walks.map_.info.id, 2)
    assert [source.name for source in updated.info.sources] == ["first", "walk-2"]
    assert len(updated) > len(walks.map_)
    assert off_the_points(updated, walks.room) < 0.03
    assert updated.info.report.learned[0].features_seen_again > 100
    save_map(updated, tmp_path / "updated.rho")
    check_memory(load_map(tmp_path / "updated.rho"), "The map")
    nearby = walks.room.walk(80, sideways_m=0.1)[30:50:5]
    assert localized_share(updated, walks.room, nearby) >= localized_share(walks.map_, walks.room, nearby)


@pytest.mark.slow
def test_colours_and_patches_grow_with_the_map(walks: Walks, localized: Map) -> None:
    blue = np.tile(np.array([10, 20, 200], np.uint8), (len(walks.map_), 1))
    known = replace(walks.map_, landmarks=replace(walks.map_.landmarks, colours=blue, patches=None))
    updated = update_map(known, walks.recording)
    assert updated.landmarks.colours.shape == (len(updated), 3)
    np.testing.assert_array_equal(updated.landmarks.colours[: len(known)], blue)
    turned, octaves = walks.room.patch_errors(updated)
    learned = ~np.isnan(turned)
    assert learned[len(known) :].all()
    assert 0.2 < learned[: len(known)].mean() < 1  # of those that the recording saw again
    assert np.median(turned[learned]) < 10
    assert np.median(octaves[learned]) < 0.2
    left = forget_recording(updated, "walk-2")
    np.testing.assert_array_equal(left.landmarks.colours, blue)
    assert forget_recording(localized, "first-id").landmarks.colours is not None


def test_a_trajectory_of_its_own_reaches_beyond_the_map(walks: Walks, aligned: Map) -> None:
    views = aligned.views.positions[len(walks.map_.views) :]
    true = np.array([pose.position for pose in walks.poses])
    assert len(views) > 15
    assert cKDTree(true).query(views)[0].max() < 0.03
    assert off_the_points(aligned, walks.room) < 0.03
    beyond = walks.room.walk(80, sideways_m=0.1)[54:62:2]
    assert localized_share(walks.map_, walks.room, beyond) < localized_share(aligned, walks.room, beyond) == 1


_SPEED_PX_PER_S = 500.0  # of the image to the right, then to the left, from frame to frame
_READOUT_S = 0.03


@dataclass(frozen=True, eq=False)
class SeesRowByRow:
    """The same features where a rolling shutter sees them: up to 7 px aside."""

    instant: SeesPoints

    def extract(self, image: ByteArray) -> FeatureSet:
        seen = self.instant.extract(image)
        pixels = seen.pixels.astype(np.float64)
        late_s = ((pixels[:, 1] + 0.5) / self.instant.room.camera.height - 0.5) * _READOUT_S
        pixels[:, 0] += late_s * _SPEED_PX_PER_S * (-1) ** int(image[0, 0, 1])
        return replace(seen, pixels=pixels.astype(np.float32))


@pytest.mark.slow
@pytest.mark.parametrize("poses", ["aligned", "localized"])
def test_what_a_rolling_shutter_saw_is_learned_as_if_all_rows_were_read_at_once(
    walks: Walks, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest, poses: str
) -> None:
    recording = with_poses(walks.recording, walks.poses, TURN) if poses == "aligned" else walks.recording
    instant = request.getfixturevalue(poses)
    velocities = np.zeros((len(walks.poses), 2, 3))
    velocities[:, 0, 2] = _SPEED_PX_PER_S * (-1.0) ** np.arange(len(walks.poses))
    shutter = RollingShutter(_READOUT_S, walks.room.camera.height, velocities)
    monkeypatch.setattr(
        learning,
        "estimate_trajectory",
        lambda *given: replace(found := estimate_trajectory(*given), rolling_shutter=shutter.take(found.rows)),
    )
    monkeypatch.setattr(learning, "rolling_shutter_of", lambda _recording, rows, _progress: shutter.take(rows))
    extractor = SeesRowByRow(SeesPoints(walks.room, {2: walks.poses}))
    monkeypatch.setattr(learning, "get_extractor", lambda _name: extractor)
    rolling = update_map(walks.map_, recording)
    assert len(rolling) == len(instant)
    np.testing.assert_allclose(rolling.landmarks.positions, instant.landmarks.positions, atol=1e-3)


def test_forgetting_undoes_an_update(walks: Walks, localized: Map) -> None:
    left = forget_recording(localized, "walk-2")
    assert left.info.version == 3
    assert left.info.sources == walks.map_.info.sources
    np.testing.assert_allclose(left.landmarks.positions, walks.map_.landmarks.positions, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(left.descriptors.values, walks.map_.descriptors.values)
    other = forget_recording(localized, "first-id")
    assert 0 < len(other) < len(localized)
    assert off_the_points(other, walks.room) < 0.03


@pytest.mark.slow
def test_a_tensor_map_goes_on_learning_and_forgets(walks: Walks) -> None:
    tensor = fit_densities(walks.map_, DensityKind.TENSOR, 1)
    updated = update_map(tensor, walks.recording)
    assert updated.info.density is DensityKind.TENSOR
    assert len(np.unique(updated.densities.features)) == len(updated) > len(tensor)
    assert forget_recording(updated, "walk-2").info.density is DensityKind.TENSOR


def test_a_recording_of_another_room_is_refused(walks: Walks, another_room: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(learning, "get_extractor", lambda _name: SeesPoints(another_room, {2: walks.poses}))
    before = deepcopy(walks.map_)
    with pytest.raises(MappingFailed, match=r": 0 of \d+ frames were found"):
        update_map(walks.map_, walks.recording)
    assert_untouched(walks.map_, before)


def test_pictures_without_times_do_not_jump(walks: Walks, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows were taken for seconds: of pictures more than two rows apart none was left."""
    frames = walks.recording.frames
    monkeypatch.setattr(type(frames), "timed", False, raising=False)
    monkeypatch.setattr(type(frames), "times", property(lambda self: 3.0 * np.arange(len(walks.poses))))
    assert update_map(walks.map_, walks.recording).info.version == walks.map_.info.version + 1


def test_a_recording_that_is_too_short_is_not_taken_for_one_of_another_place(walks: Walks) -> None:
    with pytest.raises(MappingFailed, match=r"Only 3 frames of .* show the place of the map; at least 5 are needed"):
        update_map(walks.map_, walk_of(walks.room, 2, walks.poses[:3]))


def test_a_camera_at_rest_adds_nothing_new_and_fails_nothing(walks: Walks, monkeypatch: pytest.MonkeyPatch) -> None:
    resting = [walks.poses[0]] * 12
    monkeypatch.setattr(learning, "get_extractor", lambda _name: SeesPoints(walks.room, {3: resting}))
    trajectory = with_poses(walk_of(walks.room, 3, resting), resting, Similarity.identity())
    with pytest.raises(MappingFailed, match="different views"):
        update_map(walks.map_, trajectory)
    monkeypatch.setattr(learning, "choose_views", lambda T, **_: (np.arange(len(T)), np.zeros(0, np.int64)))
    updated = update_map(walks.map_, walk_of(walks.room, 3, resting))
    assert len(updated) == len(walks.map_)


def test_a_trajectory_of_wrong_scale_is_refused_saying_by_how_much(walks: Walks) -> None:
    stretched = with_poses(walks.recording, walks.poses, Similarity(1.5, np.eye(3), np.zeros(3)))
    with pytest.raises(MappingFailed, match=r"disagree: \d+ cm .* units of length differ by 3\d%"):
        update_map(walks.map_, stretched)


def test_a_recording_is_learned_once(walks: Walks, localized: Map) -> None:
    with pytest.raises(Conflict, match="already"):
        update_map(localized, walks.recording)


def test_a_map_without_memory_is_refused_and_a_broken_memory_too(walks: Walks) -> None:
    with pytest.raises(InvalidInput, match="does not keep"):
        update_map(without_memory(walks.map_), walks.recording)
    views = walks.map_.views
    broken = replace(views, sources=views.sources + 1)
    with pytest.raises(InvalidMap, match="contradicts"):
        forget_recording(replace(walks.map_, views=broken), "first")


def test_what_was_never_learned_cannot_be_forgotten(walks: Walks) -> None:
    with pytest.raises(InvalidInput, match=r"does not contain attic\. It contains: first \(first-id\)"):
        forget_recording(walks.map_, "attic")
    with pytest.raises(Conflict, match="the only recording in the map"):
        forget_recording(walks.map_, "first")


@pytest.mark.slow
def test_a_name_that_several_recordings_have_is_not_enough(walks: Walks) -> None:
    updated = update_map(walks.map_, replace(walks.recording, name="first"))
    with pytest.raises(InvalidInput, match="2 recordings named first"):
        forget_recording(updated, "first")
    assert len(forget_recording(updated, "first-id").info.sources) == 1


def test_maps_that_overlap_are_merged_in_the_frame_of_the_first(walks: Walks, second: Map) -> None:
    other = move_map(second, TURN)
    merged = merge_maps(walks.map_, other)
    assert [source.name for source in merged.info.sources] == ["first", "second"]
    assert merged.info.id not in (walks.map_.info.id, other.info.id)
    assert off_the_points(merged, walks.room) < 0.03
    assert len(walks.map_) < len(merged) < len(walks.map_) + len(other) - 100  # what both know is one
    turned, octaves = walks.room.patch_errors(merged)
    assert np.percentile(turned, 95) < 30  # none of them NaN: all are known
    assert np.percentile(octaves, 95) < 0.3
    np.testing.assert_array_equal(merged.landmarks.patches[: len(walks.map_)], walks.map_.landmarks.patches)
    left = forget_recording(merged, "second")
    np.testing.assert_allclose(left.landmarks.positions, walks.map_.landmarks.positions, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_what_both_maps_have_learned_counts_once(walks: Walks, second: Map) -> None:
    other = move_map(second, TURN)
    third = walks.room.map_of(walks.room.walk(80, sideways_m=-0.1)[20:50:2], "third")
    again = merge_maps(merge_maps(walks.map_, other), move_map(merge_maps(other, third), TURN))
    assert [source.name for source in again.info.sources] == ["first", "second", "third"]


def test_merging_refuses_what_does_not_fit(walks: Walks, another_room: Any, second: Map) -> None:
    elsewhere = another_room.map_of(walks.poses[::2], "elsewhere")
    with pytest.raises(MappingFailed, match=r": 0 of \d+ frames"):
        merge_maps(walks.map_, elsewhere)
    with pytest.raises(MappingFailed, match=r"disagree: \d+ cm"):
        merge_maps(walks.map_, move_map(second, Similarity(1.5, np.eye(3), np.zeros(3))))
    with pytest.raises(Conflict, match="all that the second does"):
        merge_maps(walks.map_, walks.map_)
    with pytest.raises(InvalidInput, match="different features, gray and lab"):
        merge_maps(walks.map_, replace(second, info=replace(second.info, features="lab")))
    with pytest.raises(InvalidInput, match="tensor"):
        merge_maps(walks.map_, replace(second, info=replace(second.info, density=DensityKind.TENSOR)))


def test_a_map_of_arbitrary_scale_takes_that_of_the_first(walks: Walks, second: Map) -> None:
    loose = replace(second, info=replace(second.info, metric=False))
    merged = merge_maps(walks.map_, move_map(loose, Similarity(0.4, TURN.rotation, TURN.translation)))
    assert off_the_points(merged, walks.room) < 0.03
    assert np.percentile(walks.room.patch_errors(merged)[1], 95) < 0.3


@pytest.mark.slow
def test_a_recording_whose_views_were_all_removed_counts_as_nothing(walks: Walks, second: Map) -> None:
    """It stays in the list of what the map learned; nothing is left to merge of it, nor to keep."""
    both = merge_maps(walks.map_, second)
    first = len(walks.map_.views)
    emptied = remove_views(both, first, len(both.views) - 1)
    assert [source.views for source in emptied.info.sources] == [first, 0]
    with pytest.raises(Conflict, match="all that the second does"):
        merge_maps(walks.map_, emptied)
    with pytest.raises(Conflict, match="the only recording"):
        forget_recording(emptied, "first")
    assert [source.name for source in forget_recording(emptied, "second").info.sources] == ["first"]
