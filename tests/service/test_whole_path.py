"""The whole path, nothing mocked: a recording is uploaded, a worker maps it, a frame gets its pose."""

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest

from rholoc.errors import InvalidInput
from rholoc.jobs import JobQueue
from rholoc.library.recordings import RecordingStore
from rholoc.simulation import (
    PHONE_CAMERA,
    Light,
    make_blank_wall,
    make_walk,
    render_view,
    simulate_recording,
)
from rholoc.storage.database import database_engine, open_database
from rholoc_client import Client, JobFailed

MAP_SECONDS = np.arange(0.0, 3.5, 0.14)
QUERY_SECONDS = (1.07, 3.03)


@pytest.fixture(scope="module")
def running(serve):
    """A service with a worker."""
    return serve(worker=True)


@pytest.fixture(scope="module")
def recording(site, tmp_path_factory) -> Path:
    """Twenty-five rendered frames with their true poses, as a folder."""
    folder = tmp_path_factory.mktemp("walk")
    (folder / "frames").mkdir()
    rows = []
    for number, pose in enumerate(make_walk(1).poses(MAP_SECONDS)):
        image = render_view(site, PHONE_CAMERA, pose, Light.ARTIFICIAL, seed=number)
        cv2.imwrite(str(folder / "frames" / f"frame-{number:04d}.jpg"), image)
        rows.append([number, *pose.position, *pose.quaternion_xyzw])
    np.savetxt(folder / "poses.txt", rows)
    camera = PHONE_CAMERA
    intrinsics = {"width": camera.width, "height": camera.height, "fx": camera.fx, "fy": camera.fy}
    (folder / "camera.json").write_text(json.dumps({**intrinsics, "cx": camera.cx, "cy": camera.cy, "distortion": []}))
    return folder


@pytest.mark.slow
def test_a_recording_becomes_a_map_and_a_frame_becomes_a_pose(running, site, recording):
    seen: list[str] = []
    with Client(running.url, timeout_s=60) as client:
        job = client.upload_recording(recording, "site", poses="given")
        ended = client.wait_for_job(job.id, timeout_s=200, poll_s=0.1, progress=lambda now: seen.append(str(now.stage)))
        assert str(ended.state) == "published"
        assert len(set(seen)) >= 3
        assert "site" in [one.name for one in client.maps()]
        for number, pose in enumerate(make_walk(1).poses(np.array(QUERY_SECONDS))):
            image = render_view(site, PHONE_CAMERA, pose, Light.ARTIFICIAL, seed=900 + number)
            answer = client.localize("site", cv2.imencode(".jpg", image)[1].tobytes(), dof=6)
            assert answer.localized
            assert np.linalg.norm(np.array(answer.pose.position) - pose.position) < 0.05


@pytest.mark.slow
def test_a_blank_wall_and_no_video_fail_their_jobs_and_say_what_to_do(running, tmp_path):
    simulate_recording(tmp_path / "wall", scene=make_blank_wall(), seconds=2.0, fps=10.0)
    (tmp_path / "walk.mp4").write_bytes(b"\0\0\0\x18ftypmp42" + b"no frames" * 100)
    with Client(running.url, timeout_s=60) as client:
        for recording, code in (("wall", "mapping_failed"), ("walk.mp4", "invalid_recording")):
            job = client.upload_recording(tmp_path / recording, "wall")
            with pytest.raises(JobFailed) as failed:
                client.wait_for_job(job.id, timeout_s=120, poll_s=0.1)
            assert failed.value.code == code
            assert failed.value.message
            assert failed.value.hint
            ended = client.job(job.id)
            assert (ended.state, ended.error_code) == ("failed", code)
        assert "wall" not in [one.name for one in client.maps()]
    assert httpx.get(running.url + "/readyz").json()["checks"]["worker"] == "ok"


@pytest.mark.slow
def test_jobs_are_kept_in_postgres_and_worked_on(postgres_url, serve, tmp_path):
    running = serve(worker=True, database_url=postgres_url)
    (tmp_path / "walk.mp4").write_bytes(b"\0\0\0\x18ftypmp42" + b"no frames" * 100)
    with Client(running.url) as client:
        job = client.upload_recording(tmp_path / "walk.mp4", "hall")
        with pytest.raises(JobFailed) as caught:
            client.wait_for_job(job.id, timeout_s=120, poll_s=0.1)
        assert caught.value.code == "invalid_recording"
    assert not (running.settings.data_dir / "jobs.sqlite").exists()
    queue = JobQueue(RecordingStore(tmp_path, engine=database_engine(tmp_path, postgres_url)))
    assert [one.id for one in queue.list()] == [job.id]
    assert queue.has_worker()
    queue.close()


def test_a_database_that_is_not_there_is_reported_in_one_line(tmp_path):
    with pytest.raises(InvalidInput) as caught:
        open_database(tmp_path, f"postgresql://jobs:secret@/jobs?host={tmp_path}")
    assert "cannot be reached" in caught.value.message
    assert "\n" not in caught.value.message
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize("url", ["jobs:secret", "mysql://jobs:secret@localhost/jobs", "://"])
def test_what_is_no_address_of_a_database_is_refused(tmp_path, url):
    with pytest.raises(InvalidInput, match="not the URL of a Postgres database") as caught:
        database_engine(tmp_path, url)
    assert "secret" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("command", [["serve", "--port", "0", "--no-worker"], ["worker"]])
def test_the_commands_refuse_a_database_in_one_line(tmp_path, command):
    environment = {**os.environ, "RHOLOC_DATABASE_URL": "postgresql://jobs:secret@127.0.0.1:1/jobs"}
    arguments = [sys.executable, "-m", "rholoc", *command, "--data", str(tmp_path), "--maps", str(tmp_path)]
    ended = subprocess.run(arguments, env=environment, capture_output=True, text=True, timeout=200, check=False)
    assert ended.returncode == 1
    (line,) = [line for line in ended.stderr.splitlines() if not line.startswith("Working on")]
    assert "127.0.0.1, database jobs cannot be reached" in line
    assert "secret" not in line
