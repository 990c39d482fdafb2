"""Named cameras: intrinsics that requests and commands refer to by name, kept beside the maps."""

import json
from dataclasses import dataclass, field
from typing import Any

from rholoc.errors import InvalidCamera, InvalidInput, UnknownCamera
from rholoc.geometry import Camera, Lens
from rholoc.library.folder_documents import NamedDocuments
from rholoc.maps.name_rules import check_name
from rholoc.reports.json_values import check_json_value


@dataclass(frozen=True)
class CameraProfile:
    """A camera's intrinsics and their accuracy.

    ``calibration`` is JSON: ``rms_px``, ``views``, ``sigmas_px`` and more if a board calibrated it; else empty.
    """

    camera: Camera
    calibration: dict[str, Any] = field(default_factory=dict)


class CameraLibrary(NamedDocuments[CameraProfile]):
    """Camera profiles by name. Errors: UnknownCamera, InvalidCamera.

    The files have the members of a recording's ``camera.json``, and can be used as one.
    """

    _folder, _kind, _unknown = "cameras", "camera", UnknownCamera
    _none_yet = "There are none yet: rholoc camera add, or rholoc camera calibrate."

    def put(self, name: str, profile: CameraProfile) -> None:
        """Store a camera under a name, replacing any of that name.

        Raises:
            InvalidName, StorageFull, InvalidInput, SQLAlchemyError: nothing was replaced.
        """
        file_name = self._file_name(name)
        try:
            check_json_value(profile.calibration)
            values = {**profile.camera.to_dict(), "calibration": profile.calibration}
            text = json.dumps(values, indent=2, allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            raise InvalidInput(f"The camera's calibration cannot be stored: {error}.", "Send plain JSON.") from error
        self._files.write(file_name, f"{text}\n".encode(), called=file_name)

    def named_in(self, text: str | None) -> Camera | str | None:
        """The stored camera called ``text``. None, and text for :meth:`Camera.parse` (numbers, or a panorama), are
        returned unchanged.

        Raises:
            InvalidName, UnknownCamera: no camera is called this. InvalidCamera: its file is damaged.
        """
        return text if text is None or not names_a_camera(text) else self.get(text).camera

    def _parsed(self, name: str, content: bytes) -> CameraProfile:
        """The profile in a camera's file. Raises InvalidCamera if the file holds none."""
        try:
            values = json.loads(content.decode())
            calibration = dict(values.pop("calibration", {}))
            check_json_value(calibration)
            return CameraProfile(Camera.from_dict(values), calibration)
        except (ArithmeticError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise InvalidCamera(f"The file of the camera {name} is broken.", "Calibrate or add it again.") from error

    def _unreadable(self, name: str) -> InvalidInput:
        """Error for a camera's file that cannot be read."""
        return InvalidCamera(f"The camera {name} cannot be read.", "Calibrate or add it again.")


def names_a_camera(text: str) -> bool:
    """Whether a text names a stored camera; else it is for :meth:`Camera.parse`: numbers, or a panorama."""
    return "," not in text and text != Lens.EQUIRECTANGULAR


def check_camera_name(name: str) -> str:
    """Return the name of a camera, checked.

    Raises:
        InvalidName: it is not valid.
    """
    return check_name(name, "camera")
