"""``rholoc camera``, and commands that name a camera."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from rholoc.geometry import Camera
from rholoc.library import CameraLibrary

ROOT = Path(__file__).parents[2]


@pytest.fixture
def run(command, monkeypatch, tmp_path):
    """Runs a command; its exit status, standard output and error."""
    monkeypatch.setenv("RHOLOC_MAPS_DIR", str(tmp_path / "maps"))
    return command


def test_cameras_are_added_listed_shown_and_removed(run, tmp_path):
    assert run("camera", "add", "phone", "1510.2,1509.8,959.5,539.5,0.08,-0.17,0,0", "--size", "1920x1080")[0] == 0
    library = CameraLibrary(tmp_path / "maps")
    camera = Camera(1920, 1080, 1510.2, 1509.8, 959.5, 539.5, (0.08, -0.17, 0.0, 0.0))
    assert library.get("phone").camera == camera
    assert run("camera", "add", "copy", tmp_path / "maps" / "cameras" / "phone.json")[0] == 0
    assert run("camera", "add", "site", ROOT / "maps" / "testsite.rho")[0] == 0
    status, out, _ = run("camera", "list", "--json")
    assert status == 0
    assert list(json.loads(out)) == ["copy", "phone", "site"]
    assert json.loads(out)["copy"]["fx"] == 1510.2
    assert "1920x1080 1510.2,1509.8,959.5,539.5,0.08,-0.17,0,0" in run("camera", "list")[1]
    assert "1510.2" in run("camera", "show", "phone")[1]
    assert run("camera", "remove", "phone")[0] == 0
    status, _, error = run("camera", "show", "phone")
    assert status == 1
    assert error == "rholoc: There is no camera phone. There are: copy, site.\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("add", "x", "500,500,320,240"), "size of the camera's images is missing"),
        (("add", "x", "500,500,320,240", "--size", "big"), "size of the camera's images is missing"),
        (("add", "x", "500,500,3200,240", "--size", "640x480"), "outside the image"),
        (("add", "../x", "500,500,320,240", "--size", "640x480"), "not a valid camera name"),
        (("add", "x", "absent.json"), "absent.json"),
        (("remove", "x"), "There is no camera x"),
        (("calibrate", ".", "--board", "9", "--square-mm", "25"), "'9' is not the size of a board"),
        (("calibrate", ".", "--board", "9x6", "--square-mm", "25", "--name", "a/b"), "not a valid camera name"),
    ],
)
def test_bad_input_is_reported_in_one_line(run, words, said):
    status, out, error = run("camera", *words)
    assert (status, out) == (1, "")
    assert said in error
    assert error.count("\n") == 1


def test_a_calibrated_camera_can_be_named(run, tmp_path):
    """A board before an upright camera: half-size pictures of the camera are recognised from it."""
    camera = Camera(640, 480, 500.0, 500.0, 319.5, 239.5)
    folder = tmp_path / "pictures"
    folder.mkdir()
    for number, picture in enumerate(_board_pictures(camera)):
        cv2.imwrite(str(folder / f"{number}.png"), picture)
    chart = tmp_path / "chart.png"
    status, out, _ = run(
        *("camera", "calibrate", folder, "--board", "7x5", "--square-mm", "30"),
        *("--name", "phone", "--picture", chart, "--json"),
    )
    assert status == 0
    found = json.loads(out)
    assert found["fx"] == pytest.approx(500, abs=2)
    assert found["calibration"]["rms_px"] < 0.2
    assert found["calibration"]["sigmas"]["fx"] < 2
    assert cv2.imread(str(chart)) is not None
    assert "rms px" in run("camera", "show", "phone")[1]

    (tmp_path / "half").mkdir()
    cv2.imwrite(str(tmp_path / "half" / "1.png"), np.full((240, 320, 3), 128, np.uint8))
    map_file = ROOT / "maps" / "testsite.rho"
    words = ("localize", map_file, tmp_path / "half", "-o", tmp_path / "out.csv", "--json", "--camera")
    assert run(*words, "phone")[0] == 0
    assert "There is no camera nikon" in run(*words, "nikon")[2]


def _board_pictures(camera: Camera) -> list[np.ndarray]:
    """Ten views of a 7x5 checkerboard of 30 mm, by warping its print."""
    texel_m = 0.001
    squares = np.add.outer(np.arange(6), np.arange(8)) % 2
    texture = np.kron(squares, np.full((30, 30), 220)).astype(np.uint8) + 20
    texture = cv2.copyMakeBorder(texture, *[30] * 4, cv2.BORDER_CONSTANT, value=240)
    middle = np.array(texture.shape[::-1]) / 2
    pictures = []
    for k in range(10):
        turn = np.array([0.5 * np.cos(2.4 * k), 0.5 * np.sin(2.4 * k), 0.1 * k])
        shift = np.array([0.05 * np.cos(k), 0.03 * np.sin(3 * k), 0.38 + 0.02 * k])
        R = cv2.Rodrigues(turn)[0]
        T_camera_texture = np.column_stack([R[:, 0] * texel_m, R[:, 1] * texel_m, shift - R[:, :2] @ middle * texel_m])
        size = (camera.width, camera.height)
        picture = cv2.warpPerspective(
            texture, camera.matrix @ T_camera_texture, size, flags=cv2.INTER_AREA, borderValue=90
        )
        pictures.append(cv2.GaussianBlur(picture, (0, 0), 0.7))
    return pictures
