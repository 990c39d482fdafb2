"""The index of a library's views follows the library, and outlives the process."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rholoc.errors import InvalidDescriptors
from rholoc.features import Extractor, FeatureSet, get_extractor
from rholoc.library.maps import MapLibrary
from rholoc.localization import VECTORS_FILE, MapFinder
from rholoc.localization.index import map_finder as module
from rholoc.mapping.build.stored_observations import keep_view_rows
from rholoc.maps import Map, map_to_bytes


def publish(library: MapLibrary, name: str, map_: Map) -> None:
    library.put_file(name, map_to_bytes(map_))


def seen(map_: Map) -> Callable[[Extractor], FeatureSet]:
    """The features of a picture of a room."""

    def by(extractor: Extractor) -> FeatureSet:
        if extractor != get_extractor("gray"):
            raise InvalidDescriptors("Other features.")
        some = map_.descriptors.values[::2]
        blank = np.zeros(len(some), np.float32)
        return FeatureSet(np.zeros((len(some), 2), np.float32), blank.astype(np.uint8), some, blank, blank)

    return by


def best(finder: MapFinder, map_: Map) -> str:
    return finder.likeliest(seen(map_), 3)[0].name


@pytest.fixture
def library(tmp_path: Path, looking) -> MapLibrary:
    library = MapLibrary(tmp_path / "maps")
    for number in range(6):
        publish(library, f"room{number}", looking(number))
    return library


def finder_of(library: MapLibrary) -> MapFinder:
    finder = MapFinder(library, library.folder / VECTORS_FILE)
    finder.refresh()
    assert finder.trouble == ""
    return finder


def test_what_is_published_replaced_renamed_and_deleted_is_followed(library, looking) -> None:
    finder = finder_of(library)
    assert finder.counts() == {"present": 6, "indexed": 6}
    assert [best(finder, looking(number)) for number in range(6)] == [f"room{number}" for number in range(6)]
    publish(library, "room1", looking(10))
    publish(library, "new", looking(11))
    library.rename("room2", "other")
    library.delete("room3")
    finder.refresh()
    assert finder.present == {"room0", "room1", "other", "room4", "room5", "new"}
    assert [best(finder, looking(number)) for number in (10, 11, 2)] == ["room1", "new", "other"]
    assert best(finder, looking(3)) != "room3"
    library.restore("room1")
    finder.refresh()
    assert best(finder, looking(1)) == "room1"


def test_few_maps_are_indexed_once_there_are_more(library, looking) -> None:
    finder = MapFinder(library, library.folder / VECTORS_FILE, min_maps=7)
    finder.refresh()
    assert (finder.counts(), finder.trouble) == ({"present": 6, "indexed": 0}, "")
    publish(library, "room6", looking(6))
    finder.refresh()
    assert finder.counts() == {"present": 7, "indexed": 7}
    assert best(finder, looking(6)) == "room6"
    library.delete("room0")
    publish(library, "room1", looking(10))
    finder.refresh()
    assert finder.counts()["present"] == 6
    publish(library, "room0", looking(0))
    finder.refresh()
    assert best(finder, looking(10)) == "room1"


def test_a_map_replaced_by_one_without_views_is_found_no_more(library, looking) -> None:
    finder = finder_of(library)
    known = looking(1)
    blank = keep_view_rows(known, np.zeros(len(known.views), bool))
    publish(library, "room1", replace(blank, info=replace(blank.info, features="lab")))
    finder.refresh()
    assert "room1" not in [one.name for one in finder.likeliest(seen(known), 6)]


def test_a_start_reads_vectors_and_no_maps(library, looking, monkeypatch) -> None:
    finder_of(library).close()
    monkeypatch.setattr(module, "load_map", lambda path: pytest.fail(f"{path} was read"))
    again = finder_of(library)
    assert best(again, looking(4)) == "room4"


def test_another_process_is_followed_without_reading_its_maps(library, looking, monkeypatch) -> None:
    here, there = finder_of(library), finder_of(library)
    publish(library, "new", looking(11))
    there.refresh()
    monkeypatch.setattr(module, "load_map", lambda path: pytest.fail(f"{path} was read"))
    here.refresh()
    assert best(here, looking(11)) == "new"


@pytest.mark.parametrize("spoiled", ["torn", "foreign", "another version"])
def test_a_file_that_is_spoiled_is_made_anew(library, looking, spoiled: str) -> None:
    finder_of(library).close()
    file = library.folder / VECTORS_FILE
    if spoiled == "torn":
        os.truncate(file, file.stat().st_size // 2)
    elif spoiled == "foreign":
        file.write_bytes(b"no database" * 1000)
    else:
        import sqlite3

        with sqlite3.connect(file) as database:
            database.execute("PRAGMA user_version = 99")
    finder = MapFinder(library, file)
    finder.refresh()
    assert [best(finder, looking(number)) for number in range(6)] == [f"room{number}" for number in range(6)]
    finder.close()
    again = finder_of(library)
    assert best(again, looking(2)) == "room2"


def test_where_vectors_cannot_be_kept_maps_are_found_all_the_same(library, looking) -> None:
    (library.folder / "taken").write_text("a file where the folder should be")
    finder = MapFinder(library, library.folder / "taken" / "views.sqlite")
    finder.refresh()
    assert finder.trouble
    assert best(finder, looking(4)) == "room4"


def test_files_that_are_no_maps_are_passed_over(library, looking) -> None:
    (library.folder / "broken.rho").write_bytes(b"no map")
    finder = finder_of(library)
    assert finder.unknown == []
    assert best(finder, looking(4)) == "room4"


@pytest.mark.slow
def test_what_was_learned_from_few_maps_is_learned_again_from_more(library, looking) -> None:
    finder = finder_of(library)
    before = finder._models["gray"]
    for number in range(6, 20):
        publish(library, f"room{number}", looking(number))
    finder.refresh()
    after = finder._models["gray"]
    assert after.maps > before.maps
    assert after.id != before.id
    assert [best(finder, looking(number)) for number in range(20)] == [f"room{number}" for number in range(20)]
    finder.close()
    assert best(finder_of(library), looking(13)) == "room13"


@pytest.mark.slow
def test_many_maps_of_one_kind_of_features_are_not_read_for_another(library, looking, monkeypatch) -> None:
    def colourful(number: int) -> Map:
        return replace(looking(number), info=replace(looking(number).info, features="rgb"))

    for number in range(20):
        publish(library, f"colour{number}", colourful(number))
    finder = finder_of(library)
    assert finder.counts() == {"present": 26, "indexed": 26}
    publish(library, "new", colourful(30))
    read: list[str] = []
    load = module.load_map
    monkeypatch.setattr(module, "load_map", lambda path: (read.append(path.stem), load(path))[1])
    finder.refresh()
    assert read == ["new"]


def test_features_of_another_kind_speak_for_none_of_these_maps(library) -> None:
    def none(extractor: Extractor) -> FeatureSet:
        raise InvalidDescriptors("Other features.")

    assert finder_of(library).likeliest(none, 3) == []


def test_a_refresh_ends_when_it_is_stopped(library) -> None:
    finder = MapFinder(library, library.folder / VECTORS_FILE)
    finder.refresh(lambda: True)
    assert finder.counts() == {"present": 6, "indexed": 0}
    finder.refresh()
    assert finder.counts()["indexed"] == 6
