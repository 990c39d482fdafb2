"""``rholoc map update``, ``merge``, ``forget``, ``learn`` and ``queries``."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from kept_queries import keep_queries
from rholoc.library import MapLibrary
from rholoc.maps import load_map, save_map

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def maps(tmp_path: Path, point_room: Any) -> Path:
    """A folder with two maps that overlap."""
    walk = point_room.walk(80)
    save_map(point_room.map_of(walk[:45], "first"), tmp_path / "west.rho")
    save_map(point_room.map_of(walk[25:65], "second"), tmp_path / "east.rho")
    return tmp_path


def test_maps_are_merged_and_a_recording_is_forgotten(rholoc: Run, maps: Path) -> None:
    before = load_map(maps / "west.rho")
    status, out, err = rholoc("merge", maps / "west.rho", maps / "east.rho", "-o", maps / "both.rho", "--json")
    assert (status, err) == (0, "")
    figures = json.loads(out)
    assert [source["name"] for source in figures["sources"]] == ["first", "second"]
    assert figures["report"]["learned"][0]["features_in_both"] > 50
    status, out, err = rholoc("forget", maps / "both.rho", "second", "--json")
    assert (status, err, json.loads(out)["version"]) == (0, "", 3)
    np.testing.assert_allclose(
        load_map(maps / "both.rho").landmarks.positions, before.landmarks.positions, rtol=0, atol=1e-6
    )


def test_refusals_are_one_line_and_leave_the_map(rholoc: Run, maps: Path) -> None:
    walk = maps / "walk"
    walk.mkdir()
    for number in range(8):
        noise = np.random.default_rng(number).integers(0, 256, (480, 640), dtype=np.uint8)
        cv2.imwrite(str(walk / f"{number:04d}.png"), noise)
    content = (maps / "west.rho").read_bytes()
    for arguments, said in (
        (("forget", maps / "west.rho", "attic"), "It contains: first (first-id)"),
        (("update", maps / "west.rho", walk), "0 of 8 frames were found"),
        (("update", maps / "west.rho", maps / "nowhere.mp4"), "nowhere.mp4"),
        (("merge", maps / "west.rho", maps / "west.rho", "-o", maps / "new.rho"), "nothing to merge"),
    ):
        status, out, err = rholoc(*arguments)
        assert (status, out) == (1, ""), err
        assert said in err
        assert err.count("\n") == 1
    assert (maps / "west.rho").read_bytes() == content
    assert not (maps / "new.rho").exists()


@pytest.mark.slow
def test_a_map_learns_from_its_users_and_the_one_before_is_kept(rholoc: Run, maps: Path, point_room: Any) -> None:
    west, data = maps / "west.rho", maps / "data"
    kept = keep_queries(data, load_map(west), point_room, 1.8e9)
    assert kept >= 30
    status, out, err = rholoc("queries", west, "--data", data, "--json")
    assert (status, err, json.loads(out)["queries"]) == (0, "", kept)
    status, out, err = rholoc("learn", west, "--data", data, "--json")
    assert (status, err) == (0, "")
    figures = json.loads(out)
    assert figures["version"] == 2
    assert figures["report"]["learned"][0]["queries"]["kept"] == kept
    before = MapLibrary(maps).previous("west")
    assert before is not None
    assert before.version == 1
    status, out, _ = rholoc("queries", west, "--data", data, "--delete")
    assert (status, "deleted" in out) == (0, True)
    status, out, err = rholoc("learn", west, "--data", data)
    assert (status, out) == (1, "")
    assert "0 queries are kept for the map; it learns from 30 at least." in err
    assert load_map(west).info.version == 2
