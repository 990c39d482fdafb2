"""``rholoc localize``: the poses of a recording's frames in a map."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from rholoc.cli import options
from rholoc.cli.console import frame_progress, print_figures, print_json, print_notice
from rholoc.cli.options import is_bag_target
from rholoc.errors import InvalidCamera

if TYPE_CHECKING:
    import rholoc_client
    from rholoc.geometry import ByteArray, Camera, FloatArray
    from rholoc.localization import AnyLocalizer, Localization
    from rholoc.maps import MapInfo, TrajectoryTable
    from rholoc.recordings import FrameSource, Recording

_THREADS = 2
_BATCH = 16  # frames decoded ahead: enough to keep the threads busy, and few enough for little memory


def localize(
    map_file: options.MapFile,
    source: options.Source,
    out: Annotated[
        Path,
        typer.Option("--out", "-o", metavar="CSV|MCAP", help="Where the trajectory goes: Table 6, or a ROS 2 bag."),
    ] = Path("trajectory.csv"),
    frames: options.Frames = None,
    topic: options.Topics = None,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="FX,FY,CX,CY[,K1,K2,P1,P2[,K3]]|NAME|unknown",
            help="Intrinsics in pixels of the frames (with fisheye: before them, of such a lens), equirectangular, or "
            "a camera that `rholoc camera` keeps, instead of the recording's own; unknown: the focal length is "
            "estimated with each pose.",
        ),
    ] = None,
    dof: options.DofOption = "auto",
    min_recognized: Annotated[
        float | None,
        typer.Option(min=0.0, max=1.0, help="Poses that are less probably of the right place are withheld."),
    ] = None,
    max_sigma_m: Annotated[
        float | None, typer.Option(min=0.0, help="Poses whose position has a greater standard deviation are withheld.")
    ] = None,
    max_sigma_deg: Annotated[
        float | None, typer.Option(min=0.0, help="Poses whose rotation has a greater standard deviation are withheld.")
    ] = None,
    mount: options.Mount = options.MOUNT,
    as_json: options.Json = False,
) -> None:
    """Localize frames in a map and write the trajectory (Table 6). Frames without a pose get no row.

    Frames without intrinsics are taken to be of the map's camera if they have its size, else refused.
    """
    from rholoc.localization import MIN_RECOGNIZED, Intrinsics, localizer_of
    from rholoc.maps import load_map, write_trajectory_csv
    from rholoc.recordings import read_recording

    degrees_of_freedom = options.dof(dof)
    is_bag = is_bag_target(out)
    map_ = load_map(map_file)
    known = Intrinsics.UNKNOWN if camera == Intrinsics.UNKNOWN else Intrinsics.GIVEN
    given = None if known is Intrinsics.UNKNOWN else options.named_camera(camera)
    recording = read_recording(source, camera=given, frames=frames, topics=topic or ())
    used_camera = _guessed(recording) if known is Intrinsics.UNKNOWN else recording_camera(recording, map_.info)
    localizer = localizer_of(map_, MIN_RECOGNIZED if min_recognized is None else min_recognized)
    count = len(recording.frames.times)
    start_s = time.perf_counter()
    with frame_progress("localizing", count) as advance:
        answers, frame_s = [], []
        asked = {
            "dof": degrees_of_freedom,
            "intrinsics": known,
            "max_sigma_m": math.inf if max_sigma_m is None else max_sigma_m,
            "max_sigma_rad": math.inf if max_sigma_deg is None else math.radians(max_sigma_deg),
        }
        for answer, taken_s in _localize_frames(localizer, recording.frames, used_camera, asked):
            answers.append(answer)
            frame_s.append(taken_s)
            advance()
    duration_s = time.perf_counter() - start_s
    if is_bag:
        _write_bag(out, recording.frames.times, answers, options.mounting(mount))
    else:
        write_trajectory_csv(out, trajectory_table(recording.frames, range(count), answers))
    figures = {
        "frames": count,
        "localized": sum(answer.localized for answer in answers),
        "seconds": round(duration_s, 2),
        "ms_per_frame": round(1000 * float(np.median(frame_s)), 1),
        "trajectory": str(out),
        "metric": map_.info.metric,
    }
    causes = most_likely_causes(answers)
    if as_json:
        print_json(figures | ({"not_localized": causes} if causes else {}))
    else:
        shown = figures | (_only_answer(answers[0], map_.info.metric) if count == 1 else {})
        print_figures(f"{source} in {map_file.name}", {name: str(value) for name, value in shown.items()})
        for cause in causes:
            print_notice(f"{cause['frames']} not localized: {cause['message']} {cause['hint']}")
    if not map_.info.metric:
        print_notice("This map's unit of length is arbitrary: nothing measured fixed its scale.")


def _only_answer(answer: Localization, metric: bool) -> dict[str, str]:
    """Position, heading and probabilities of an answer, as texts by name; empty if it was not localized."""
    from rholoc.localization.index.map_error import rms_position_error

    if not answer.localized or answer.pose is None:
        return {}
    unit = " m" if metric else ""
    off = 0.0 if answer.covariance is None else rms_position_error(answer.covariance)
    return {
        "position": ", ".join(f"{value:.2f}" for value in answer.pose.position) + f"{unit} ± {off:.2f}{unit}",
        "heading": ", ".join(f"{value:.2f}" for value in answer.pose.heading),
        "recognized": f"{answer.recognized:.2f}",
        "confidence": f"{answer.confidence:.2f}",
    }


def _guessed(recording: Recording) -> Camera:
    """Nominal camera with the frames' longer side as its focal length, their centre, and no distortion."""
    from rholoc.geometry import Camera

    width, height = recording.frames.size
    return Camera(width, height, max(width, height), max(width, height), (width - 1) / 2, (height - 1) / 2)


def recording_camera(recording: Recording, info: MapInfo) -> Camera:
    """The recording's camera; without one as :func:`camera_of`, the map's or InvalidCamera."""
    return camera_of(recording.camera, recording.frames.size, info)


def camera_of(camera: Camera | None, size: tuple[int, int], info: MapInfo) -> Camera:
    """``camera``, or if None the map's, with a notice. Raises InvalidCamera if the map's is not of ``size`` [px]."""
    if camera is not None:
        return camera
    if size != (info.camera.width, info.camera.height):
        raise InvalidCamera(
            "The camera of these frames is not known.", "Give it with --camera fx,fy,cx,cy, or --camera unknown."
        )
    print_notice("No camera given: the frames are taken to be of the camera that recorded the map.")
    return info.camera


def _localize_frames(
    localizer: AnyLocalizer, frames: FrameSource, camera: Camera, asked: Mapping[str, Any]
) -> Iterator[tuple[Localization, float]]:
    """Iterate over the answers for all frames in order, and the seconds that each took, including its features.
    ``asked``: further attributes of each :class:`Query`.
    """
    from rholoc.localization import Query

    def answer(image: ByteArray) -> tuple[Localization, float]:
        start_s = time.perf_counter()
        answered = localizer.localize(Query.of_picture(image, localizer.extractor, camera, **asked))
        return answered, time.perf_counter() - start_s

    images = frames.images(range(len(frames.times)))
    with ThreadPoolExecutor(_THREADS) as pool:
        while batch := list(islice(images, _BATCH)):
            yield from pool.map(answer, batch)


def _write_bag(path: Path, times: FloatArray, answers: Sequence[Localization], T_base_camera: FloatArray) -> None:
    """Write the answers at times (N,) [s] to a bag of ROS 2: beliefs of all frames, poses of those localized."""
    from rholoc.tracking.pose_bag import PoseBag

    with PoseBag(path, T_base_camera) as bag:
        for time_s, answer in zip(times.tolist(), answers, strict=True):
            bag.belief(time_s, answer.recognized, answer.confidence)
            if answer.localized and answer.pose is not None:
                bag.pose(time_s, answer.pose.T_map_camera, answer.covariance)


def most_likely_causes(answers: Sequence[Localization]) -> list[dict[str, str | int]]:
    """Causes of failures, with their number of frames, and the first frame's message and hint; most frequent first."""
    found = [answer.diagnosis for answer in answers if answer.diagnosis is not None]
    counts = Counter(diagnosis.cause for diagnosis in found)
    example = {diagnosis.cause: diagnosis for diagnosis in reversed(found)}
    return [
        {"cause": cause.value, "frames": count, "message": example[cause].message, "hint": example[cause].hint}
        for cause, count in counts.most_common()
    ]


def trajectory_table(
    frames: FrameSource, rows: Sequence[int], answers: Sequence[Localization | rholoc_client.Localization]
) -> TrajectoryTable:
    """Table 6 of the answers with a pose; ``rows`` are the frames of the answers, one each."""
    from rholoc.maps import TrajectoryTable

    placed = [(row, answer, answer.pose) for row, answer in zip(rows, answers, strict=True) if answer.localized]
    kept = np.array([row for row, _, _ in placed], dtype=np.int64)
    poses = [pose.T_map_camera for _, _, pose in placed if pose is not None]
    return TrajectoryTable(
        times=frames.times[kept],
        frames=frames.numbers[kept],
        T_map_camera=np.reshape(np.asarray(poses, dtype=np.float64), (-1, 4, 4)),
        confidences=np.array([answer.confidence for _, answer, _ in placed]),
        inliers=np.array([answer.inliers for _, answer, _ in placed], dtype=np.int64),
        map_trusted=np.array([answer.map_trusted for _, answer, _ in placed], dtype=np.float64),
        expected_errors_m=np.array([answer.expected_error_m for _, answer, _ in placed], dtype=np.float64),
    )
