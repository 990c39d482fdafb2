"""``rholoc map build``, ``update``, ``learn``, ``merge`` and ``forget``: what changes the contents of a map."""

from __future__ import annotations

from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rholoc.cli import options
from rholoc.cli.console import print_figures, print_json, stage_progress
from rholoc.cli.maps.page import print_map
from rholoc.cli.options import check_target

if TYPE_CHECKING:
    from rholoc.maps import Map


def build(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING...", help="A video, a folder of images, or a recording's folder.")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="MAP.rho", help="Where to; default: the recording's name.")
    ] = None,
    density: Annotated[str, typer.Option(metavar="ray|tensor|observed", help="The form of the densities.")] = "ray",
    degree: Annotated[int, typer.Option(metavar="1|2|3", help="P of fitted densities; with 1 nothing localizes.")] = 2,
    features: Annotated[
        str | None, typer.Option(metavar="gray|rgb|lab|lab3|sift|sift48|xfeat", help="What the map's features are.")
    ] = None,
    poses: Annotated[
        str,
        typer.Option(
            metavar="auto|visual-inertial|visual|inertial|odometry|given", help="Where frame poses come from."
        ),
    ] = "auto",
    frames: options.Frames = None,
    camera: options.Camera = None,
    topic: options.Topics = None,
    waypoints: Annotated[
        Path | None, typer.Option(metavar="CSV", help="Measured waypoints: name[,time or frame],x,y,z.")
    ] = None,
    length: Annotated[
        list[str] | None,
        typer.Option(metavar="FRAME,FRAME,METRES", help="How far the camera moved between two frames."),
    ] = None,
    report: Annotated[
        bool, typer.Option(help="Hold frames out and localize them, for the map's own report; takes time.")
    ] = True,
    pictures: Annotated[
        bool, typer.Option("--pictures", help="Keep a small picture of each view in the map, for people to see.")
    ] = False,
    room: Annotated[bool, typer.Option(help="Draw the room's surfaces, for people to see; takes time.")] = True,
    as_json: options.Json = False,
) -> None:
    """Build a map from one or more recordings of a place; options that describe one recording need just one."""
    if len(recordings) > 1 and (waypoints or frames or camera or length or topic):
        raise typer.BadParameter(
            "--frames, --camera, --waypoints, --length and --topic speak of one recording; give just one."
        )
    target = check_target(out or Path(f"{recordings[0].resolve().stem}.rho"), "the map")
    from rholoc.features import DEFAULT_FEATURES
    from rholoc.mapping.build.pipeline import BuildOptions, build_map
    from rholoc.mapping.room.drawing import draw_room
    from rholoc.maps import DensityKind, save_map
    from rholoc.recordings import read_recording
    from rholoc.trajectory import PoseMethod

    build_options = BuildOptions(
        density=options.choice(DensityKind, density, "--density"),
        degree=degree,
        features=features or DEFAULT_FEATURES,
        poses=options.choice(PoseMethod, poses, "--poses"),
        report=report,
        pictures=pictures,
    )
    with stage_progress() as progress:
        read = [
            read_recording(
                path, options.named_camera(camera), frames, waypoints, lengths=length or (), topics=topic or ()
            )
            for path in recordings
        ]
        map_ = build_map(read, build_options, progress)
        save_map(map_, target)
        if room:
            map_ = draw_room(map_, read, progress)
            save_map(map_, target)
    print_map(map_, target, as_json)


def update(
    map_file: options.MapFile,
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A video, a folder of images, or a recording's folder.")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="MAP.rho", help="Where to; default: the map itself.")
    ] = None,
    poses: Annotated[
        str | None,
        typer.Option(
            metavar="visual-inertial|visual|inertial|odometry|given",
            help="Where frame poses come from, to be aligned to the map; default: its own poses, if it has any, else "
            "each frame is localized in the map.",
        ),
    ] = None,
    forgetting: Annotated[
        float | None,
        typer.Option(metavar="SHARE", help="Of observed densities: what all before weighs less at each observation."),
    ] = None,
    frames: options.Frames = None,
    camera: options.Camera = None,
    topic: options.Topics = None,
    pictures: Annotated[
        bool, typer.Option("--pictures", help="Keep a small picture of each new view in the map.")
    ] = False,
    as_json: options.Json = False,
) -> None:
    """Learn a further recording of the same place into a map."""
    from rholoc.mapping.learn.from_recordings import UpdateOptions, update_map
    from rholoc.maps import load_map
    from rholoc.recordings import read_recording
    from rholoc.trajectory import PoseMethod

    method = None if poses is None else options.choice(PoseMethod, poses, "--poses")
    update_options = UpdateOptions(method, forgetting, pictures)
    map_ = load_map(map_file)
    with stage_progress() as progress:
        updated = update_map(
            map_,
            read_recording(recording, options.named_camera(camera), frames, topics=topic or ()),
            update_options,
            progress,
        )
    save_and_print(updated, out or map_file, as_json)


def learn(
    map_file: options.MapFile,
    data: options.DataFolder = None,
    as_json: options.Json = False,
) -> None:
    """Let a map learn from the queries that a server has kept for it.

    The map before is kept, as a server keeps it, and can be restored.
    """
    from rholoc.library.maps import MapLibrary
    from rholoc.library.queries import QueryStore
    from rholoc.mapping.learn.from_queries import learn_from_queries
    from rholoc.maps import load_map
    from rholoc.storage import ObjectStorage

    map_ = load_map(map_file)
    queries = QueryStore(ObjectStorage(options.data_folder(data))).load(map_.info.id)
    with stage_progress() as progress:
        learned = learn_from_queries(map_, queries, progress)
    MapLibrary(map_file.resolve().parent).replace(map_file.stem, learned)
    print_map(learned, map_file, as_json)


def queries(
    map_file: options.MapFile,
    data: options.DataFolder = None,
    delete: Annotated[bool, typer.Option("--delete", help="Delete them.")] = False,
    as_json: options.Json = False,
) -> None:
    """Show how many queries a server has kept for a map to learn from; or delete them."""
    from rholoc.library.queries import QueryStore
    from rholoc.maps import load_map
    from rholoc.storage import ObjectStorage

    store, map_id = QueryStore(ObjectStorage(options.data_folder(data))), load_map(map_file).info.id
    kept = asdict(store.kept(map_id))
    if delete:
        store.delete(map_id)
    if as_json:
        print_json({**kept, "deleted": delete})
        return
    for name in ("oldest", "newest"):
        if kept[name] is not None:
            kept[name] = datetime.fromtimestamp(kept[name], UTC).isoformat(timespec="seconds")
    title = f"{map_file}: deleted" if delete else str(map_file)
    print_figures(title, {name: "–" if value is None else str(value) for name, value in kept.items()})


def merge(
    map_file: options.MapFile,
    other: Annotated[Path, typer.Argument(metavar="OTHER", help="The map (.rho) that is merged into its frame.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="MERGED.rho", help="Where to.")],
    as_json: options.Json = False,
) -> None:
    """Merge two maps of rooms that overlap."""
    from rholoc.mapping.learn.merging import merge_maps
    from rholoc.maps import load_map

    a, b = load_map(map_file), load_map(other)
    with stage_progress() as progress:
        merged = merge_maps(a, b, progress)
    save_and_print(merged, out, as_json)


def forget(
    map_file: options.MapFile,
    recording: Annotated[
        str, typer.Argument(metavar="RECORDING", help="Its name or id, which `rholoc map info` lists under recordings.")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="MAP.rho", help="Where to; default: the map itself.")
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Make a map forget what it learned from a recording."""
    from rholoc.mapping.edit.sources import forget_recording
    from rholoc.maps import load_map

    save_and_print(forget_recording(load_map(map_file), recording), out or map_file, as_json)


def save_and_print(map_: Map, target: Path, as_json: bool) -> None:
    """Write a map to the file ``target``, and print its page or its figures as JSON. Raises InvalidMap,
    StorageFull, InvalidInput.
    """
    from rholoc.maps import save_map

    save_map(map_, target)
    print_map(map_, target, as_json)
