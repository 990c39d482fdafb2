"""The client for Unity, compiled and run by Mono: handedness, the session beside JavaScript's, and a real service."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc_client import Client

ROOT = Path(__file__).parents[2] / "client"
POINTS = np.random.default_rng(1).normal(size=(5, 3))
HERE = Path(__file__).parent

pytestmark = pytest.mark.skipif(shutil.which("mcs") is None, reason="Mono is not installed")


@pytest.fixture(scope="module")
def unity(tmp_path_factory):
    """Runs a part of the program with what is given to it; the lines that it prints."""
    folder = tmp_path_factory.mktemp("unity")
    source = ROOT / "unity" / "Rholoc.cs"
    built = ["mcs", "-warnaserror", f"-out:{folder}/runner.exe", str(source), str(HERE / "unity_runner.cs")]
    subprocess.run(built, check=True, capture_output=True)

    def run(part, given):
        (folder / "given.json").write_text(json.dumps(given))
        command = ["mono", str(folder / "runner.exe"), part, str(folder / "given.json")]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr
        return [json.loads(line) for line in done.stdout.splitlines()]

    return run


def matrix(position, rotation):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), position
    return T


def test_points_stay_where_they_are_in_unity(unity):
    """A point that a camera sees is at the same place in the map and in Unity, by SciPy's rotations."""
    rng = np.random.default_rng(0)
    rotations, positions = Rotation.random(30, rng=rng), rng.normal(size=(30, 3))
    pairs = [
        {
            "T_map_camera": matrix(x, R).ravel().tolist(),
            "position": x.tolist(),
            "rotation": R.as_quat().tolist(),
        }
        for x, R in zip(positions, rotations, strict=True)
    ]
    seen_by_unity = POINTS * [1, -1, 1]  # y is up
    for (position, rotation, session), x, R in zip(unity("poses", {"pairs": pairs}), positions, rotations, strict=True):
        in_map = R.apply(POINTS) + x
        in_unity = Rotation.from_quat(rotation).apply(seen_by_unity) + position
        np.testing.assert_allclose(in_unity, in_map[:, [0, 2, 1]], atol=1e-9)
        T_session_camera = np.reshape(session, (4, 4))
        in_session = POINTS @ T_session_camera[:3, :3].T + T_session_camera[:3, 3]
        np.testing.assert_allclose(in_session * [1, 1, -1], R.apply(seen_by_unity) + x, atol=1e-9)


def test_a_session_is_where_the_javascript_client_has_it(unity, tmp_path):
    """Recorded pairs of a walk: noise, a doubtful beginning, wrong answers, and a pause in which the place is lost."""
    rng = np.random.default_rng(2)
    T_map_session = matrix([3, -2, 1], Rotation.from_rotvec([0.1, -1.2, 0.4]))
    handed = np.diag([1.0, 1, -1, 1])
    frames = []
    for number in range(120):
        time_s = 0.4 * number + (30 if number > 90 else 0)
        turn = Rotation.from_rotvec([0, 0.05 * number, 0.1])
        T_session_camera = matrix([np.sin(number / 9), 0.2, np.cos(number / 9)], turn)
        off = matrix(0.01 * rng.normal(size=3), Rotation.from_rotvec(0.005 * rng.normal(size=3)))
        T_map_camera = T_map_session @ T_session_camera @ off
        if 40 < number < 46 or 60 < number < 80:
            T_map_camera[0, 3] += 4
        unity_pose = handed @ T_session_camera @ np.diag([1.0, -1, -1, 1]) @ handed
        frames.append(
            {
                "time_s": time_s,
                "localized": number % 7 != 0,
                "recognized": 0.65 if number < 5 else 0.95,
                "T_map_camera": T_map_camera.ravel().tolist(),
                "session_pose": unity_pose.ravel().tolist(),
                "position": unity_pose[:3, 3].tolist(),
                "rotation": Rotation.from_matrix(unity_pose[:3, :3]).as_quat().tolist(),
            }
        )
    found = unity("session", {"frames": frames})
    (tmp_path / "frames.json").write_text(json.dumps({"axes": "unity", "frames": frames}))
    module = (ROOT / "js" / "index.js").as_uri()
    command = ["node", str(HERE / "session_replay.mjs"), module, str(tmp_path / "frames.json")]
    said = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout.splitlines()
    assert found[-1] == json.loads(said[-1])
    assert "lost" in found[-1]
    placed = 0
    for (T, point), line in zip(found[:-1], said[:-1], strict=True):
        expected_T, expected_point = json.loads(line)
        assert (T is None) == (expected_T is None)
        if T is not None:
            placed += 1
            np.testing.assert_allclose(T, expected_T, atol=1e-9)
            np.testing.assert_allclose(point, expected_point, atol=1e-9)
    assert placed > 100


def test_a_service_is_asked(unity, service, picture_world, tmp_path):
    (tmp_path / "frame.png").write_bytes(picture_world.png())
    camera = picture_world.map_.info.camera
    given = {
        "url": service.url,
        "picture": str(tmp_path / "frame.png"),
        "fx": camera.fx,
        "cx": camera.cx,
        "cy": camera.cy,
    }
    T, (sigma_m, sigma_rad, recognized, localized), missing, unreachable = unity("service", given)
    with Client(service.url) as client:
        known = client.localize("room", tmp_path / "frame.png")
    np.testing.assert_allclose(T, np.ravel(known.pose.T_map_camera), atol=1e-4)
    sigmas = np.sqrt(np.diag(known.covariance))
    assert (sigma_m, localized) == (pytest.approx(sigmas[:3].max(), rel=0.05), 1)
    assert np.degrees(sigma_rad) == pytest.approx(sigmas[3:].max(), rel=0.05)
    assert recognized == pytest.approx(known.recognized, abs=0.02)
    assert (missing, unreachable) == ("unknown_map 404", "unreachable")
