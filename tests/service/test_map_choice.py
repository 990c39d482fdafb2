"""Of many maps, those are asked that a frame is most like; localizers live as long as their maps are in memory."""

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import httpx
import pytest

from rholoc.errors import InvalidMap
from rholoc.library.map_cache import memory_bytes
from rholoc.library.maps import MapLibrary
from rholoc.maps import map_to_bytes, save_map
from rholoc.service.frames import single_frame
from rholoc.service.frames.localizers import Localizers
from rholoc.service.frames.map_choice import MAX_ASKED, Candidates, each_map
from rholoc.service.http.stopwatch import Stopwatch

PNG = {"content-type": "image/png"}
PATIENCE_S = 60.0


@pytest.fixture(scope="module")
def campus(serve, picture_world, looking):
    """A service with twenty maps of rooms, one of which the picture was taken in."""
    running = serve()
    for number in range(20):
        map_ = picture_world.map_ if number == 13 else looking(number)
        (running.settings.maps_dir / f"room{number:02}.rho").write_bytes(map_to_bytes(map_))
    finder, until = running.app.state.rholoc.frames.finder, time.monotonic() + PATIENCE_S
    while finder.counts() != {"present": 20, "indexed": 20}:
        assert time.monotonic() < until
        time.sleep(0.05)
    return running


def test_the_right_one_of_many_maps_answers(campus, picture_world, monkeypatch) -> None:
    asked: list[str] = []
    localizers = campus.app.state.rholoc.frames.localizers
    get = type(localizers).get
    monkeypatch.setattr(type(localizers), "get", lambda self, name: (asked.append(name), get(self, name))[1])
    answer = httpx.post(
        f"{campus.url}/v1/localize?maps=all&dof=6", content=picture_world.png(), headers=PNG, timeout=PATIENCE_S
    ).json()
    assert answer["localized"]
    assert answer["map"] == "room13"
    assert asked[0] == "room13"
    assert len(asked) <= MAX_ASKED
    assert answer["timings_ms"]["choose"] > 0


def test_places_of_many_maps_are_those_of_the_likeliest(campus, picture_world) -> None:
    found = httpx.post(
        f"{campus.url}/v1/places?maps=all&limit=4", content=picture_world.png(), headers=PNG, timeout=PATIENCE_S
    ).json()
    assert found["places"][0]["map"] == "room13"


def test_more_maps_than_are_asked_may_be_named(campus, picture_world) -> None:
    names = ",".join(f"room{number:02}" for number in range(8, 18))
    answer = httpx.post(
        f"{campus.url}/v1/localize?maps={names}&dof=6", content=picture_world.png(), headers=PNG, timeout=PATIENCE_S
    ).json()
    assert answer["map"] == "room13"
    others = names.replace("room13", "room00")
    answer = httpx.post(
        f"{campus.url}/v1/localize?maps={others}&dof=6", content=picture_world.png(), headers=PNG, timeout=PATIENCE_S
    ).json()
    assert not answer["localized"]
    assert answer["map"] in others


def test_maps_are_counted_with_how_many_are_indexed(campus) -> None:
    text = httpx.get(f"{campus.url}/metrics").text
    assert 'rholoc_maps{state="present"} 20' in text
    assert 'rholoc_maps{state="indexed"} 20' in text


@pytest.mark.parametrize(
    ("scores", "asked", "confidence", "settled"),
    [
        ((0.6, 0.3, 0.2), 1, 0.95, True),
        ((0.6, 0.55, 0.2), 1, 0.95, False),  # a rival, which looks about the same
        ((0.6, 0.55, 0.2), 2, 0.95, True),
        ((0.6, 0.3, 0.2), 1, 0.7, False),
        ((), 1, 0.99, False),  # nobody knows how likely the others are
    ],
)
def test_a_sure_answer_ends_the_search_unless_another_map_is_about_as_likely(
    scores: tuple[float, ...], asked: int, confidence: float, settled: bool
) -> None:
    maps = Candidates(("a", "b", "c"), passing_over=True, scores=scores)
    assert maps.is_settled(asked, 0, confidence) is settled


def test_maps_that_could_not_be_ranked_leave_those_not_asked() -> None:
    """Of maps whose index changed between two rankings."""
    asked = Candidates(("a",), passing_over=True, scores=(1.0,))
    assert Candidates(("a", "b"), passing_over=True).besides(asked) == Candidates(("b",), passing_over=True)


def test_an_answer_outlives_further_maps_that_cannot_be_used(picture_world, monkeypatch) -> None:
    """The first maps gave a pose that was not conclusive, all further ones were damaged: the request failed."""
    found: Any = SimpleNamespace(localized=True, recognized=0.85)

    def surest(asked: Candidates) -> tuple[str, None, Any]:
        if asked.names == ("damaged",):
            raise InvalidMap("The map is damaged.")
        return "good", None, found

    further = Candidates(("good", "damaged"), passing_over=True, scores=(1.0, 0.9))
    monkeypatch.setattr(single_frame, "choose_candidates", lambda *_: further)
    first = Candidates(("good",), passing_over=True, scores=(1.0,))
    nothing: Any = None
    frame: Any = SimpleNamespace(by=nothing)
    assert single_frame._looking_twice(first, nothing, frame, cast(Any, surest), Stopwatch())[2] is found


def test_a_map_that_leaves_memory_takes_its_localizer_along(tmp_path: Path, picture_world) -> None:
    for name in ("first", "second"):
        save_map(picture_world.map_, tmp_path / f"{name}.rho")
    library = MapLibrary(tmp_path, cache_bytes=1.5 * memory_bytes(picture_world.map_))
    localizers = Localizers(library, 0.5)
    first = localizers.get("first")
    assert localizers.get("first") is first
    localizers.get("second")
    again = localizers.get("first")
    assert again is not first
    assert again.map is not first.map


def test_loading_a_map_is_timed_apart() -> None:
    class Cold:
        def get(self, name: str) -> str:
            time.sleep(0.02)
            return name

    asked: list[str] = []
    clock = Stopwatch()
    each_map(
        Candidates(("a", "b"), passing_over=False), cast(Localizers, Cold()), lambda name, _: asked.append(name), clock
    )
    assert asked == ["a", "b"]
    assert clock.stages_ms["load"] >= 40
