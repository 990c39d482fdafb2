"""The map that is shipped, used as the README says."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

MAPS = Path(__file__).parents[3] / "maps"
MAP, QUERIES = MAPS / "testsite.rho", MAPS / "queries"

Run = Callable[..., str]


@pytest.fixture
def rholoc(command: Callable[..., tuple[int, str, str]]) -> Run:
    """Runs the command in this process; arguments → standard output. It must succeed."""

    def run(*arguments: object) -> str:
        status, printed, errors = command(*arguments)
        assert status == 0, errors
        return printed

    return run


def test_the_shipped_map_is_small_and_says_what_it_is(rholoc: Run) -> None:
    assert MAP.stat().st_size <= 500_000
    figures = json.loads(rholoc("map", "info", MAP, "--json"))
    assert figures["metric"]
    assert figures["upright"]
    assert figures["bytes"] == MAP.stat().st_size
    assert figures["report"]["held_out"]["frames"] > 0


def test_the_shipped_pictures_are_localized_to_centimetres(rholoc: Run, tmp_path: Path) -> None:
    found = tmp_path / "found.csv"
    summary = json.loads(rholoc("localize", MAP, QUERIES, "-o", found, "--json"))
    assert (summary["frames"], summary["localized"]) == (3, 3)
    ours = "frame,roll,qx,qy,qz,qw,confidence,inliers,map_trusted,expected_error_m"
    assert found.read_text().startswith(f"timestamp,x,y,z,hx,hy,hz,{ours}\n")
    figures = json.loads(rholoc("evaluate", found, QUERIES / "poses.txt", "--json"))
    assert figures["n"] == 3
    assert figures["recall_5cm_5deg"] == 1


def test_a_choice_of_frames_is_a_choice_of_pictures(rholoc: Run, tmp_path: Path) -> None:
    found = tmp_path / "found.csv"
    assert json.loads(rholoc("localize", MAP, QUERIES, "--frames", "2:3", "-o", found, "--json"))["frames"] == 1
    assert len(found.read_text().splitlines()) == 2


@pytest.mark.parametrize(("form", "start"), [("ply", b"ply\n"), ("vtp", b"<?xml"), ("png", b"\x89PNG")])
def test_the_shipped_map_can_be_exported(rholoc: Run, tmp_path: Path, form: str, start: bytes) -> None:
    rholoc("map", "export", MAP, "--to", form, "-o", tmp_path / f"map.{form}")
    assert (tmp_path / f"map.{form}").read_bytes().startswith(start)
