"""Named cameras beside the maps."""

from __future__ import annotations

from pathlib import Path

import pytest

from rholoc.errors import InvalidCamera, InvalidInput, InvalidName, UnknownCamera
from rholoc.geometry import Camera
from rholoc.library import CameraLibrary, CameraProfile, MapLibrary
from rholoc.recordings import read_camera_json

_CAMERA = Camera(1920, 1080, 1510.2, 1509.8, 959.5, 539.5, (0.08, -0.17, 0.0, 0.0, 0.09))


@pytest.fixture
def cameras(tmp_path: Path) -> CameraLibrary:
    return CameraLibrary(tmp_path / "maps")


def test_a_camera_comes_back_as_it_was_put(cameras: CameraLibrary) -> None:
    assert cameras.names() == []
    profile = CameraProfile(_CAMERA, {"rms_px": 0.21, "sigmas_px": {"fx": 0.8}})
    cameras.put("pixel-7", profile)
    cameras.put("axis.door", CameraProfile(Camera(640, 480, 500, 500, 320, 240)))
    assert cameras.names() == ["axis.door", "pixel-7"]
    assert cameras.get("pixel-7") == profile
    cameras.put("pixel-7", CameraProfile(_CAMERA))
    assert cameras.get("pixel-7").calibration == {}
    cameras.delete("pixel-7")
    assert cameras.names() == ["axis.door"]


def test_the_files_serve_as_a_recordings_camera_json(cameras: CameraLibrary, tmp_path: Path) -> None:
    cameras.put("pixel-7", CameraProfile(_CAMERA, {"rms_px": 0.21}))
    assert read_camera_json(tmp_path / "maps" / "cameras" / "pixel-7.json").camera == _CAMERA


def test_cameras_are_not_maps(cameras: CameraLibrary, tmp_path: Path) -> None:
    cameras.put("pixel-7", CameraProfile(_CAMERA))
    assert MapLibrary(tmp_path / "maps").names() == []


@pytest.mark.parametrize("name", ["", "..", "a/b", "../maps/x", "-x", ".x", "x" * 65, "a\n", "é"])
def test_what_is_no_name_is_refused(cameras: CameraLibrary, name: str) -> None:
    for act in (cameras.get, cameras.delete, lambda name: cameras.put(name, CameraProfile(_CAMERA))):
        with pytest.raises(InvalidName, match="is not a valid camera name"):
            act(name)


def test_an_unknown_camera_is_reported_with_those_there_are(cameras: CameraLibrary) -> None:
    with pytest.raises(UnknownCamera, match=r"no camera pixel-7.*none yet"):
        cameras.get("pixel-7")
    cameras.put("axis", CameraProfile(_CAMERA))
    for act in (cameras.get, cameras.delete, cameras.named_in):
        with pytest.raises(UnknownCamera, match="There are: axis"):
            act("pixel-7")


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"width": 640}', "\x00", '{"width": "a"}', "[" * 100_000])
def test_a_broken_file_is_reported(cameras: CameraLibrary, text: str, tmp_path: Path) -> None:
    cameras.put("axis", CameraProfile(_CAMERA))
    (tmp_path / "maps" / "cameras" / "axis.json").write_text(text)
    with pytest.raises(InvalidCamera, match="axis is broken"):
        cameras.get("axis")


def test_intrinsics_and_names_are_told_apart(cameras: CameraLibrary) -> None:
    cameras.put("axis", CameraProfile(_CAMERA))
    assert cameras.named_in("axis") == _CAMERA
    assert cameras.named_in("500,500,320,240") == "500,500,320,240"
    assert cameras.named_in(None) is None


@pytest.mark.parametrize("value", [float("nan"), {1, 2}])
def test_a_calibration_that_is_not_json_is_refused(cameras: CameraLibrary, value: object) -> None:
    with pytest.raises(InvalidInput, match="plain JSON"):
        cameras.put("axis", CameraProfile(_CAMERA, {"rms_px": value}))
    assert cameras.names() == []


def test_a_camera_that_cannot_be_stored_replaces_nothing(cameras: CameraLibrary, tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "cameras").write_text("a file stands where the folder would")
    with pytest.raises(InvalidInput, match="cannot be created"):
        cameras.put("axis", CameraProfile(_CAMERA))
