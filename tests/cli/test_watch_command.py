"""``rholoc watch``: who is localized in a service's map, read by a client of Foxglove's protocol."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress

import cv2
import httpx
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from foxglove_client import Foxglove
from rholoc.cli.app import app
from rholoc.cli.track import KEY_VARIABLE
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.settings import KeyPolicy

PATIENCE_S = 60.0


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


@pytest.fixture
def running(serve, picture_world):
    """A service that shows who asks, and its keys."""
    service = serve(live=True, keys=KeyPolicy.ALWAYS)
    store = KeyStore(service.settings.data_dir)
    (service.settings.maps_dir / "hall.rho").write_bytes(picture_world.rho())
    return service, store.create("robot-7", Scope.LOCALIZE), store.create("watcher", Scope.READ)


def test_robots_are_frames_of_their_names_in_the_map(running, picture_world):
    service, robot, watcher = running
    port = free_port()
    command = [sys.executable, "-m", "rholoc", "watch", "hall", "--url", service.url, "--view", f"127.0.0.1:{port}"]
    watching = subprocess.Popen(command, env=os.environ | {KEY_VARIABLE: watcher}, stderr=subprocess.PIPE, text=True)
    try:
        assert f"ws://127.0.0.1:{port}" in watching.stderr.readline()
        jpeg = cv2.imencode(".png", picture_world.image)[1].tobytes()
        headers = {"Authorization": f"Bearer {robot}", "Content-Type": "image/png"}
        answer = httpx.post(f"{service.url}/v1/maps/hall/localize", content=jpeg, headers=headers, timeout=60).json()
        assert answer["localized"]
        seen, deadline = {}, time.monotonic() + PATIENCE_S
        while not {"/tf", "/map/points"} <= seen.keys():
            assert time.monotonic() < deadline, f"only {sorted(seen)} came"
            httpx.post(f"{service.url}/v1/maps/hall/localize", content=jpeg, headers=headers, timeout=60)
            with Foxglove(port) as foxglove:
                seen |= dict(foxglove.messages(1.0))
        (transform,) = seen["/tf"].transforms
        assert (transform.header.frame_id, transform.child_frame_id) == ("map", "robot-7")
        p, q = transform.transform.translation, transform.transform.rotation
        np.testing.assert_allclose([p.x, p.y, p.z], answer["pose"]["position"], atol=1e-3)
        R = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        np.testing.assert_allclose(R, np.array(answer["pose"]["T_map_camera"])[:3, :3], atol=1e-3)
        assert seen["/map/points"].width == len(picture_world.map_)
        watching.send_signal(signal.SIGINT)
        assert watching.wait(PATIENCE_S) == 0
    finally:
        with suppress(ProcessLookupError):
            watching.kill()
        watching.wait()
        watching.stderr.close()


def test_what_the_service_refuses_is_a_line(running, monkeypatch):
    service, _, watcher = running
    monkeypatch.setenv(KEY_VARIABLE, watcher)
    missing = CliRunner().invoke(app, ["watch", "attic", "--url", service.url, "--view", "127.0.0.1:0"])
    assert "attic" in str(missing.exception)
    monkeypatch.setenv(KEY_VARIABLE, "wrong")
    stranger = CliRunner().invoke(app, ["watch", "hall", "--url", service.url, "--view", "127.0.0.1:0"])
    assert "key" in str(stranger.exception)
