"""``rholoc track`` follows a camera through a map on this machine; ``rholoc watch`` shows who is localized in one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rholoc.cli import options
from rholoc.cli.console import frame_progress, print_figures, print_json, print_notice
from rholoc.cli.localize import camera_of, recording_camera
from rholoc.cli.options import is_bag_target
from rholoc.errors import InvalidInput
from rholoc.processes.interrupts import interruptible

if TYPE_CHECKING:
    from rholoc.geometry import Camera
    from rholoc.maps import MapInfo
    from rholoc.recordings.frames.live_camera import LiveCamera
    from rholoc.tracking.follow import Answering, Step
    from rholoc.tracking.moments import Moment, Motion
    from rholoc.tracking.users import StepUser
import os
from tempfile import TemporaryDirectory

from rholoc.errors import RholocError

KEY_VARIABLE = "RHOLOC_API_KEY"


@dataclass(frozen=True, eq=False)
class _Followed:
    """What is followed: moments, their camera and motion, how answers come, and the number of frames if known."""

    moments: Iterator[Moment]
    camera: Camera
    motion: Motion
    answering: Answering
    count: int | None


def track(
    map_file: options.MapFile,
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="A recording's folder, a video, a ROS bag; or a live camera: its number, /dev/video0, rtsp://…",
        ),
    ],
    out: Annotated[
        list[Path] | None,
        typer.Option("--out", "-o", metavar="MCAP|CSV", help="Where the poses go, a ROS 2 bag or Table 6; repeatable."),
    ] = None,
    motion: options.MotionOption = None,
    frames: options.Frames = None,
    topic: options.Topics = None,
    camera: options.Camera = None,
    mount: options.Mount = options.MOUNT,
    mavlink: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="Send ODOMETRY to a flight controller, by UDP.")
    ] = None,
    mqtt: Annotated[
        str | None, typer.Option(metavar="mqtt://HOST/TOPIC", help="Publish poses with VDA 5050's fields.")
    ] = None,
    view: Annotated[
        str | None, typer.Option(metavar="HOST[:PORT]", help="Show it in Foxglove, which connects to ws://HOST:PORT.")
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Follow a camera through a map: a pose for every frame, none while the place is not recognized."""
    from rholoc.localization import localizer_of
    from rholoc.maps import load_map, write_trajectory_csv
    from rholoc.recordings.frames.live_camera import is_live, opened_camera
    from rholoc.tracking.follow import InBackground, follow
    from rholoc.tracking.live_view import LiveView
    from rholoc.tracking.mavlink import MavlinkSender
    from rholoc.tracking.moments import paced
    from rholoc.tracking.mqtt import MqttSender
    from rholoc.tracking.pose_bag import PoseBag
    from rholoc.tracking.users import MessagesOfTrack, TableOfTrack, Tally

    T_base_camera = options.mounting(mount)
    bags = [path for path in out or [] if is_bag_target(path)]
    tables = [path for path in out or [] if path not in bags]
    localizer = localizer_of(load_map(map_file))
    tally, table = Tally(), TableOfTrack()
    users: list[StepUser] = [tally, *([table] if tables else [])]
    with ExitStack() as stack:
        if is_live(source):
            if motion is not None or frames is not None or topic:
                raise InvalidInput("--motion, --frames and --topic are for recordings.", "Leave them out.")
            followed = _live(stack.enter_context(opened_camera(source)), camera, localizer.map.info)
        else:
            followed = _recorded(Path(source), motion, frames, topic, camera, localizer.map.info)
            if mavlink is not None or mqtt is not None or view is not None:
                followed = replace(followed, moments=paced(followed.moments), answering=InBackground())
        map_ = localizer.map
        users += [MessagesOfTrack(stack.enter_context(PoseBag(path, T_base_camera)), map_) for path in bags]
        if view is not None:
            live = stack.enter_context(LiveView(view, T_base_camera))
            users.append(MessagesOfTrack(live, map_, followed.camera))
            print_notice(f"Foxglove: open a connection to ws://{view.rpartition(':')[0] or view}:{live.port}.")
        if mavlink is not None:
            users.append(stack.enter_context(MavlinkSender(mavlink, T_base_camera, localizer.map.info.earth)))
        if mqtt is not None:
            users.append(stack.enter_context(MqttSender(mqtt, map_file.stem, T_base_camera)))
        advance = stack.enter_context(frame_progress("tracking", followed.count))
        steps = follow(localizer, followed.camera, followed.motion, followed.moments, followed.answering)
        try:
            _hand_out(steps, users, advance)
        except BaseException:
            tables = tables if table.rows else []  # what failed before the first pose replaces nothing
            raise
        finally:
            for path in tables:
                write_trajectory_csv(path, table.table())
    figures = {"motion": str(followed.motion), **tally.figures(), "out": [str(path) for path in out or []]}
    if as_json:
        print_json(figures)
    else:
        shown = {name: "–" if value is None else str(value) for name, value in figures.items()}
        print_figures(f"{source} in {map_file.name}", shown)
    if not localizer.map.info.metric:
        print_notice("This map's unit of length is arbitrary: nothing measured fixed its scale.")


def _recorded(
    path: Path, motion: str | None, frames: str | None, topics: list[str] | None, camera: str | None, info: MapInfo
) -> _Followed:
    """A recording to follow, every frame answered. Raises InvalidInput for odometry that it does not have."""
    from rholoc.recordings import read_recording
    from rholoc.tracking.follow import AtOnce
    from rholoc.tracking.moments import Motion, odometry_of, recorded_moments

    recording = read_recording(path, camera=options.named_camera(camera), frames=frames, topics=topics or ())
    odometry = odometry_of(recording)
    nominal = Motion.PICTURES if odometry is None else Motion.ODOMETRY
    chosen = nominal if motion is None else options.choice(Motion, motion, "--motion")
    if chosen is Motion.ODOMETRY and odometry is None:
        raise InvalidInput("The recording has no odometry.", "Leave --motion out: the pictures are followed.")
    if not recording.frames.timed:
        print_notice("These pictures have no times: they are taken for a film at 30 a second.")
    moments = recorded_moments(recording, chosen, odometry)
    count = len(recording.frames.times)
    return _Followed(moments, recording_camera(recording, info), chosen, AtOnce(), count)


def _live(live: LiveCamera, camera: str | None, info: MapInfo) -> _Followed:
    """A live camera to follow by its pictures, answered in the background."""
    from rholoc.geometry import Camera
    from rholoc.tracking.follow import InBackground
    from rholoc.tracking.moments import Motion, live_moments

    named = options.named_camera(camera)
    given = Camera.parse(named, *live.size) if isinstance(named, str) else named
    used = camera_of(given and given.fitted(*live.size), live.size, info)
    return _Followed(live_moments(live), used, Motion.PICTURES, InBackground(), None)


def _hand_out(steps: Iterable[Step], users: list[StepUser], advance: Callable[[], None]) -> None:
    """Give every step to every user, and call ``advance``, until the steps end, or a signal ends them with a notice."""
    try:
        with interruptible():
            for step in steps:
                for user in users:
                    user.take(step)
                advance()
    except KeyboardInterrupt:
        print_notice("Stopped; what was tracked until now is written.")


def watch(
    map_name: Annotated[str, typer.Argument(metavar="MAP", help="Name of a map of the service.")],
    url: Annotated[str, typer.Option(help="The service.")] = "http://127.0.0.1:8080",
    view: Annotated[
        str, typer.Option(metavar="HOST[:PORT]", help="Where Foxglove connects to: ws://HOST:PORT.")
    ] = "127.0.0.1",
) -> None:
    """Show in Foxglove who is localized in a map of a service, until Ctrl-C. The key is in RHOLOC_API_KEY."""
    import numpy as np

    from rholoc.maps import load_map
    from rholoc.tracking.live_view import LiveView
    from rholoc_client import Client
    from rholoc_client.errors import RholocClientError

    try:
        with Client(url, os.environ.get(KEY_VARIABLE)) as client, LiveView(view, np.eye(4)) as shown:
            with TemporaryDirectory() as folder:
                path = Path(folder) / f"{map_name}.rho"
                path.write_bytes(client.download_map(map_name))
                landmarks = load_map(path).landmarks
            shown.room(0.0, landmarks.positions, landmarks.known_colours)
            print_notice(f"Foxglove: open a connection to ws://{view.rpartition(':')[0] or view}:{shown.port}.")
            with interruptible():
                for sightings in client.live(map_name):
                    for one in sightings:
                        if one["T_map_camera"] is not None:
                            shown.camera(one["time"], one["asker"], np.array(one["T_map_camera"]))
    except RholocClientError as error:
        raise RholocError(str(error)) from error
    except KeyboardInterrupt:
        print_notice("Stopped.")
