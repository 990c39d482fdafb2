"""Seconds without a place, and what they show; given poses held against pictures."""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.features import FeatureSet
from rholoc.geometry import BoolArray, ByteArray, FloatArray, pose_matrix
from rholoc.recordings import GivenPoses, Recording, read_recording
from rholoc.reports import MissingSpan
from rholoc.trajectory import PoseMethod
from rholoc.trajectory.checks.gaps import describe, missing_spans
from rholoc.trajectory.checks.given_poses import PoseAxes, check_given_poses, epipolar_errors
from rholoc.trajectory.estimate import estimate_trajectory
from rholoc.trajectory.visual import keyframe_features
from rholoc.trajectory.visual.flow import Flow

_SECONDS, _HZ, _START_S = 20, 10, 100.0


def _flow(
    gap: BoolArray, corners: int = 200, sharpness: float = 100.0, brightness: float = 120.0, contrast: float = 50.0
) -> Flow:
    """Twenty seconds of a room, and within ``gap`` so many corners of that sharpness, brightness and contrast."""
    count = _SECONDS * _HZ
    counts = np.where(gap, corners, 200)
    return Flow(
        _START_S + np.arange(count) / _HZ,
        (640, 480),
        np.concatenate([[0], np.cumsum(counts)]),
        np.concatenate([np.arange(n) for n in counts]),
        np.zeros((int(counts.sum()), 2)),
        np.full(count, 0.01),
        np.where(gap, sharpness, 100.0),
        np.where(gap, brightness, 120.0),
        np.where(gap, contrast, 50.0),
    )


_ROWS = np.arange(0, _SECONDS * _HZ, 2)
_GAP = (np.arange(_SECONDS * _HZ) >= 120) & (np.arange(_SECONDS * _HZ) < 150)


@pytest.mark.parametrize(
    ("gap", "why"),
    [
        ({"corners": 5}, "shows a blank wall"),
        ({"corners": 5, "sharpness": 3.0, "contrast": 4.0}, "shows a blank wall"),
        ({"corners": 300, "sharpness": 20.0, "contrast": 1.0}, "shows a blank wall"),  # the corners are noise
        ({"corners": 80, "sharpness": 10.0}, "is blurred"),
        ({"corners": 3, "sharpness": 1.0, "brightness": 8.0}, "is too dark"),
        ({}, "shows nothing that links it to the rest of the walk"),
    ],
)
def test_missing_seconds_say_what_they_show(gap: dict[str, float], why: str) -> None:
    (span,) = missing_spans(_flow(_GAP, **gap), _ROWS, ~_GAP[_ROWS])
    assert span.start_s == pytest.approx(12.0, abs=0.3)  # from the start of the recording, not of its clock
    assert span.end_s == pytest.approx(15.0, abs=0.3)
    assert span.why == why
    assert describe((span,)) == f"0:12–0:15 {why}."


def test_the_start_and_the_end_can_be_missing() -> None:
    ends = (np.arange(200) < 30) | (np.arange(200) >= 170)
    first, last = missing_spans(_flow(ends), _ROWS, ~ends[_ROWS])
    assert (first.start_s, last.end_s) == pytest.approx((0.0, 19.9))


def test_of_many_spans_some_are_named() -> None:
    spans = tuple(MissingSpan(None, None, "is blurred", number, number) for number in range(0, 18, 2))
    assert (
        describe(spans)
        == " ".join(f"Picture {n} is blurred." for n in (0, 2, 4, 6)) + " 5 more parts could not be placed."
    )


def test_one_span_more_is_one_part() -> None:
    spans = tuple(MissingSpan(None, None, "is blurred", number, number) for number in range(0, 10, 2))
    assert describe(spans).endswith("Picture 6 is blurred. 1 more part could not be placed.")


def test_pictures_without_times_are_no_walk() -> None:
    (span,) = missing_spans(replace(_flow(_GAP), timed=False), _ROWS, ~_GAP[_ROWS])
    assert span.why == "shows nothing that links it to the other pictures"


def test_what_is_said_of_each_picture_is_true_of_each() -> None:
    """Of pictures in no order half were black: each of 29 was said to show a blank wall."""
    black = _GAP & (np.arange(len(_GAP)) % 5 > 0)
    flow = replace(_flow(black, corners=0, contrast=0.0), timed=False)
    (span,) = missing_spans(flow, _ROWS, ~_GAP[_ROWS])
    assert describe((span,)) == "Each of the pictures 119 to 149 shows nothing that links it to the other pictures."


def test_a_picture_that_two_reconstructions_dispute_is_not_said_to_show_nothing() -> None:
    placed, disputed = ~_GAP[_ROWS], np.zeros(len(_ROWS), np.bool_)
    missing = np.flatnonzero(~placed)
    disputed[missing[:2]] = True
    spans = missing_spans(replace(_flow(_GAP, brightness=5.0), timed=False), _ROWS, placed, disputed)
    assert [(span.first_number, span.last_number, span.why) for span in spans] == [
        (119, 123, "is not confirmed by a second reconstruction"),
        (124, 149, "is too dark"),
    ]


def test_a_moment_is_not_missing() -> None:
    flow = _flow(np.zeros(200, np.bool_))
    placed = np.ones(len(_ROWS), np.bool_)
    assert missing_spans(flow, _ROWS, placed) == ()
    placed[50] = False
    assert missing_spans(replace(flow, times=_START_S + np.arange(200) / 30), _ROWS, placed) == ()
    assert describe(()) == ""


def test_of_a_walk_without_any_place_nothing_is_listed() -> None:
    assert missing_spans(_flow(_GAP), _ROWS, np.zeros(len(_ROWS), np.bool_)) == ()


@pytest.mark.parametrize(
    ("gap", "why"),
    [
        ({"brightness": 24.0}, "is too dark"),
        ({"brightness": 26.0}, "shows nothing that links it to the rest of the walk"),
        ({"contrast": 9.0}, "shows a blank wall"),
        ({"contrast": 11.0}, "shows nothing that links it to the rest of the walk"),
        ({"sharpness": 24.0}, "is blurred"),
        ({"sharpness": 26.0}, "shows nothing that links it to the rest of the walk"),
        ({"corners": 59}, "shows a blank wall"),
        ({"corners": 61}, "shows nothing that links it to the rest of the walk"),
    ],
)
def test_where_a_reason_begins(gap: dict[str, float], why: str) -> None:
    (span,) = missing_spans(_flow(_GAP, **gap), _ROWS, ~_GAP[_ROWS])
    assert span.why == why


def test_a_span_goes_from_the_first_frame_without_a_place_to_the_next_with_one() -> None:
    """Keyframes are every second frame at 10 Hz: the seventh and eighth are missing."""
    placed = np.ones(len(_ROWS), np.bool_)
    placed[[7, 8]] = False
    (span,) = missing_spans(_flow(_GAP), _ROWS, placed)
    assert (span.start_s, span.end_s) == pytest.approx((1.3, 1.8))
    placed[8] = True
    assert missing_spans(_flow(_GAP), _ROWS, placed) == ()  # for three tenths of a second
    placed[:] = True
    placed[-3:] = False
    (span,) = missing_spans(_flow(_GAP), _ROWS, placed)
    assert (span.start_s, span.end_s) == pytest.approx((19.3, 19.9))


def test_the_reason_is_that_of_the_frames_that_are_missing() -> None:
    dark = (np.arange(200) >= 13) & (np.arange(200) < 18)
    placed = np.ones(len(_ROWS), np.bool_)
    placed[[7, 8]] = False
    (span,) = missing_spans(_flow(dark, brightness=5.0), _ROWS, placed)
    assert span.why == "is too dark"


def test_times_are_minutes_and_seconds() -> None:
    spans = (MissingSpan(59.4, 61.6, "is blurred"), MissingSpan(600.0, 725.0, "is too dark"))
    assert describe(spans) == "0:59–1:02 is blurred. 10:00–12:05 is too dark."


_FLIP = np.diag([1.0, -1, -1, 1])


def test_epipolar_errors_grow_with_the_shift_across_the_epipolar_line() -> None:
    """Sampson's distance of a match shifted across its line in one of two like images is the shift over √2."""
    rng = np.random.default_rng(0)
    points = rng.uniform([-1, -1, 3], [1, 1, 6], (200, 3))
    T = pose_matrix(Rotation.from_euler("y", 5, degrees=True).as_matrix(), np.array([0.5, 0.0, 0.0]))
    moved = points @ T[:3, :3].T + T[:3, 3]
    a, b = points / points[:, 2:], moved / moved[:, 2:]
    assert epipolar_errors(T, a, b).max() < 1e-12
    off = epipolar_errors(T, a, b + np.array([0.0, 1e-3, 0.0]))
    np.testing.assert_allclose(off, 1e-3 / np.sqrt(2), rtol=0.15)


def test_cameras_at_one_place_are_compared_by_their_rotation() -> None:
    T = pose_matrix(Rotation.from_euler("y", 5, degrees=True).as_matrix(), np.zeros(3))
    a = np.array([[0.1, 0.2, 1.0], [-0.3, 0.1, 1.0]])
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    assert epipolar_errors(T, a, a @ T[:3, :3].T).max() < 1e-12


@pytest.fixture(scope="module")
def kitchen(real_data: Path) -> Iterator[Recording]:
    """A recording whose pictures' features are extracted once: tests differ in the poses that are held against them."""
    extract, known = keyframe_features._extract, {}

    def extracted_once(image: ByteArray, *how: Any) -> FeatureSet:
        content = hashlib.blake2b(image.tobytes()).digest()
        if content not in known:
            known[content] = extract(image, *how)
        return known[content]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(keyframe_features, "_extract", extracted_once)
        yield read_recording(real_data / "redkitchen", "525.505,525.505,320,240", "400:520:8")


def _written(recording: Recording, write: Callable[[FloatArray], FloatArray]) -> Recording:
    T = write(recording.poses.T_map_camera)
    return replace(recording, poses=GivenPoses(np.ones(len(T), dtype=np.bool_), T))


def _turned_at_random(T: FloatArray) -> FloatArray:
    return pose_matrix(Rotation.random(len(T), rng=np.random.default_rng(0)).as_matrix(), T[:, :3, 3])


@pytest.mark.real
@pytest.mark.parametrize(
    ("axes", "write"),
    [
        (PoseAxes.AS_DOCUMENTED, lambda T: T),
        (PoseAxes.LOOKING_BACK, lambda T: T @ _FLIP),
        (PoseAxes.INVERTED, np.linalg.inv),
        (PoseAxes.INVERTED_LOOKING_BACK, lambda T: np.linalg.inv(T @ _FLIP)),
    ],
)
def test_axes_are_recognised_by_the_pictures(
    kitchen: Recording, axes: PoseAxes, write: Callable[[FloatArray], FloatArray]
) -> None:
    recording = _written(kitchen, write)
    assert recording.camera is not None
    check = check_given_poses(recording, recording.camera)
    assert check.axes is axes
    assert check.exact
    np.testing.assert_allclose(check.read(recording.poses.T_map_camera), kitchen.poses.T_map_camera, atol=1e-9)


@pytest.mark.real
def test_auto_takes_exact_poses_and_corrects_their_axes(kitchen: Recording) -> None:
    found = estimate_trajectory(_written(kitchen, lambda T: T @ _FLIP), PoseMethod.AUTO)
    np.testing.assert_allclose(found.T_map_camera, kitchen.poses.T_map_camera, atol=1e-9)
    assert "OpenGL" in found.report.why


@pytest.mark.real
@pytest.mark.slow
def test_auto_says_why_it_did_not_use_poses_that_contradict_the_pictures(kitchen: Recording) -> None:
    recording = _written(kitchen, _turned_at_random)
    assert recording.camera is not None
    assert not check_given_poses(recording, recording.camera).usable
    found = estimate_trajectory(recording, PoseMethod.AUTO)
    assert "contradict its pictures" in found.report.why
    assert found.report.method != "given"


@pytest.mark.real
@pytest.mark.slow
def test_auto_adjusts_poses_that_drift(real_data: Path) -> None:
    """ARKit's poses along a corridor with doors that look alike: all pictures are placed, and fit each other."""
    recording = read_recording(real_data / "corridor_lidar" / "scan", frames="::4")
    found = estimate_trajectory(recording, PoseMethod.AUTO)
    assert len(found.rows) >= 0.95 * len(recording.frames.times)
    assert "adjusted to its pictures" in found.report.why
    assert found.report.reprojection_error_px is not None
    assert found.report.reprojection_error_px < 1.5
    moved_m = np.linalg.norm(found.T_map_camera[:, :3, 3] - recording.poses.T_map_camera[found.rows, :3, 3], axis=1)
    assert np.median(moved_m) < 0.6
