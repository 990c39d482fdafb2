"""The keyframes of a recording: rows of the frames that are used."""

from collections.abc import Sequence

import numpy as np

from rholoc.errors import MappingFailed
from rholoc.geometry import FloatArray, IntArray, evenly
from rholoc.geometry.graphs import components
from rholoc.recordings import Imu, KnownLength, Mounted, Recording, Waypoint
from rholoc.trajectory.frame.waypoint_times import choices_of_pauses, find_pauses, times_are_known
from rholoc.trajectory.visual.flow import Flow
from rholoc.trajectory.visual.keyframe_features import KeyframeFeatures
from rholoc.trajectory.visual.keyframes import MAX_PICTURES, choose_keyframes, is_film
from rholoc.trajectory.visual.loop_candidates import least_alike

FEWEST_KEYFRAMES = 4
MOVE = "Walk through the room while recording; keep texture in view."
_MAX_COMPARED = 1200  # pictures of a set, of which those least alike are used


def keyframes_and_waypoints(
    recording: Recording, imu: Imu | None, flow: Flow, features: KeyframeFeatures | None = None
) -> tuple[IntArray, list[tuple[Waypoint, ...]]]:
    """Keyframe rows (K,) by motion and sharpness, with the frames nearest to the waypoints and those of known lengths;
    choices of waypoint times. If these are not known, one frame for each pause, and every way to take pauses for the
    waypoints. Raises MappingFailed for too few keyframes, InvalidWaypoints for too few pauses.
    """
    choices = [recording.waypoints]
    if not times_are_known(recording.waypoints):
        choices = list(choices_of_pauses(recording.waypoints, find_pauses(flow.times, flow.motion, imu)))
    stops = set().union(
        *(rows_at(flow.times, waypoints) for waypoints in choices), *rows_of(recording, recording.lengths)
    )
    rows = np.union1d(chosen_rows(recording, flow, features), np.array(sorted(stops), dtype=np.int64))
    require_keyframes(rows, len(flow.times))
    return rows, choices


def require_keyframes(rows: IntArray, frames: int) -> None:
    """Raise MappingFailed unless there are at least four keyframes (K,), of at least four ``frames``."""
    if frames < FEWEST_KEYFRAMES:
        raise MappingFailed(
            f"{frames} pictures are too few for a map.", "Take a dozen or more, from places half a step apart."
        )
    if len(rows) < FEWEST_KEYFRAMES:
        raise MappingFailed("The camera hardly moves in this recording.", MOVE)


def chosen_rows(recording: Recording, flow: Flow, features: KeyframeFeatures | None) -> IntArray:
    """Rows of the keyframes.

    A film: the sharpest frames at steps of image motion. A set of pictures: all up to ``MAX_PICTURES``, else the least
    alike of them (of 1200 evenly spaced ones if there are more), or evenly spaced ones without ``features``. A rig's
    pictures: all pictures of a moment or none.
    """
    if recording.mounted:
        return _chosen_moments(len(flow.times), rows_of(recording, recording.mounted))
    if is_film(flow):
        return choose_keyframes(flow.times, flow.motion, flow.sharpness, flow.timed)
    count = len(flow.times)
    if features is None or count <= MAX_PICTURES:
        return evenly(count, MAX_PICTURES)
    rows = evenly(count, _MAX_COMPARED)
    return rows[least_alike(features.of(rows), flow.sharpness[rows], MAX_PICTURES)]


def _chosen_moments(count: int, pairs: Sequence[tuple[int, int]]) -> IntArray:
    """Rows of the pictures to use: all of ``count`` up to ``MAX_PICTURES``, else all pictures of evenly spread moments.

    Args:
        count: number of pictures.
        pairs: rows of two pictures of the same moment; pictures linked by pairs form a moment.
    """
    if count <= MAX_PICTURES:
        return np.arange(count)
    moment = components(count, np.array(pairs))
    pictures = np.bincount(moment)
    return np.flatnonzero(np.isin(moment, evenly(len(pictures), MAX_PICTURES // int(pictures.max()))))


def rows_at(times: FloatArray, waypoints: Sequence[Waypoint]) -> set[int]:
    """Rows of the frames (times (N,)) nearest to the waypoints with a known time."""
    return {int(np.abs(times - at.time).argmin()) for at in waypoints if not np.isnan(at.time)}


def rows_of(recording: Recording, pairs: Sequence[KnownLength | Mounted]) -> list[tuple[int, int]]:
    """Rows of the two frames that each known length, or each mounting, refers to."""
    numbers = recording.frames.numbers
    return [(int(np.searchsorted(numbers, one.first)), int(np.searchsorted(numbers, one.second))) for one in pairs]
