"""``rholoc paper``: the paper's data flow, step by step: observations (Table 4), the map they give, a trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rholoc.cli import options
from rholoc.cli.console import frame_progress, print_figures, print_json, print_notice, stage_progress
from rholoc.cli.options import check_target
from rholoc.errors import InvalidCamera

if TYPE_CHECKING:
    from rholoc.geometry import Camera as GeometryCamera
    from rholoc.maps import ObservationTable
    from rholoc_lab.paper.from_observations import FitFigures

app = typer.Typer(no_args_is_help=True, help="The paper's data flow: observations, the map they give, a trajectory.")

_CAMERA_ENDING = ".camera.json"


@app.command()
def observations(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A video, a folder of images, or a recording's folder.")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="CSV", help="Where to; default: NAME-observations.csv.")
    ] = None,
    features: Annotated[
        str, typer.Option(metavar="gray|rgb|lab|lab3|sift|sift48|xfeat", help="What is looked for in the pictures.")
    ] = "lab",
    poses: Annotated[
        str, typer.Option(metavar="visual-inertial|visual|inertial|odometry|given", help="Where frame poses come from.")
    ] = "inertial",
    frames: options.Frames = None,
    camera: options.Camera = None,
    waypoints: Annotated[
        Path | None, typer.Option(metavar="CSV", help="Measured waypoints: name[,time or frame],x,y,z.")
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Write what a walk saw from where (Table 4), before there is a map."""
    from rholoc.disk import replace_file
    from rholoc.maps import observations_csv
    from rholoc.recordings import CameraFile, read_recording, write_camera_json
    from rholoc.trajectory import PoseMethod
    from rholoc_lab.paper.observing import observe_recording

    method = options.choice(PoseMethod, poses, "--poses")
    target = out or Path(f"{recording.resolve().stem}-observations.csv")
    check_target(target, "the result")
    with stage_progress() as progress:
        read = read_recording(recording, options.named_camera(camera), frames, waypoints)
        table, used = observe_recording(read, features, method, progress)
    replace_file(target, "".join(observations_csv(table)).encode("ascii"))
    write_camera_json(_camera_file(target), CameraFile(used))
    figures = {
        "observations": len(table),
        "frames": _frames(table),
        "features": features,
        "poses": poses,
        "table": str(target),
        "camera": str(_camera_file(target)),
    }
    _print(f"{recording.name}: Table 4", figures, as_json)


@app.command()
def fit(
    table: Annotated[Path, typer.Argument(metavar="TABLE4", help="Observations as CSV.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="MAP.rho", help="Where to.")],
    degree: Annotated[int, typer.Option(metavar="1|2|3", help="P of equation (3); with 1 nothing localizes.")] = 2,
    density: Annotated[
        str, typer.Option(metavar="ray|tensor|observed", help="The form of the densities.")
    ] = "observed",
    seen_only: Annotated[
        bool, typer.Option("--seen-only", help="Loss (5) as it is printed: over the points where a feature was seen.")
    ] = False,
    features: Annotated[
        str | None,
        typer.Option(
            metavar="gray|rgb|lab|lab3|sift|sift48|xfeat", help="What they are of; default: as descriptors tell."
        ),
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="FX,FY,CX,CY[,K1,K2,P1,P2[,K3]]|NAME",
            help="The camera of the pixels; default: the .camera.json beside the table.",
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(metavar="WIDTHxHEIGHT", help="Of the pictures; default: as far as the camera's centre tells."),
    ] = None,
    report: Annotated[bool, typer.Option(help="Hold every tenth view out and localize it, for the report.")] = True,
    as_json: options.Json = False,
) -> None:
    """Fit densities to observations (loss 5) and write the map: the paper's map generator."""
    from rholoc.maps import DensityKind, save_map
    from rholoc_lab.paper.from_observations import FitOptions, fit_figures, map_from_observations
    from rholoc_lab.paper.table_reading import read_observations

    form = options.choice(DensityKind, density, "--density")
    check_target(out, "the result")
    used = _camera(table, camera, size)
    read = read_observations(table)
    with stage_progress() as progress:
        map_ = map_from_observations(
            read, used, table.name, FitOptions(form, degree, seen_only, features, report), progress
        )
        figures_of_fit = fit_figures(map_, seen_only)
    save_map(map_, out)
    held_out = map_.info.report.held_out
    figures: dict[str, object] = {
        "observations": len(read),
        "frames": _frames(read),
        "features": len(map_),
        "density": form.value,
        "map": str(out),
    }
    if figures_of_fit is not None:
        figures |= _fit(figures_of_fit)
    if held_out is not None:
        figures["held_out"] = held_out.frames
        figures["held_out_localized"] = held_out.localized
        figures["held_out_median_m"] = held_out.median_m
    _print(f"{table.name} → {out.name}", figures, as_json)


@app.command()
def localize(
    map_file: options.MapFile,
    source: options.Source,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="CSV", help="Where the trajectory goes.")] = Path(
        "trajectory.csv"
    ),
    frames: options.Frames = None,
    camera: options.Camera = None,
    dof: options.DofOption = "6",
    starts: Annotated[int, typer.Option(min=1, max=50, help="From how many places, by vote, to climb.")] = 4,
    follow: Annotated[bool, typer.Option("--follow", help="Start each frame from the pose of the one before.")] = False,
    as_json: options.Json = False,
) -> None:
    """Localize by the densities alone (Figure 9): no pose is solved for, verified or refused; writes Table 6."""
    import numpy as np

    from rholoc.cli.localize import recording_camera
    from rholoc.features import get_extractor
    from rholoc.maps import load_map, write_trajectory_csv
    from rholoc.maps.formats.trajectory_table import TrajectoryTable
    from rholoc.paper.density_localizer import DensityLocalizer
    from rholoc.recordings import read_recording

    degrees_of_freedom = options.dof(dof)
    check_target(out, "the result")
    map_ = load_map(map_file)
    recording = read_recording(source, camera=options.named_camera(camera), frames=frames)
    used = recording_camera(recording, map_.info)
    localizer, extractor = DensityLocalizer(map_, starts), get_extractor(map_.info.features)
    rows, poses, inliers, shares = [], [], [], []
    count = len(recording.frames.times)
    last = None
    with frame_progress("localizing", count) as advance:
        for row, image in enumerate(recording.frames.images(range(count))):
            found = extractor.extract(image)
            answer = localizer.localize(found, used, degrees_of_freedom, last) if last is not None else None
            answer = answer or localizer.localize(found, used, degrees_of_freedom)
            if answer is not None:
                rows.append(row)
                poses.append(answer.optimum.T_map_camera)
                inliers.append(answer.inliers)
                shares.append(answer.inliers / len(answer.evidence))
            last = answer.optimum.T_map_camera if follow and answer is not None else None
            advance()
    kept = np.array(rows, dtype=np.int64)
    table = TrajectoryTable(
        times=recording.frames.times[kept],
        frames=recording.frames.numbers[kept],
        T_map_camera=np.reshape(np.asarray(poses, dtype=np.float64), (-1, 4, 4)),
        confidences=np.full(len(kept), np.nan),
        inliers=np.array(inliers, dtype=np.int64),
    )
    write_trajectory_csv(out, table)
    figures: dict[str, object] = {
        "frames": count,
        "with_a_pose": len(kept),
        "agreeing_share": round(float(np.median(shares)), 3) if shares else None,
        "density": map_.info.density.value,
        "trajectory": str(out),
    }
    _print(f"{source} in {map_file.name}", figures, as_json)
    print_notice("These poses are optima, right or wrong; `rholoc localize` says how far it believes its own.")


def _fit(figures: FitFigures) -> dict[str, object]:
    return {
        "densities": figures.densities,
        "observations_each": figures.observations,
        "n_f": figures.points,
        "w": figures.volume,
        "loss_of_a_constant": _three_digits(figures.constant_share),
        "loss_of_the_fit": _three_digits(figures.fitted_share),
        "with_a_peak": round(figures.peaked_share, 3),
    }


def _three_digits(share: float) -> float:
    """Round a share to three significant digits, because losses span orders of magnitude."""
    return float(f"{share:.3g}")


def _camera(table: Path, camera: str | None, size: str | None) -> GeometryCamera:
    """Camera that ``camera`` names, or else the one in the file beside the table."""
    from rholoc.geometry import Camera
    from rholoc.recordings import read_camera_json

    beside = _camera_file(table)
    if camera is None:
        if not beside.is_file():
            raise InvalidCamera(
                f"The camera of {table.name} is not known.",
                f"Give --camera fx,fy,cx,cy, or {beside.name} beside the table.",
            )
        known = read_camera_json(beside).camera
        if known is None:
            raise InvalidCamera(f"{beside.name} has no intrinsics.", "Give --camera fx,fy,cx,cy.")
        return known
    named = options.named_camera(camera)
    if isinstance(named, Camera):
        return named
    values = str(named).split(",")
    try:
        centre = [float(value) for value in values[2:4]]
        width, height = (
            (int(part) for part in size.lower().split("x")) if size else (round(2 * one + 1) for one in centre)
        )
    except ValueError:
        raise InvalidCamera(f"'{size or camera}' is not an image size.", "Give --size as 640x480.") from None
    return Camera.parse(str(named), width, height)


def _camera_file(table: Path) -> Path:
    return table.with_name(table.stem + _CAMERA_ENDING)


def _frames(table: ObservationTable) -> int:
    import numpy as np

    return len(np.unique(np.column_stack([table.positions, table.headings]), axis=0))


def _print(title: str, figures: dict[str, object], as_json: bool) -> None:
    if as_json:
        print_json(figures)
    else:
        print_figures(title, {name: "–" if value is None else f"{value}" for name, value in figures.items()})
