"""``rholoc camera``: named cameras, and their calibration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rholoc.cli import options
from rholoc.cli.console import frame_progress, print_figures, print_json, print_notice
from rholoc.errors import InvalidCamera, InvalidInput

if TYPE_CHECKING:
    from rholoc.geometry import Camera
    from rholoc.library.cameras import CameraProfile

app = typer.Typer(no_args_is_help=True, help="Keep cameras under names, and calibrate them.")

Name = Annotated[str, typer.Argument(metavar="NAME", help="The camera's name.")]
Maps = Annotated[
    Path,
    typer.Option(
        "--maps", metavar="DIR", envvar=options.MAPS_VARIABLE, help="The folder of maps, which holds the cameras too."
    ),
]
_MAPS = Path(options.DEFAULT_MAPS)
_ENOUGH_COVERAGE = 0.7


@app.command()
def add(
    name: Name,
    source: Annotated[
        str,
        typer.Argument(
            metavar="CAMERA",
            help="FX,FY,CX,CY[,K1,K2,P1,P2[,K3]] in pixels, fisheye:FX,FY,CX,CY[,K1,K2,K3,K4], equirectangular, a "
            "camera.json, or a map for its camera.",
        ),
    ],
    size: Annotated[
        str | None, typer.Option(metavar="WIDTHxHEIGHT", help="The images' size in pixels, where CAMERA is a list.")
    ] = None,
    maps: Maps = _MAPS,
) -> None:
    """Store a camera under a name, replacing any of that name."""
    from rholoc.geometry import Lens
    from rholoc.library.cameras import CameraLibrary, CameraProfile

    is_written = "," in source or source == Lens.EQUIRECTANGULAR
    profile = CameraProfile(_parse(source, size) if is_written else _read(Path(source)))
    CameraLibrary(maps).put(name, profile)
    _print(name, profile, as_json=False)


@app.command(name="list")
def list_cameras(maps: Maps = _MAPS, as_json: options.Json = False) -> None:
    """List the cameras."""
    from rholoc.library.cameras import CameraLibrary

    library = CameraLibrary(maps)
    profiles = {name: library.get(name) for name in library.names()}
    if as_json:
        print_json({name: _figures(profile) for name, profile in profiles.items()})
    else:
        print_figures(f"Cameras of {maps}", {name: _line(profile.camera) for name, profile in profiles.items()})


@app.command()
def show(name: Name, maps: Maps = _MAPS, as_json: options.Json = False) -> None:
    """Print a camera's intrinsics and how it was calibrated."""
    from rholoc.library.cameras import CameraLibrary

    _print(name, CameraLibrary(maps).get(name), as_json)


@app.command()
def remove(name: Name, maps: Maps = _MAPS) -> None:
    """Delete a camera; maps that were made with it keep it."""
    from rholoc.library.cameras import CameraLibrary

    CameraLibrary(maps).delete(name)


@app.command()
def calibrate(
    source: Annotated[Path, typer.Argument(metavar="SOURCE", help="A video or a folder of pictures of the board.")],
    board: Annotated[
        str,
        typer.Option(
            metavar="COLUMNSxROWS",
            help="The board's size: inner corners of a checkerboard, squares of a ChArUco board.",
        ),
    ],
    square_mm: Annotated[float, typer.Option(help="The side of a square, in mm.")],
    charuco: Annotated[
        bool, typer.Option("--charuco", help="The board has ArUco markers in its white squares.")
    ] = False,
    lens: Annotated[str, typer.Option(metavar="pinhole|fisheye", help="How the camera projects.")] = "pinhole",
    name: Annotated[str | None, typer.Option(help="Store the camera under this name.")] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="PNG", help="Draw where in the image the board was seen, and the residuals.")
    ] = None,
    frames: options.Frames = None,
    topic: options.Topics = None,
    maps: Maps = _MAPS,
    as_json: options.Json = False,
) -> None:
    """Calibrate a camera from a video or pictures of a flat board, filmed from all sides."""
    from rholoc.calibration import Board, BoardKind
    from rholoc.calibration import calibrate as calibrated
    from rholoc.disk import replace_file
    from rholoc.geometry import Lens
    from rholoc.library.cameras import CameraLibrary, CameraProfile, check_camera_name
    from rholoc.recordings import read_recording

    kind = BoardKind.CHARUCO if charuco else BoardKind.CHECKERBOARD
    looked_for = Board.parse(board, square_mm, kind)
    library = CameraLibrary(maps)
    if name is not None:
        check_camera_name(name)  # refuses an invalid name before the work
    shown = read_recording(source, frames=frames, topics=topic or ()).frames
    with frame_progress("looking for the board", len(shown.times)) as advance:
        found = calibrated(shown, looked_for, advance, options.choice(Lens, lens, "--lens"))
    profile = CameraProfile(found.camera, found.figures)
    if name is not None:
        library.put(name, profile)
    if picture is not None:
        from rholoc.pictures.calibration import calibration_png

        replace_file(picture, calibration_png(found))
    _print(name or str(source), profile, as_json)


def _parse(text: str, size: str | None) -> Camera:
    """The camera written as text, for images of ``size`` (WIDTHxHEIGHT). Raises InvalidInput if one is not valid."""
    from rholoc.geometry import Camera

    width, _, height = (size or "").partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise InvalidInput(
            "The size of the camera's images is missing.", "Give --size WIDTHxHEIGHT, such as 1920x1080."
        )
    return Camera.parse(text, int(width), int(height))


def _read(path: Path) -> Camera:
    """The camera of a map (.rho), or in a camera.json. Raises the errors of both, InvalidCamera without intrinsics."""
    from rholoc.maps import load_map
    from rholoc.recordings import read_camera_json

    if path.suffix == ".rho":
        return load_map(path).info.camera
    camera = read_camera_json(path).camera
    if camera is None:
        raise InvalidCamera(f"{path.name} has no intrinsics.", "It needs width, height, fx, fy, cx and cy.")
    return camera


def _figures(profile: CameraProfile) -> dict[str, Any]:
    """Intrinsics and calibration by name, JSON-serialisable."""
    return {**profile.camera.to_dict(), "calibration": profile.calibration}


def _line(camera: Camera) -> str:
    """Size, lens and intrinsics [px] in one line."""
    lens, _, _ = camera.to_text().rpartition(":")
    figures = ",".join(f"{value:.6g}" for value in camera.parameters)
    return f"{camera.width}x{camera.height} {lens}{':' if lens else ''}{figures}"


def _print(name: str, profile: CameraProfile, as_json: bool) -> None:
    """Print a camera with the accuracy of its calibration, as JSON or as a table."""
    if as_json:
        print_json(_figures(profile))
        return
    lines = {"camera": _line(profile.camera)}
    sigmas = profile.calibration.get("sigmas", {})
    if isinstance(sigmas, dict) and sigmas:
        lines["±"] = ", ".join(f"{parameter} {sigma:g}" for parameter, sigma in sigmas.items())
    rest = {key: value for key, value in profile.calibration.items() if key != "sigmas"}
    print_figures(name, lines | {key.replace("_", " "): str(value) for key, value in rest.items()})
    if profile.calibration.get("coverage", 1.0) < _ENOUGH_COVERAGE:
        print_notice("The board was not seen everywhere in the image; distortion is a guess where it was not.")
