"""Named cameras: intrinsics that requests and commands refer to by name, kept beside the maps."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rholoc.errors import InvalidCamera, InvalidInput, UnknownCamera
from rholoc.geometry import Camera, Lens
from rholoc.maps.catalogue import check_name, some_of
from rholoc.maps.documents import Documents, FolderDocuments, stored_names
from rholoc.maps.json_values import check_json_value

FOLDER = "cameras"
_SUFFIX = ".json"


@dataclass(frozen=True)
class CameraProfile:
    """A camera's intrinsics and their accuracy.

    ``calibration`` is JSON: ``rms_px``, ``views``, ``sigmas_px`` and more if a board calibrated it; else empty.
    """

    camera: Camera
    calibration: dict[str, Any] = field(default_factory=dict)


class CameraLibrary:
    """Camera profiles by name; safe to share between threads and processes.

    The files have the members of a recording's ``camera.json``, and can be used as one.

    Args:
        maps_dir: the folder of maps, with cameras as ``cameras/NAME.json``.
        files: used instead of ``maps_dir``.
    """

    def __init__(self, maps_dir: Path, files: Documents | None = None) -> None:
        self._files = files or FolderDocuments(maps_dir / FOLDER)

    def names(self) -> list[str]:
        """The names of all cameras, sorted."""
        return stored_names(self._files, _SUFFIX)

    def get(self, name: str) -> CameraProfile:
        """The camera of that name.

        Raises:
            InvalidName: it is not a valid name.
            UnknownCamera: there is no such camera.
            InvalidCamera: its file is damaged.
        """
        try:
            text = self._files.read(_file_name(name)).decode()
        except FileNotFoundError as error:
            raise self._unknown(name) from error
        except (OSError, UnicodeDecodeError) as error:
            raise InvalidCamera(f"The camera {name} cannot be read.", "Calibrate or add it again.") from error
        return _from_json(name, text)

    def put(self, name: str, profile: CameraProfile) -> None:
        """Store a camera under a name, replacing any of that name.

        Raises:
            InvalidName, StorageFull, InvalidInput: nothing was replaced.
        """
        file_name = _file_name(name)
        try:
            check_json_value(profile.calibration)
            values = {**profile.camera.to_dict(), "calibration": profile.calibration}
            text = json.dumps(values, indent=2, allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            raise InvalidInput(f"The camera's calibration cannot be stored: {error}.", "Send plain JSON.") from error
        self._files.write(file_name, f"{text}\n".encode(), called=file_name)

    def delete(self, name: str) -> None:
        """Delete a camera.

        Raises:
            InvalidName: it is not a valid name.
            UnknownCamera: there is no such camera.
        """
        try:
            self._files.delete(_file_name(name))
        except FileNotFoundError as error:
            raise self._unknown(name) from error

    def named_in(self, text: str | None) -> Camera | str | None:
        """The stored camera called ``text``; text for :meth:`Camera.parse` is returned unchanged.

        Raises:
            InvalidName, UnknownCamera, InvalidCamera: as :meth:`get` does.
        """
        if text is None or "," in text or text == Lens.EQUIRECTANGULAR:
            return text
        return self.get(text).camera

    def _unknown(self, name: str) -> UnknownCamera:
        names = self.names()
        hint = (
            f"There are: {some_of(names)}."
            if names
            else "There are none yet: rholoc camera add, or rholoc camera calibrate."
        )
        return UnknownCamera(f"There is no camera {name}.", hint)


def check_camera_name(name: str) -> str:
    """Return the name of a camera, checked.

    Raises:
        InvalidName: it is not valid.
    """
    return check_name(name, "camera")


def _file_name(name: str) -> str:
    return check_camera_name(name) + _SUFFIX


def _from_json(name: str, text: str) -> CameraProfile:
    try:
        values = json.loads(text)
        calibration = dict(values.pop("calibration", {}))
        check_json_value(calibration)
        return CameraProfile(Camera.from_dict(values), calibration)
    except (ArithmeticError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InvalidCamera(f"The file of the camera {name} is broken.", "Calibrate or add it again.") from error
