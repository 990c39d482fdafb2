"""The service with its own worker: an invalid recording fails with what was wrong; the worker goes on."""

from __future__ import annotations

import httpx
import pytest

from rholoc_client import Client, JobFailed


@pytest.mark.slow
def test_a_video_that_does_not_open_fails_its_job(serve, tmp_path):
    running = serve(worker=True)
    (tmp_path / "walk.mp4").write_bytes(b"\0\0\0\x18ftypmp42" + b"no frames" * 100)
    with Client(running.url) as client:
        job = client.upload_recording(tmp_path / "walk.mp4", "hall")
        with pytest.raises(JobFailed) as caught:
            client.wait_for_job(job.id, timeout_s=120, poll_s=0.1)
        assert caught.value.code == "invalid_recording"
        assert caught.value.message
        assert client.maps() == []
        ended = client.job(job.id)
    assert (ended.state, ended.error_code) == ("failed", "invalid_recording")
    assert httpx.get(running.url + "/readyz").json()["checks"]["worker"] == "ok"
