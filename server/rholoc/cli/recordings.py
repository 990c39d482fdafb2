"""``rholoc recording``: inspects recordings before a map is made from them."""

from pathlib import Path
from typing import Annotated, Any

import typer

from rholoc.cli import options
from rholoc.cli.console import output, print_figures, print_json, print_notice
from rholoc.cli.lab import CommandsOfTheLab

app = typer.Typer(no_args_is_help=True, cls=CommandsOfTheLab, help="Inspect recordings before a map is made from them.")


@app.callback()
def _group() -> None:
    pass


@app.command()
def info(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A video, a folder of images, a recording's folder or ZIP file.")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="FILE.png", help="Also draw IMU, intervals and waypoints.")
    ] = None,
    frames: options.Frames = None,
    camera: options.Camera = None,
    topic: options.Topics = None,
    as_json: options.Json = False,
) -> None:
    """Describe a recording: what it is, its problems, and what to do better next time."""
    from rholoc.recordings import describe_recording, read_recording

    read = read_recording(recording, camera=options.named_camera(camera), frames=frames, topics=topic or ())
    description = describe_recording(read)
    if as_json:
        print_json(description)
    else:
        print_figures(str(recording), _figures(description))
        _print_findings(description)
    if out is not None:
        from rholoc.disk import replace_file
        from rholoc.pictures.recording import recording_png

        replace_file(out, recording_png(read))
        print_notice(f"{out} shows it.")


def _figures(description: dict[str, Any]) -> dict[str, str]:
    """A recording's description as texts with units, by name."""
    frames, imu, poses = description["frames"], description["imu"], description["poses"]
    measured = description["figures"]
    shown = {
        "format": description["format"],
        "frames": f"{frames['count']}, {_size(frames)}{_span(frames)}",
        "camera": _camera(description),
        "IMU": "none" if imu is None else f"{imu['rows']} rows, {_span(imu)}, {_imu(imu)}",
        "pauses": "–" if imu is None else str(len(imu["pauses_s"])),
        "waypoints": ", ".join(waypoint["name"] for waypoint in description["waypoints"]) or "none",
        "poses": "none" if poses is None else _poses(poses),
        **({"depth": f"of {description['depth_images']} frames"} if description["depth_images"] else {}),
    }
    for name, key, unit in (
        ("turning, 90 %", "turn_deg_s", "°/s"),
        ("brightness", "brightness", " of 255"),
        ("frames without texture", "bare_share", ""),
        ("nearest return", "nearest_return", " of the way"),
    ):
        if measured[key] is not None:
            value = f"{measured[key]:.0%}" if not unit or "way" in unit else f"{measured[key]:.0f}"
            shown[name] = f"{value}{unit}"
    return shown


def _size(frames: dict[str, Any]) -> str:
    """ "WIDTH×HEIGHT, ", or "no images, "."""
    return f"{frames['width']}×{frames['height']}, " if frames["width"] else "no images, "


def _span(table: dict[str, Any]) -> str:
    """Length [s] and rate [Hz] of a table with times, in words."""
    if table["start_s"] is None:
        return "without times"
    rate = "" if table["rate_hz"] is None else f" at {table['rate_hz']:.1f} Hz"
    return f"{table['end_s'] - table['start_s']:.1f} s{rate}"


def _camera(description: dict[str, Any]) -> str:
    """Intrinsics of a recording, in words."""
    camera, logged = description["camera"], description["frame_intrinsics"]
    if camera is not None:
        lens = f"{camera['lens']}, " if "lens" in camera else ""
        return f"{lens}fx {camera['fx']:.1f}, fy {camera['fy']:.1f}, cx {camera['cx']:.1f}, cy {camera['cy']:.1f} px"
    if logged is not None and logged["fx"] is not None:
        return f"logged for each frame, fx {logged['fx'][0]:.1f} to {logged['fx'][1]:.1f} px"
    return "unknown: will be calibrated with the poses"


def _imu(imu: dict[str, Any]) -> str:
    """Whether the IMU's readings include gravity, and whether its mounting is known, in words."""
    gravity = "with gravity" if imu["includes_gravity"] else "without gravity"
    return f"{gravity}, mounting {'known' if imu['mounting_known'] else 'unknown'}"


def _poses(poses: dict[str, Any]) -> str:
    """Number of known poses and the length of their path, in words."""
    unit = " m" if poses["metric"] else " units of unknown length"
    return f"{poses['known']}, along {poses['path_length']:.2f}{unit}"


def _print_findings(description: dict[str, Any]) -> None:
    """Print a recording's problems and the advice for the next, one line each."""
    for title, findings in (("problem", description["warnings"]), ("next time", description["advice"])):
        for finding in findings:
            output.print(f"{title}: {finding['text']}", markup=False, soft_wrap=True)
