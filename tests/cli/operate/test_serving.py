"""The command's processes: a server that starts, answers and stops with whoever started it."""

import gc
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

from rholoc.cli.operate.serve import listening_socket, phone_link, worker
from rholoc.cli.server_process import running_server
from rholoc.errors import RholocError
from rholoc.service.access.keys import KeyStore, Scope


def has_ended(url: str) -> bool:
    try:
        httpx.get(f"{url}/healthz")
    except httpx.TransportError:
        return True
    return False


@pytest.mark.slow
def test_a_server_answers_until_its_user_fails(tmp_path: Path) -> None:
    def ask_in_vain(url: str) -> None:
        assert httpx.get(f"{url}/v1/maps").json()["maps"] == []
        raise RuntimeError("the user's")

    with (
        pytest.raises(RuntimeError, match="the user's"),
        running_server(tmp_path / "maps", tmp_path / "data", tmp_path / "log") as server,
    ):
        ask_in_vain(server.url)
    assert has_ended(server.url)
    assert "Traceback" not in server.log.read_text()


@pytest.mark.slow
def test_sigterm_stops_the_server_too(tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGTERM)
    with (
        pytest.raises(KeyboardInterrupt),
        running_server(tmp_path / "maps", tmp_path / "data", tmp_path / "log") as server,
    ):
        os.kill(os.getpid(), signal.SIGTERM)
    assert has_ended(server.url)
    assert signal.getsignal(signal.SIGTERM) is before


def test_the_garbage_collector_leaves_alone_what_was_imported(
    command: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To look through it takes a tenth of a second, in which nobody is answered."""
    frozen: list[int] = []
    monkeypatch.setattr("rholoc.logs.configure_process_logs", lambda: None)
    monkeypatch.setattr("uvicorn.Server.run", lambda *_, **__: frozen.append(gc.get_freeze_count()))
    before = sys.getswitchinterval()
    try:
        command("serve", "--port", 0, "--no-worker", "--maps", tmp_path / "maps", "--data", tmp_path / "data")
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)
    assert frozen[0] > 10_000


def test_a_server_that_cannot_start_is_reported_with_its_log(tmp_path: Path) -> None:
    (tmp_path / "maps").write_text("a file where a folder should be")
    with (
        pytest.raises(RholocError, match="log"),
        running_server(tmp_path / "maps", tmp_path / "data", tmp_path / "log"),
    ):
        pytest.fail("it started")


def fails_in_one_line(maps: Path, data: Path, port: str = "0") -> str:
    """The line in which ``rholoc serve`` says why it does not start."""
    command = [sys.executable, "-m", "rholoc", "serve", "--port", port, "--no-worker", "--maps", maps, "--data", data]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    return done.stderr


@pytest.mark.slow
def test_a_port_that_is_taken_and_folders_that_cannot_be_used_are_one_line(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = str(listener.getsockname()[1])
        assert f"127.0.0.1:{port}" in fails_in_one_line(tmp_path / "maps", tmp_path / "data", port)
    (tmp_path / "file").write_text("a file where a folder should be")
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "jobs.sqlite").write_text("no database")
    for maps, data, named in (("file", "data", "file"), ("maps", "file", "file"), ("maps", "damaged", "jobs.sqlite")):
        assert named in fails_in_one_line(tmp_path / maps, tmp_path / data)


@pytest.mark.slow
def test_after_its_first_line_a_server_writes_json(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "rholoc", "serve", "--port", "0"]
    process = subprocess.Popen(
        [*command, "--maps", tmp_path / "maps", "--data", tmp_path / "data"],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stderr is not None
    try:
        assert f"Serving the maps of {tmp_path / 'maps'}, a new folder, at http" in process.stderr.readline()
        begun = json.loads(process.stderr.readline())  # the worker beside it
        process.send_signal(signal.SIGTERM)
        _, rest = process.communicate(timeout=200)
    finally:
        process.kill()
    assert (begun["logger"], begun["level"]) == ("rholoc.worker", "info")
    assert all("event" in json.loads(line) for line in rest.splitlines())


@pytest.mark.slow
@pytest.mark.parametrize("times", [1, 2])
def test_ctrl_c_ends_serve_and_worker_in_order(tmp_path: Path, times: int) -> None:
    for command in (["serve", "--port", "0", "--no-worker"], ["worker"]):
        arguments = [*command, "--maps", str(tmp_path / "maps"), "--data", str(tmp_path / "data")]
        process = subprocess.Popen(
            [sys.executable, "-m", "rholoc", *arguments], stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        assert process.stderr is not None
        try:
            assert str(tmp_path) in process.stderr.readline()  # it says what it works on once it is up
            for _ in range(times):
                process.send_signal(signal.SIGINT)
                time.sleep(0.02)
            _, rest = process.communicate(timeout=200)
        finally:
            process.kill()
        assert process.returncode in (0, 130, -signal.SIGINT)
        assert "Traceback" not in rest


def test_an_interrupt_before_a_worker_listens_is_heard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Programs that a shell starts in the background begin with SIGINT ignored."""
    monkeypatch.setattr("rholoc.logs.configure_process_logs", lambda: None)
    monkeypatch.setattr("rholoc.worker.worker.run_worker", lambda *_: signal.raise_signal(signal.SIGINT))
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with pytest.raises(KeyboardInterrupt):
            worker(tmp_path / "maps", tmp_path / "data")
    finally:
        signal.signal(signal.SIGINT, before)


STUCK = """
import sys, time
from rholoc.cli.app import main
from rholoc.localization import Localizer

Localizer.localize = lambda self, query: (print("at work", flush=True), time.sleep(1000))
main()
"""


@pytest.mark.slow
def test_sigterm_ends_a_server_whose_threads_do_not_end(tmp_path: Path, picture_world: Any) -> None:
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "room.rho").write_bytes(picture_world.rho())
    command = [sys.executable, "-c", STUCK, "serve", "--port", "0", "--no-worker"]
    command += ["--maps", str(tmp_path / "maps"), "--data", str(tmp_path / "data")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        url = next(re.search(r"http://[0-9.:]+", line)[0] for line in process.stderr if "http://" in line)
        frame = f"{url}/v1/maps/room/localize?deadline_ms=60000"
        threading.Thread(target=_ask, args=(frame, picture_world.png()), daemon=True).start()
        assert "at work" in process.stdout.readline()
        process.terminate()
        process.communicate(timeout=120)
    finally:
        process.kill()
        process.communicate()


def _ask(url: str, png: bytes) -> None:
    with suppress(httpx.HTTPError):
        httpx.post(url, content=png, headers={"Content-Type": "image/png"}, timeout=120)


def test_an_answer_is_not_held_back_until_it_is_acknowledged() -> None:
    with listening_socket("127.0.0.1", 0) as listener:
        with socket.create_connection(listener.getsockname()):
            connection, _ = listener.accept()
        with connection:
            assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_a_phone_gets_a_key_of_its_own_that_expires(tmp_path: Path) -> None:
    keys = KeyStore(tmp_path)
    where, secret = phone_link("https://hall:8443", keys).rstrip("/").split("#/key/")
    key = keys.find(secret)
    assert (where, key.scope, key.expired) == ("https://hall:8443/record", Scope.MAP, False)
    assert key.expires == pytest.approx(time.time() + 7200, abs=60)
    assert phone_link("https://hall:8443", None) == "https://hall:8443/record"
