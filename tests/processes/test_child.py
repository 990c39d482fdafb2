"""A function in a child process; how much memory a container, or a service of systemd, leaves a process."""

import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pycolmap  # noqa: F401  # the child imports this module, and so installs pycolmap's handlers
import pytest

from rholoc.errors import Cancelled, InvalidRecording, MappingFailed
from rholoc.processes.child import ChildDied, ChildFailed, named, run_in_child
from rholoc.processes.limits import Limits, MemoryLimitExceeded, TimeLimitExceeded, _control_group_limits
from rholoc.progress import ProgressListener, Stage, silent
from waiting import alive, until


@pytest.fixture
def reconstruction() -> Any:
    """``rholoc.trajectory.child``, which children that import this module do without: it takes a second."""
    from rholoc.trajectory import child

    return child


def _add(a: int, b: int, progress: ProgressListener = silent) -> int:
    progress(Stage.POSES, 0.5, "half")
    return a + b


def _refuse(progress: ProgressListener = silent) -> None:
    raise InvalidRecording("no", "hint")


def _crash(progress: ProgressListener = silent) -> None:
    os.abort()


def _sleep(progress: ProgressListener = silent) -> None:
    progress(Stage.POSES, 0.1, str(os.getpid()))
    time.sleep(60)


def _fail(progress: ProgressListener = silent) -> None:
    raise ValueError("seven is not a camera\nat all")


def _sleep_beside_another(progress: ProgressListener = silent) -> None:
    other = subprocess.Popen(["sleep", "60"], start_new_session=True)
    progress(Stage.POSES, 0.1, f"{os.getpid()} {other.pid}")
    time.sleep(60)


def _listen(progress: ProgressListener = silent) -> None:
    """Goes on until its listener raises Cancelled, and leaves a file then."""
    folder = Path(os.environ["RHOLOC_TEST_FOLDER"])
    try:
        while True:
            progress(Stage.POSES, 0.5)
            time.sleep(0.01)
    finally:
        (folder / "stopped").touch()


_PARENT = """
import sys
from rholoc.processes.child import run_in_child
from test_child import _sleep_beside_another

def show(stage, fraction, message=""):
    sys.stdout.write(message + "\\n")
    sys.stdout.flush()

run_in_child(_sleep_beside_another, progress=show)
"""


class _Raise:
    """A listener that hears of one thing, keeps it and raises."""

    def __init__(self, error: Exception) -> None:
        self.error = error
        self.heard = ""

    def __call__(self, stage: Stage, fraction: float, message: str = "") -> None:
        if message:
            self.heard = message
            raise self.error


def test_a_child_returns_its_result_and_its_progress() -> None:
    heard: list[tuple[Stage, float, str]] = []
    assert run_in_child(_add, 2, 3, progress=lambda s, f, m="": heard.append((s, f, m))) == 5
    assert heard == [(Stage.POSES, 0.5, "half")]


def test_a_childs_error_arrives() -> None:
    with pytest.raises(InvalidRecording, match="no hint"):
        run_in_child(_refuse, progress=silent)


def test_an_error_that_is_none_of_ours_arrives_as_its_first_line() -> None:
    with pytest.raises(ChildFailed) as raised:
        run_in_child(_fail, progress=silent)
    assert str(raised.value) == "ValueError: seven is not a camera"
    assert "in _fail" in raised.value.__notes__[0], "where"


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (RuntimeError(), "RuntimeError"),
        (RuntimeError("\n\nIndeterminant linear system\nnear d0"), "RuntimeError: Indeterminant linear system"),
        (KeyError("room"), "KeyError: 'room'"),
    ],
)
def test_an_error_is_named_by_its_type_and_the_first_line_that_says_anything(error: Exception, line: str) -> None:
    assert named(error) == line


@pytest.mark.slow
def test_a_child_that_crashes_has_died() -> None:
    with pytest.raises(ChildDied, match=f"signal {int(signal.SIGABRT)}"):
        run_in_child(_crash, progress=silent)


def _terminate_itself(progress: ProgressListener = silent) -> None:
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(60)


def test_a_child_ends_at_sigterm() -> None:
    """Also one that has imported pycolmap, whose own handler of the signal may wait for itself for ever."""
    with pytest.raises(ChildDied, match=f"signal {int(signal.SIGTERM)}"):
        run_in_child(_terminate_itself, progress=silent)


@pytest.mark.parametrize("own_group", [False, True])
def test_a_child_is_killed_with_all_that_it_started(own_group: bool) -> None:
    stop = _Raise(ValueError("stop"))
    with pytest.raises(ValueError, match="stop"):
        run_in_child(_sleep_beside_another, progress=stop, own_group=own_group)
    for pid in map(int, stop.heard.split()):
        until(lambda pid=pid: not alive(pid))


@pytest.mark.slow
def test_a_cancelled_child_may_stop_by_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RHOLOC_TEST_FOLDER", str(tmp_path))

    def cancel(stage: Stage, fraction: float, message: str = "") -> None:
        raise Cancelled("stop")

    with pytest.raises(Cancelled):
        run_in_child(_listen, progress=cancel, grace_s=60.0)
    assert (tmp_path / "stopped").exists()


@pytest.mark.parametrize(
    ("limits", "error"),
    [(Limits(time_s=0.0), TimeLimitExceeded), (Limits(memory_bytes=2**20), MemoryLimitExceeded)],
)
def test_a_child_beyond_its_limits_is_ended(limits: Limits, error: type[Exception]) -> None:
    with pytest.raises(error):
        run_in_child(_sleep, progress=silent, limits=limits, own_group=True)


@pytest.mark.slow
def test_a_child_ends_with_its_parent() -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    parent = subprocess.Popen([sys.executable, "-c", _PARENT], stdout=subprocess.PIPE, text=True, env=environment)
    assert parent.stdout is not None
    with parent:
        pids = [int(pid) for pid in parent.stdout.readline().split()]
        assert len(pids) == 2
        parent.kill()
        for pid in pids:
            until(lambda pid=pid: not alive(pid))


def test_a_reconstruction_reports_until_it_is_done(reconstruction: Any) -> None:
    heard: list[float] = []
    progress = lambda stage, fraction, message="": heard.append(fraction)  # noqa: E731
    assert reconstruction.run_in_child(_add, 2, 3, progress=progress, stage=Stage.POSES) == 5
    assert (heard[0], heard[-1]) == (0.0, 0.5)


def _killed(progress: ProgressListener = silent) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_reconstruction_that_was_killed_is_told_from_one_that_crashed(reconstruction: Any) -> None:
    with pytest.raises(reconstruction.ReconstructionKilled, match="signal 9"):
        reconstruction.run_in_child(_killed, progress=silent, stage=Stage.POSES)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("function", "message"), [(_crash, "process died"), (_fail, "ValueError: seven is not a camera")]
)
def test_a_reconstruction_that_dies_or_fails_is_a_failed_mapping(
    reconstruction: Any, function: Callable[..., None], message: str
) -> None:
    with pytest.raises(MappingFailed, match=message):
        reconstruction.run_in_child(function, progress=silent, stage=Stage.POSES)


def _unreadable() -> None:
    raise SystemExit(3)


class _DiesWhenRead:
    """An argument that ends the process that unpickles it, after more bytes than a pipe holds."""

    def __reduce__(self) -> tuple[object, ...]:
        return _die, (b"0" * 2**20,)


def _die(_: bytes) -> None:
    os._exit(3)


def test_a_child_that_dies_while_it_starts_is_noticed() -> None:
    with pytest.raises(ChildDied):
        run_in_child(_unreadable, _DiesWhenRead(), progress=silent)


@pytest.mark.parametrize(
    ("own", "files", "expected"),
    [
        ("0::/\n", {"memory.max": "1000\n"}, 1000.0),
        ("0::/\n", {"memory.max": "max\n"}, math.inf),
        ("0::/system.slice/rholoc.service\n", {"system.slice/rholoc.service/memory.max": "2000\n"}, 2000.0),
        (
            "0::/system.slice/rholoc.service\n",
            {"system.slice/rholoc.service/memory.max": "2000\n", "system.slice/memory.max": "1500\n"},
            1500.0,
        ),
        ("0::/docker/123\n", {"memory.max": "3000\n"}, 3000.0),  # as a container sees it
        ("4:memory:/docker/123\n2:cpu:/\n", {"memory/docker/123/memory.limit_in_bytes": "4000\n"}, 4000.0),
        ("", {}, math.inf),
    ],
)
def test_the_tightest_control_group_counts(own: str, files: dict[str, str], expected: float, tmp_path: Path) -> None:
    groups = tmp_path / "groups"
    groups.mkdir()
    (tmp_path / "memory.max").write_text("1\n")  # not of a control group
    for name, content in files.items():
        (groups / name).parent.mkdir(parents=True, exist_ok=True)
        (groups / name).write_text(content)
    (tmp_path / "own").write_text(own)
    assert min(_control_group_limits(tmp_path / "own", groups)) == expected
    assert _control_group_limits(tmp_path / "none", groups) == [math.inf]
