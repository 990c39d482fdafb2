"""``rholoc map``: builds maps, makes them learn and forget, inspects and exports them."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rholoc.cli import options
from rholoc.cli.console import output, print_error, print_figures, print_json, print_notice, stage_progress
from rholoc.cli.correcting import app as correct
from rholoc.cli.density import density
from rholoc.cli.targets import check_target
from rholoc.errors import InvalidInput, RholocError

if TYPE_CHECKING:
    from rholoc.maps import Map

_MAX_SHOWN = 12  # of a list; --json has all

app = typer.Typer(no_args_is_help=True, help="Build maps, make them learn and forget, inspect and export them.")
app.command()(density)
app.add_typer(correct, name="correct")


@app.command()
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
    as_json: options.Json = False,
) -> None:
    """Build a map from one or more recordings of a place."""
    if len(recordings) > 1 and (waypoints or frames or camera or length or topic):
        raise typer.BadParameter(
            "--frames, --camera, --waypoints, --length and --topic speak of one recording; give just one."
        )
    target = check_target(out or Path(f"{recordings[0].resolve().stem}.rho"), "the map")
    from rholoc.mapping import DEFAULT_FEATURES, BuildOptions, build_map
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
    _print_map(map_, target, as_json)


@app.command("list")
def list_maps(
    maps: Annotated[
        Path | None,
        typer.Argument(metavar="DIR", help="The folder of maps; default: RHOLOC_MAPS_DIR or maps."),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Show the maps of a folder, whether they are to be trusted, and how far they expect to be off."""
    from rholoc.library import MapLibrary
    from rholoc.maps import expected_error_m, trust_of

    folder = maps or Path(os.environ.get(options.MAPS_VARIABLE, options.DEFAULT_MAPS))
    library = MapLibrary(folder)
    rows: list[dict[str, Any]] = []
    for name in library.names():
        try:
            map_ = library.get(name)
        except RholocError as error:
            print_error(error.message, error.hint)
            continue
        trust = trust_of(map_.info)
        rows.append(
            {
                "name": name,
                "version": map_.info.version,
                "landmarks": len(map_),
                "views": len(map_.views),
                "trusted": trust.trusted,
                "trust_reason": trust.reason,
                "expected_error_m": expected_error_m(map_.info),
            }
        )
    if as_json:
        print_json(rows)
        return
    if not rows:
        print_notice(f"There are no maps in {folder}.")
    for row in rows:
        trusted = trust_line(row["trusted"], row["trust_reason"])
        expected_m = row["expected_error_m"]
        expected = "unknown" if expected_m is None else f"{100 * expected_m:.1f} cm"
        what = f"{row['landmarks']} landmarks, {row['views']} views, expected error {expected}"
        line = f"{row['name']}: {what}, trusted: {trusted}"
        output.print(line, markup=False, soft_wrap=True)


def trust_line(trusted: bool | None, reason: str) -> str:
    """Whether a map is to be trusted, and why (not), for people."""
    word = {True: "yes", False: "no", None: "unknown"}[trusted]
    return f"{word}. {reason}".strip() if reason else word


@app.command()
def info(map_file: options.MapFile, as_json: options.Json = False) -> None:
    """Print what a map says about itself, including its quality report."""
    from rholoc.maps import load_map

    _print_map(load_map(map_file), map_file, as_json)


@app.command()
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
    from rholoc.mapping import UpdateOptions, update_map
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
    _save(updated, out or map_file, as_json)


@app.command()
def learn(
    map_file: options.MapFile,
    data: options.DataFolder = None,
    as_json: options.Json = False,
) -> None:
    """Let a map learn from the queries that a server has kept for it.

    The map before is kept, as a server keeps it, and can be restored.
    """
    from rholoc.library import MapLibrary, QueryStore
    from rholoc.mapping import learn_from_queries
    from rholoc.maps import load_map
    from rholoc.storage import ObjectStorage

    map_ = load_map(map_file)
    queries = QueryStore(ObjectStorage(options.data_folder(data))).load(map_.info.id)
    with stage_progress() as progress:
        learned = learn_from_queries(map_, queries, progress)
    MapLibrary(map_file.resolve().parent).replace(map_file.stem, learned)
    _print_map(learned, map_file, as_json)


@app.command()
def queries(
    map_file: options.MapFile,
    data: options.DataFolder = None,
    delete: Annotated[bool, typer.Option("--delete", help="Delete them.")] = False,
    as_json: options.Json = False,
) -> None:
    """Show how many queries a server has kept for a map to learn from; or delete them."""
    from rholoc.library import QueryStore
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
    print_figures(title, {name: _shown(value) for name, value in kept.items()})


@app.command()
def merge(
    map_file: options.MapFile,
    other: Annotated[Path, typer.Argument(metavar="OTHER", help="The map (.rho) that is merged into its frame.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="MERGED.rho", help="Where to.")],
    as_json: options.Json = False,
) -> None:
    """Merge two maps of rooms that overlap."""
    from rholoc.mapping import merge_maps
    from rholoc.maps import load_map

    a, b = load_map(map_file), load_map(other)
    with stage_progress() as progress:
        merged = merge_maps(a, b, progress)
    _save(merged, out, as_json)


@app.command()
def forget(
    map_file: options.MapFile,
    recording: Annotated[
        str, typer.Argument(metavar="RECORDING", help="Its name or id, which `rholoc map info` lists as sources.")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="MAP.rho", help="Where to; default: the map itself.")
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Make a map forget what it learned from a recording."""
    from rholoc.mapping import forget_recording
    from rholoc.maps import load_map

    _save(forget_recording(load_map(map_file), recording), out or map_file, as_json)


@app.command()
def export(
    map_file: options.MapFile,
    to: Annotated[
        str,
        typer.Option(
            metavar="rho|csv|observations|trajectory|ply|vtp|gltf|surfaces|colmap|nerfstudio|png",
            help="CSV, observations, trajectory: Tables 5, 4 and 6; PLY, VTP: points, and surfaces: where densities "
            "peak, for ParaView; COLMAP, nerfstudio: cameras and poses; PNG: a picture from above.",
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE", help="Where to; default: the map's name.")
    ] = None,
    features: Annotated[
        str | None,
        typer.Option(metavar="N,A:B,…", help="Whose surfaces; default: the 500 seen most often."),
    ] = None,
    degree: Annotated[
        int | None, typer.Option(metavar="1|2|3", help="CSV of tensor densities fitted with this degree.")
    ] = None,
) -> None:
    """Write a map for other programs, or as a picture."""
    from rholoc.disk import replace_file
    from rholoc.exports import ExportFormat, export_map, parse_features
    from rholoc.maps import load_map

    form = options.choice(ExportFormat, to, "--to")
    chosen = None if features is None else parse_features(features)
    target = out or map_file.with_name(map_file.stem + form.ending)
    if target.resolve() == map_file.resolve():
        raise InvalidInput(f"{target} is the map itself.", "Export to another file.")
    map_ = load_map(map_file)
    replace_file(target, export_map(map_, form, title=map_file.stem, degree=degree, features=chosen))
    print_notice(f"{target}: {target.stat().st_size} bytes.")


@app.command("import")
def import_(
    table: Annotated[Path, typer.Argument(metavar="TABLE", help="A map as CSV (Table 5), as --to csv writes it.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="MAP.rho", help="Where to.")],
    as_json: options.Json = False,
) -> None:
    """Read a map from CSV. It localizes like the map that was written."""
    from rholoc.maps import read_coefficient_table

    _save(read_coefficient_table(table), out, as_json)


@app.command()
def report(
    map_file: options.MapFile,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="PNG", help="Where to; default: the map's name.")
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Draw a map's report: where it works and where not, how consistent it is, how exact its landmarks are."""
    from rholoc.disk import replace_file
    from rholoc.maps import load_map
    from rholoc.pictures.map_report import report_png

    map_ = load_map(map_file)
    target = out or map_file.with_name(f"{map_file.stem}-report.png")
    replace_file(target, report_png(map_, map_file.stem))
    figures = _map_figures(map_, map_file)["report"]
    if as_json:
        print_json(figures)
    else:
        print_figures(str(target), {name: _shown(value) for name, value in _flat(figures)})


def _save(map_: Map, target: Path, as_json: bool) -> None:
    from rholoc.maps import save_map

    save_map(map_, target)
    _print_map(map_, target, as_json)


def _print_map(map_: Map, path: Path, as_json: bool) -> None:
    figures = _map_figures(map_, path)
    if as_json:
        print_json(figures)
    else:
        print_figures(str(path), {name: _shown(value) for name, value in _flat(figures)})


def _map_figures(map_: Map, path: Path) -> dict[str, Any]:
    from rholoc.maps.info import info_to_json

    counts = {
        "file": str(path),
        "bytes": path.stat().st_size,
        "landmarks": len(map_),
        "descriptors": len(map_.descriptors),
        "views": len(map_.views),
    }
    description: dict[str, Any] = json.loads(info_to_json(map_.info))
    return counts | description


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Nested figures as (dotted name, value), lists of dicts numbered from 0."""
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, list) and value and isinstance(value[0], dict):
            value = {str(place): item for place, item in enumerate(value)}
        if isinstance(value, dict):
            yield from _flat(value, f"{name}.")
        else:
            yield name.replace("held_out.", "consistency."), value


def _shown(value: Any) -> str:
    match value:
        case None:
            return "–"
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:.4g}"
        case list() if len(value) > _MAX_SHOWN:
            return f"{len(value)} values"
        case list():
            return ", ".join(_shown(item) for item in value)
        case _:
            return str(value)
