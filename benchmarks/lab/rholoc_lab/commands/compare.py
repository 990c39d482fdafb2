"""``rholoc compare``: the density beside the baselines, and extractors across lights."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rholoc.cli import options
from rholoc.cli.console import fraction_progress, output, print_json, print_notice, stage_progress
from rholoc.errors import InvalidInput

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table

    from rholoc.recordings import Recording
    from rholoc_lab.evaluation.compare import Comparison, SplitResult
    from rholoc_lab.evaluation.lighting import LightPair
    from rholoc_lab.evaluation.lighting_pairs import ScenePair
    from rholoc_lab.evaluation.splits import QuerySet

_MAP_WALK, _QUERY_WALK = 1, 2
_MAP_FPS, _QUERY_FPS = 4.0, 2.0  # poses are given, so a few frames of a whole walk are enough


def compare(
    recordings: Annotated[
        list[Path] | None,
        typer.Argument(metavar="RECORDING...", help="Recordings with poses; what is held out of them is localized."),
    ] = None,
    queries: Annotated[
        Path | None, typer.Option(metavar="RECORDING", help="Localize this recording's frames instead.")
    ] = None,
    map_frames: Annotated[
        str | None, typer.Option(metavar="START:STOP[:STEP]", help="The map's frames, of one recording.")
    ] = None,
    query_frames: Annotated[
        list[str] | None,
        typer.Option(metavar="START:STOP[:STEP]", help="The queries' frames; give it again for another set."),
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="Only every N-th query.")] = 1,
    truth: Annotated[bool, typer.Option("--truth", help="Take poses from a simulated recording's truth.csv.")] = False,
    camera: options.Camera = None,
    features: Annotated[
        str | None,
        typer.Option(metavar="gray|rgb|lab|lab3|sift|sift48|xfeat", help="The features that all methods share."),
    ] = None,
    dof: options.DofOption = "6",
    tensor: Annotated[bool, typer.Option(help="Run the tensor density too.")] = True,
    retrieval: Annotated[bool, typer.Option(help="Run the pipeline of SIFT, retrieval and poselib too.")] = True,
    lighting: Annotated[
        bool, typer.Option("--lighting", help="Compare extractors across simulated lights instead.")
    ] = False,
    lighting_pairs: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Compare extractors on real pairs of pictures by two lights instead."),
    ] = None,
    seconds: Annotated[float, typer.Option(min=2, max=600, help="--lighting: the length of each walk.")] = 30.0,
    seed: Annotated[int, typer.Option(min=0, help="--lighting: another seed is another room.")] = 0,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="DIR", help="Write figures as JSON, and plots, into it.")
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Compare the density with baselines on the same features and matches, or extractors across lights."""
    modes = [bool(recordings), lighting, lighting_pairs is not None]
    if sum(modes) != 1:
        raise typer.BadParameter("Give recordings, or --lighting, or --lighting-pairs.", param_hint="RECORDING...")
    chosen = None if features is None else [features]
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    if lighting:
        _lighting(chosen, seconds, seed, out, as_json)
    elif lighting_pairs is not None:
        _lighting_pairs(lighting_pairs, chosen, out, as_json)
    else:
        from rholoc.features import DEFAULT_FEATURES
        from rholoc_lab.evaluation.compare import CompareOptions

        settings = CompareOptions(features or DEFAULT_FEATURES, options.dof(dof), tensor, retrieval)
        read = [_read(path, camera, truth) for path in recordings or []]
        asked = None if queries is None else _read(queries, camera, truth)
        walks, query_sets = _split(read, asked, map_frames, query_frames or [])
        _recordings(walks, [one.every(every) for one in query_sets], settings, out, as_json)


def _read(path: Path, camera: str | None, truth: bool) -> Recording:
    from rholoc.recordings import read_recording
    from rholoc_lab.evaluation.splits import with_poses

    return with_poses(read_recording(path, camera=options.named_camera(camera)), truth)


def _split(
    recordings: Sequence[Recording], queries: Recording | None, map_frames: str | None, query_frames: Sequence[str]
) -> tuple[list[Recording], list[QuerySet]]:
    """The recordings to map, and the sets of queries."""
    from rholoc_lab.evaluation.splits import QuerySet, choose_rows, hold_out_blocks, take_rows

    if queries is None and bool(map_frames) != bool(query_frames):
        raise InvalidInput(
            "Give both --map-frames and --query-frames, or neither.", "Neither holds out every fifth block."
        )
    if len(recordings) > 1 and (map_frames or (query_frames and queries is None)):
        raise InvalidInput("--map-frames and --query-frames apply to a single recording.", "Give just one.")
    if queries is not None or query_frames:
        source = recordings[0] if queries is None else queries
        chosen: Sequence[str | None] = query_frames or [None]
        sets = [QuerySet(text or source.name, source, choose_rows(source, text)) for text in chosen]
        return [take_rows(one, choose_rows(one, map_frames)) for one in recordings], sets
    walks, sets = [], []
    for recording in recordings:
        mapped, held_out = hold_out_blocks(choose_rows(recording, None))
        walks.append(take_rows(recording, mapped))
        sets.append(QuerySet(f"{recording.name}, every fifth block", recording, held_out))
    return walks, sets


def _recordings(
    walks: Sequence[Recording], sets: Sequence[QuerySet], settings: Any, out: Path | None, as_json: bool
) -> None:
    from rholoc_lab.evaluation.compare import compare as run
    from rholoc_lab.pictures.comparison import plot_error_by_distance, plot_errors_from_above, plot_recall

    with stage_progress() as progress:
        comparison = run(walks, sets, settings, progress)
    figures = comparison.as_dict()
    if as_json:
        print_json(figures)
    else:
        for split in comparison.splits:
            _print(_table(comparison, split))
    if out is not None:
        plots = {}
        for number, split in enumerate(comparison.splits, start=1):
            plots[f"recall-{number}.png"] = plot_recall(split)
            plots[f"distance-{number}.png"] = plot_error_by_distance(split)
            plots[f"top-view-{number}.png"] = plot_errors_from_above(comparison, split)
        _write(out, "comparison.json", figures, plots)


def _lighting(features: list[str] | None, seconds: float, seed: int, out: Path | None, as_json: bool) -> None:
    from rholoc.recordings import read_recording
    from rholoc.simulation import Light, Renderer, make_test_site, simulate_recording
    from rholoc_lab.evaluation.lighting import compare_lights
    from rholoc_lab.evaluation.splits import with_poses
    from rholoc_lab.pictures.lighting import plot_lights

    with _folder(out) as folder:
        walks: dict[tuple[str, int], Recording] = {}
        jobs = [(light, walk) for light in Light for walk in (_MAP_WALK, _QUERY_WALK)]
        with fraction_progress("simulating") as progress:
            for done, (light, walk) in enumerate(jobs):
                path = folder / "recordings" / f"{light}-{walk}"
                fps = _MAP_FPS if walk == _MAP_WALK else _QUERY_FPS
                simulate_recording(path, walk=walk, light=light, seconds=seconds, seed=seed, fps=fps)
                walks[light.value, walk] = with_poses(read_recording(path), use_truth=True)
                progress((done + 1) / len(jobs))
        scene = make_test_site(seed)
        renderer = Renderer(scene, [face.paint.albedo for face in scene.faces])
        with stage_progress() as listener:
            pairs = compare_lights(
                {light.value: walks[light.value, _MAP_WALK] for light in Light},
                {light.value: walks[light.value, _QUERY_WALK] for light in Light},
                lambda camera, pose: renderer.surface(camera, pose).points,
                features,
                listener,
            )
    figures = [pair.figures() for pair in pairs]
    if as_json:
        print_json(figures)
    else:
        _print(_lights_table(pairs))
    if out is not None:
        _write(out, "lighting.json", figures, {"lighting.png": plot_lights(pairs)})


def _lighting_pairs(folder: Path, features: list[str] | None, out: Path | None, as_json: bool) -> None:
    from rholoc_lab.evaluation.lighting_pairs import compare_lighting_pairs
    from rholoc_lab.pictures.lighting import plot_scenes

    with stage_progress() as progress:
        pairs = compare_lighting_pairs(folder, features, progress)
    figures = [pair.figures() for pair in pairs]
    if as_json:
        print_json(figures)
    else:
        _print(_scenes_table(pairs))
    if out is not None:
        _write(out, "lighting-pairs.json", figures, {"lighting-pairs.png": plot_scenes(pairs)})


@contextmanager
def _folder(out: Path | None) -> Iterator[Path]:
    """The folder for simulated recordings: the user's, which is kept, or else a temporary one."""
    if out is not None:
        yield out
    else:
        with tempfile.TemporaryDirectory(prefix="rholoc-compare-") as folder:
            yield Path(folder)


def _write(out: Path, name: str, figures: Any, plots: dict[str, Figure]) -> None:
    from rholoc.pictures.trajectories import save_figure

    (out / name).write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    for file, figure in plots.items():
        save_figure(figure, out / file)
    print_notice(f"{out}: {name}, {', '.join(plots)}.")


def _table(comparison: Comparison, split: SplitResult) -> Table:
    title = (
        f"queries {split.label}: {len(split.truth)} frames; map of {len(comparison.map_.views)} views, "
        f"{len(comparison.map_)} {comparison.options.features} features"
    )
    heads = (
        "2 cm, 2°",
        "5 cm, 5°",
        "10 cm, 5°",
        "25 cm, 10°",
        "median",
        "no pose",
        "wrong",
        "ms",
        "ms by stage",
        "map",
    )
    table = _new_table(title, ["method"], *heads)
    for method in split.methods:
        figures = method.figures()
        stages = {stage: ms for stage, ms in figures["median_ms"].items() if stage != "total"}
        table.add_row(
            method.name,
            *(_percent(share) for share in figures["recall"].values()),
            f"{_number(figures['median_cm'])} cm, {_number(figures['median_deg'])}°",
            str(figures["no_pose"]),
            str(figures["wrong_pose"]),
            f"{figures['median_ms']['total']:.0f}",
            ", ".join(f"{stage} {ms:.0f}" for stage, ms in stages.items()),
            f"{figures['map_bytes'] / 1e6:.1f} MB",
        )
    return table


def _lights_table(pairs: Sequence[LightPair]) -> Table:
    heads = ("repeatability", "precision", "right matches", "5 cm, 5°", "median", "landmarks")
    table = _new_table("Extractors across lights", ["features", "map by", "queries by"], *heads)
    for pair in pairs:
        table.add_row(
            pair.features,
            pair.map_light,
            pair.query_light,
            _percent(pair.redetection.repeatability),
            _percent(pair.redetection.precision),
            f"{pair.redetection.right / max(pair.queries, 1):.0f}",
            _percent(pair.recall),
            f"{_number(pair.median_cm)} cm",
            str(pair.landmarks),
        )
    return table


def _scenes_table(pairs: Sequence[ScenePair]) -> Table:
    heads = ("repeatability", "precision", "right matches", "stereo precision", "stereo right matches")
    table = _new_table("Extractors on real pairs of lights", ["scene", "features"], *heads)
    for pair in pairs:
        registered = pair.registered
        table.add_row(
            pair.scene,
            pair.features,
            _percent(None if registered is None else registered.repeatability),
            _percent(None if registered is None else registered.precision),
            "–" if registered is None else str(registered.right),
            _percent(pair.stereo_precision),
            "–" if pair.stereo_right is None else str(pair.stereo_right),
        )
    return table


def _print(table: Table) -> None:
    """Print a table at its full width, so that a narrow terminal wraps its lines rather than its words."""
    from rich.console import Console
    from rich.measure import Measurement

    wide = output.options.update(max_width=1000)
    Console(highlight=False, width=Measurement.get(output, wide, table).maximum).print(table)


def _new_table(title: str, names: Sequence[str], *figures: str) -> Table:
    """A table of columns of names, then columns of figures."""
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for head in names:
        table.add_column(head)
    for head in figures:
        table.add_column(head, justify="right")
    return table


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"
