"""``rholoc site``: stored, linked and placed beside the maps, as the service sees them."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from rholoc.library import SiteLibrary
from rholoc.maps import save_map

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def maps(tmp_path: Path, point_room, picture_world) -> Path:
    """Two maps that overlap, and a room elsewhere."""
    folder = tmp_path / "maps"
    folder.mkdir()
    walk = point_room.walk(80)
    for name, poses in (("west", walk[:45]), ("east", walk[25:65])):
        save_map(point_room.map_of(poses, name), folder / f"{name}.rho")
    save_map(picture_world.map_, folder / "room.rho")
    return folder


@pytest.fixture
def site(command: Run) -> Run:
    return partial(command, "site")


def test_a_site_is_put_placed_shown_and_deleted(site: Run, maps: Path, tmp_path: Path) -> None:
    document = {"maps": [{"map": "west", "floor": "1"}, {"map": "east"}, {"map": "room"}]}
    (tmp_path / "campus.json").write_text(json.dumps(document))
    assert site("put", "campus", tmp_path / "campus.json", "--maps", maps)[0] == 0
    status, _, said = site("place", "campus", "--maps", maps)
    assert status == 0
    assert "west and east: found" in said
    assert "Nothing joins room to the others" in said
    status, shown, _ = site("show", "campus", "--maps", maps)
    assert "west, floor 1: at 0.00, 0.00, 0.00 m" in shown
    assert "room: not placed" in shown
    assert "west – east: overlap" in shown
    as_json = json.loads(site("show", "campus", "--maps", maps, "--json")[1])
    assert as_json["maps"][1]["pose"]["position"] == pytest.approx([0, 0, 0], abs=0.03)
    assert "campus: 3 maps, 2 of them placed" in site("list", "--maps", maps)[1]
    (maps / "room.rho").unlink()
    assert "there is no such map any more" in site("show", "campus", "--maps", maps)[1]
    assert site("delete", "campus", "--maps", maps)[0] == 0
    assert json.loads(site("list", "--maps", maps, "--json")[1]) == []


def test_two_maps_are_linked(site: Run, maps: Path, tmp_path: Path) -> None:
    (tmp_path / "campus.json").write_text('{"maps": [{"map": "west"}, {"map": "east"}]}')
    site("put", "campus", tmp_path / "campus.json", "--maps", maps)
    assert site("link", "campus", "west", "east", "--maps", maps)[0] == 0
    assert SiteLibrary(maps).site_of("east") == "campus"


def test_placing_is_left_to_the_workers(site: Run, command: Run, maps: Path, tmp_path: Path) -> None:
    (tmp_path / "campus.json").write_text('{"maps": [{"map": "west"}, {"map": "east"}]}')
    site("put", "campus", tmp_path / "campus.json", "--maps", maps)
    where = ("--maps", maps, "--data", tmp_path / "data", "--queue")
    status, said, _ = site("place", "campus", *where, "--json")
    assert status == 0
    (job,) = json.loads(command("job", "list", "--data", tmp_path / "data", "--json")[1])
    assert (job["id"], job["kind"], job["site"]) == (json.loads(said)["id"], "place", "campus")
    assert "site campus" in command("job", "list", "--data", tmp_path / "data")[1]
    assert site("place", "campus", *where)[0] == 1
    assert site("place", "nowhere", *where)[0] == 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "is no site"),
        ('{"maps": [{"floor": "1"}]}', "maps.0.map"),
        ('{"maps": [{"map": "nowhere"}]}', "There is no map nowhere"),
        ('{"maps": [{"map": "west"}, {"map": "west"}]}', "listed twice"),
    ],
)
def test_what_can_be_no_site_is_refused_in_a_line(site: Run, maps: Path, tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "campus.json").write_text(text)
    status, _, said = site("put", "campus", tmp_path / "campus.json", "--maps", maps)
    assert status == 1
    assert says in said
    assert said.count("\n") == 1
    assert SiteLibrary(maps).names() == []
