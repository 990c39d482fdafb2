"""How errors leave the command: one line, the right status, never a traceback."""

import errno
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import pytest

from rholoc import __version__
from rholoc.cli.options import check_target
from rholoc.errors import InvalidInput, InvalidMap
from rholoc.maps import read_coefficient_table

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def rholoc(command: Run) -> Run:
    """Runs the command in this process: arguments → (exit status, standard output, standard error)."""
    return command


def fail_with(error: BaseException) -> Callable[..., NoReturn]:
    def fail(*_: object, **__: object) -> NoReturn:
        raise error

    return fail


def test_the_version_is_the_packages(rholoc: Run) -> None:
    assert rholoc("--version") == (0, f"rholoc {__version__}\n", "")


@pytest.mark.parametrize(
    "arguments",
    [
        ("map", "info", "nowhere.rho"),
        ("map", "build", "nowhere", "-o", "map.rho"),
        ("localize", "nowhere.rho", "nowhere"),
        ("evaluate", "nowhere.csv", "nowhere.txt"),
    ],
)
def test_a_missing_file_is_one_line_and_status_1(
    rholoc: Run, arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    status, out, err = rholoc(*arguments)
    assert (status, out) == (1, "")
    assert err.startswith("rholoc: ")
    assert err.count("\n") == 1
    assert "nowhere" in err
    assert list(tmp_path.iterdir()) == []


def test_a_foreign_file_is_no_map(rholoc: Run, tmp_path: Path) -> None:
    (tmp_path / "photo.rho").write_bytes(b"\xff\xd8\xff" * 100)
    status, _, err = rholoc("map", "info", tmp_path / "photo.rho")
    assert status == 1
    assert err.count("\n") == 1


@pytest.mark.parametrize("words", ["map build walk.mp4", "localize map.rho walk.mp4"])
def test_a_missing_output_folder_is_reported_before_the_work(rholoc: Run, words: str, tmp_path: Path) -> None:
    status, _, err = rholoc(*words.split(), "-o", tmp_path / "absent" / "out")
    assert status == 1
    assert "absent" in err


@pytest.mark.parametrize(
    "arguments",
    [
        ("fly",),
        ("map", "build"),
        ("map", "build", "a", "--density", "cubic"),
        ("map", "build", "a", "b", "--waypoints", "w.csv"),
        ("localize", "m.rho", "v.mp4", "--dof", "7"),
        ("serve", "--port", "70000"),
        ("simulate", "out", "--light", "candle"),
        ("evaluate", "a.csv", "b.csv", "--wrong"),
    ],
)
def test_wrong_usage_is_status_2(rholoc: Run, arguments: tuple[str, ...]) -> None:
    status, out, err = rholoc(*arguments)
    assert (status, out) == (2, "")
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("error", "status", "expected"),
    [
        (InvalidMap("The map is torn.", "Build it again."), 1, "rholoc: The map is torn. Build it again.\n"),
        (OSError(errno.ENOSPC, "No space left on device", "map.rho"), 1, "No space left on device: map.rho."),
        (PermissionError(errno.EACCES, "Permission denied", "map.rho"), 1, "Permission denied: map.rho."),
        (ZeroDivisionError("division by zero"), 1, "rholoc itself failed: ZeroDivisionError"),
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_no_error_is_a_traceback(
    rholoc: Run, monkeypatch: pytest.MonkeyPatch, error: BaseException, status: int, expected: str
) -> None:
    monkeypatch.delenv("RHOLOC_DEBUG", raising=False)
    monkeypatch.setattr("rholoc.maps.load_map", fail_with(error))
    got, out, err = rholoc("map", "info", "map.rho")
    assert (got, out) == (status, "")
    assert expected in err
    assert err.count("\n") <= 1


def test_a_markup_like_message_is_printed_as_it_is(rholoc: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rholoc.maps.load_map", fail_with(InvalidMap("No [bold]map[/bold] at [/x].")))
    assert rholoc("map", "info", "map.rho")[2] == "rholoc: No [bold]map[/bold] at [/x].\n"


def test_the_command_runs_as_a_module_and_says_what_it_can() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "rholoc", "--help"],
        capture_output=True,
        text=True,
        env=os.environ | {"COLUMNS": "200"},
        check=True,
    )
    for command in ("demo", "serve", "worker", "simulate", "map", "localize", "evaluate"):
        assert command in done.stdout
    assert done.stderr == ""


def test_help_does_not_load_what_it_does_not_need() -> None:
    heavy = ("pycolmap", "matplotlib", "fastapi", "sqlalchemy", "uvicorn", "faiss", "scipy", "cv2")
    code = f"import rholoc.cli, sys; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_file_that_cannot_be_written_is_refused_before_the_work(tmp_path, monkeypatch):
    assert check_target(tmp_path / "a.rho", "the map") == tmp_path / "a.rho"
    with pytest.raises(InvalidInput, match=r"There is no folder .*/nowhere to write the map to\. Create it first\."):
        check_target(tmp_path / "nowhere" / "a.rho", "the map")
    with pytest.raises(InvalidInput, match=r"is a folder\. Name a file to write the map to"):
        check_target(tmp_path, "the map")
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write everywhere
    with pytest.raises(InvalidInput, match="cannot be written to"):
        check_target(tmp_path / "a.rho", "the map")


def test_a_map_that_is_imported_as_a_table_needs_no_import(tmp_path):
    for name, hint in (("a.rho", "needs no import"), ("a.csv", "Export the map again")):
        (tmp_path / name).write_bytes(b"\xb0\x00\xff")
        with pytest.raises(InvalidMap, match=hint):
            read_coefficient_table(tmp_path / name)
