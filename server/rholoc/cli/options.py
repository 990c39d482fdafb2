"""Options that several commands share, and checks of their output files before the work begins."""

from __future__ import annotations

import os
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

if TYPE_CHECKING:
    from rholoc.geometry import Camera as GeometryCamera
    from rholoc.geometry import FloatArray
    from rholoc.localization import Dof
from rholoc.errors import InvalidInput

_Choice = TypeVar("_Choice", bound=StrEnum)

MAPS_VARIABLE = "RHOLOC_MAPS_DIR"
DEFAULT_MAPS = "maps"
DATA_VARIABLE = "RHOLOC_DATA_DIR"
DEFAULT_DATA = ".rholoc"

DataFolder = Annotated[
    Path | None,
    typer.Option("--data", metavar="DIR", help="The server's data folder; default: RHOLOC_DATA_DIR or .rholoc."),
]

Camera = Annotated[
    str | None,
    typer.Option(
        metavar="FX,FY,CX,CY[,K1,K2,P1,P2[,K3]]|NAME",
        help="Intrinsics in pixels of the frames, with OpenCV's distortion; fisheye:FX,FY,CX,CY[,K1,K2,K3,K4]; "
        "equirectangular; or a camera that `rholoc camera` keeps; instead of the recording's own.",
    ),
]
DofOption = Annotated[
    str,
    typer.Option(
        "--dof",
        metavar="auto|5|6",
        help="5: the camera does not roll; 6: roll is estimated too; auto: 6, roll being improbable where the map's "
        "own views were upright.",
    ),
]
Frames = Annotated[
    str | None,
    typer.Option(metavar="START:STOP[:STEP]", help="Only these frames, by number; STOP is left out."),
]
Topics = Annotated[
    list[str] | None,
    typer.Option(
        "--topic", metavar="NAME", help="Of a bag, a topic to take where there are several of a kind; repeatable."
    ),
]
Mount = Annotated[
    str,
    typer.Option(
        metavar="X,Y,Z,ROLL,PITCH,YAW",
        help="The camera on the robot, in metres and degrees; x forward, y left, z up; zeros look forward.",
    ),
]
MOUNT = "0,0,0,0,0,0"
MotionOption = Annotated[
    str | None,
    typer.Option(
        "--motion",
        metavar="odometry|imu|pictures",
        help="What the tracker knows of motion; default: odometry where it is given, else pictures.",
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Another seed is another room; the same one the same recording.")]
Json = Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")]
MapFile = Annotated[Path, typer.Argument(metavar="MAP", help="A map file (.rho).")]
Source = Annotated[
    Path,
    typer.Argument(metavar="SOURCE", help="A video, an image or a folder of them, a ROS bag, or a recording's folder."),
]


def named_camera(text: str | None) -> GeometryCamera | str | None:
    """The stored camera that ``--camera`` names; intrinsics and None are returned as they are.

    Raises:
        InvalidName, UnknownCamera, InvalidCamera: there is no such camera, or its file is damaged.
    """
    from rholoc.library.cameras import CameraLibrary

    return CameraLibrary(Path(os.environ.get(MAPS_VARIABLE, DEFAULT_MAPS))).named_in(text)


def mounting(text: str) -> FloatArray:
    """T_base_camera (4, 4) that ``--mount`` says: metres and degrees, the base x forward, the camera z forward.

    Raises typer.BadParameter for another text than six finite numbers.
    """
    import numpy as np
    from scipy.spatial.transform import Rotation

    from rholoc.geometry import R_FORWARD_OPTICAL, pose_matrix

    try:
        x, y, z, roll, pitch, yaw = (float(part) for part in text.split(","))
        if not np.isfinite((x, y, z, roll, pitch, yaw)).all():
            raise ValueError
    except ValueError:
        raise typer.BadParameter(f"'{text}' is not x,y,z,roll,pitch,yaw.", param_hint="--mount") from None
    R_base_forward = Rotation.from_euler("ZYX", (yaw, pitch, roll), degrees=True).as_matrix()
    return pose_matrix(R_base_forward @ R_FORWARD_OPTICAL, np.array([x, y, z]))


def dof(text: str) -> Dof:
    """The degrees of freedom that ``--dof`` names. Raises typer.BadParameter."""
    from rholoc.localization import Dof

    named = {str(one.value): one for one in Dof}
    if text not in named:
        raise typer.BadParameter(f"'{text}' is not one of {', '.join(named)}.", param_hint="--dof")
    return named[text]


def choice(kind: type[_Choice], text: str, option: str) -> _Choice:
    """The member of an enum that an option names. Raises typer.BadParameter.

    Options are strings up to here, so that the enums' packages, and what these need, are only loaded for commands that
    use them: ``rholoc --help`` stays fast.
    """
    try:
        return kind(text)
    except ValueError as error:
        raise typer.BadParameter(f"'{text}' is not one of {', '.join(kind)}.", param_hint=option) from error


def data_folder(given: Path | None) -> Path:
    """The data folder: given by the command, else by RHOLOC_DATA_DIR, else the default one."""
    return given or Path(os.environ.get(DATA_VARIABLE, DEFAULT_DATA))


def check_target(path: Path, what: str) -> Path:
    """Return the path after checking that a file for ``what`` can be written there.

    Raises:
        InvalidInput: its folder does not exist or is not writable, or it is a folder itself.
    """
    if not path.parent.is_dir():
        raise InvalidInput(f"There is no folder {path.parent} to write {what} to.", "Create it first.")
    if path.is_dir():
        raise InvalidInput(f"{path} is a folder.", f"Name a file to write {what} to, in it or elsewhere.")
    if not os.access(path.parent, os.W_OK):
        raise InvalidInput(f"The folder {path.parent} cannot be written to.", "Choose another, or allow it.")
    return path


def is_bag_target(path: Path) -> bool:
    """Whether poses that are written to a path are a bag of ROS 2 (``.mcap``), not a table, after checking the path.

    Raises:
        InvalidInput: it cannot be written there, or is a bag of another kind.
    """
    check_target(path, "the poses")
    suffix = path.suffix.lower()
    if suffix in (".bag", ".db3"):
        raise InvalidInput(f"Bags are written as .mcap, not as {suffix}.", f"Name it {path.stem}.mcap.")
    return suffix == ".mcap"
