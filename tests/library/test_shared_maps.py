"""Maps that several processes share: what one does the others see, whole."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fake_pipeline import tiny_map
from rholoc.disk import storage_full
from rholoc.errors import Conflict, InvalidMap, RholocError, StorageFull, StorageUnavailable, UnknownMap
from rholoc.library.maps import MapLibrary
from rholoc.library.stores import Stores
from rholoc.maps import Map, load_map, map_to_bytes
from waiting import until

NAMES = st.sampled_from(["hall", "room", "yard"])
STEPS = st.one_of(
    st.tuples(st.just("put"), NAMES),
    st.tuples(st.just("put_file"), NAMES),
    st.tuples(st.just("learn"), NAMES),
    st.tuples(st.just("learn twice"), NAMES),
    st.tuples(st.just("restore"), NAMES, st.integers(1, 6)),
    st.tuples(st.just("rename"), NAMES, NAMES),
    st.tuples(st.just("delete"), NAMES),
)


def do(library: MapLibrary, step: tuple[Any, ...], number: int) -> str | None:
    """Take a step; returns the error's text, or None. Maps are told apart by their ids, which count the steps."""
    map_ = replace(tiny_map(), info=replace(tiny_map().info, id=f"{number:032x}"))
    kind, name = step[:2]
    try:
        match kind:
            case "put":
                library.put(name, map_)
            case "put_file":
                library.put_file(name, map_to_bytes(map_))
            case "learn" | "learn twice":
                now = library.get(name)
                version = now.info.version + (1 if kind == "learn" else 2)
                library.replace(name, replace(now, info=replace(now.info, version=version)))
            case "restore" | "rename":
                getattr(library, kind)(*step[1:])
            case _:
                library.delete(name)
    except RholocError as error:
        return str(error)
    return None


def state(library: MapLibrary) -> dict[str, Any]:
    """All that a library says of its maps."""
    infos = {name: library.get(name).info for name in library.names()}
    return {
        name: (
            (info.id, info.version),
            {number: (kept.id, kept.version) for number, kept in library.versions(name).items()},
            library.stat(name).size_bytes == library.path(name).stat().st_size,
        )
        for name, info in infos.items()
    }


@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(steps=st.lists(STEPS, max_size=12))
def test_a_shared_library_does_what_a_folder_does(steps: list[Any], tmp_path_factory: Any) -> None:
    folder = tmp_path_factory.mktemp("world")
    shared = Stores(folder / "none", folder / "data", storage_url=f"file://{folder}/storage")
    shared.open()
    other = Stores(folder / "none", folder / "data", storage_url=f"file://{folder}/storage")
    other.open()
    local = MapLibrary(folder / "maps")
    for number, step in enumerate(steps):
        assert do(shared.library, step, number) == do(local, step, number)
    other.refresh()
    assert state(shared.library) == state(local) == state(other.library)
    shared.close()
    other.close()


def test_what_one_publishes_another_sees_without_asking_the_database_for_each_request(open_storage: Any) -> None:
    one, other = open_storage(), open_storage()
    one.library.put("hall", tiny_map())
    assert other.library.get("hall").info == one.library.get("hall").info, "an unknown name is looked up"
    one.library.put("hall", tiny_map())
    assert other.library.get("hall").info != one.library.get("hall").info
    other.refresh()
    assert other.library.get("hall").info == one.library.get("hall").info


def test_the_outline_of_a_map_whose_file_is_gone_is_that_of_the_new_one(open_storage: Any, storage_url: str) -> None:
    one, other = open_storage(), open_storage()
    one.library.put("hall", tiny_map())
    assert other.library.stat("hall").signature == one.library.stat("hall").signature
    replaced = [path for path in (Path(storage_url.removeprefix("file://")) / "maps").rglob("*") if path.is_file()]
    one.library.put("hall", tiny_map())
    for path in replaced:
        path.unlink(missing_ok=True)
    assert other.library.outline("hall").info == one.library.outline("hall").info


def test_a_follower_has_the_new_file_before_it_sees_the_change(open_storage: Any, storage_url: str) -> None:
    one, follower = open_storage(), open_storage(follow=True)
    one.library.put("hall", tiny_map())
    before = follower.library.get("hall").info.id
    stored = Path(storage_url.removeprefix("file://")) / "maps"
    hidden = stored.with_name("hidden")
    after = replace(tiny_map(), info=replace(tiny_map().info, id="f" * 32))
    one.library.put("hall", after)
    stored.rename(hidden)  # the storage is gone before the follower hears of it, or after it has fetched the file
    assert follower.library.get("hall").info.id in (before, after.info.id), "the old version, or the new one whole"
    hidden.rename(stored)
    until(lambda: follower.library.get("hall").info.id == after.info.id)


def test_of_two_that_learn_from_the_same_version_one_is_refused(open_storage: Any) -> None:
    one, other = open_storage(), open_storage()
    one.library.put("hall", tiny_map())
    start = one.library.get("hall")
    following = [replace(start, info=replace(start.info, version=start.info.version + 1, created=day)) for day in "ab"]
    outcomes: list[Exception | None] = []
    barrier = threading.Barrier(2)

    def learn(library: MapLibrary, map_: Map) -> None:
        library.get("hall")
        barrier.wait()
        try:
            library.replace("hall", map_)
            outcomes.append(None)
        except Conflict as error:
            outcomes.append(error)

    writers = ((one.library, following[0]), (other.library, following[1]))
    threads = [threading.Thread(target=learn, args=writer) for writer in writers]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(type(outcome).__name__ for outcome in outcomes) == ["Conflict", "NoneType"]
    one.refresh()
    assert one.library.get("hall").info.version == start.info.version + 1
    assert len(one.library.versions("hall")) == 1


def test_what_goes_with_publishing_is_done_with_it_or_neither(open_storage: Any) -> None:
    shared = open_storage()

    def refuse(*_: object) -> None:
        raise Conflict("The job was cancelled.")

    with pytest.raises(Conflict, match="cancelled"):
        shared.library_acting(refuse).put("hall", tiny_map())
    assert shared.library.names() == []
    noted: list[Map] = []
    shared.library_acting(lambda _, map_: noted.append(map_)).put("hall", tiny_map())
    assert [map_.info for map_ in noted] == [shared.library.get("hall").info]


def test_what_is_no_map_replaces_nothing_and_stores_nothing(open_storage: Any, storage_url: str) -> None:
    shared = open_storage()
    with pytest.raises(InvalidMap):
        shared.library.put_file("hall", b"not a map")
    assert shared.library.names() == []
    assert list(Path(storage_url.removeprefix("file://")).rglob("*.rho")) == []


def test_a_copy_of_the_wrong_size_is_refused_and_not_kept(open_storage: Any, storage_url: str) -> None:
    one, other = open_storage(), open_storage()
    one.library.put("hall", tiny_map())
    (stored,) = Path(storage_url.removeprefix("file://")).rglob("*.rho")
    whole = stored.read_bytes()
    stored.write_bytes(whole[:-10])
    with pytest.raises(StorageUnavailable, match="bytes"):
        other.library.get("hall")
    stored.write_bytes(whole)
    assert other.library.get("hall").info == one.library.get("hall").info


def test_copies_leave_for_others_and_are_fetched_again(open_storage: Any) -> None:
    size = len(map_to_bytes(tiny_map()))
    shared = open_storage(copies_bytes=2.5 * size, cache_bytes=0)
    for name in ("a", "b", "c"):
        shared.library.put(name, tiny_map())
    assert len(list(shared.library.folder.glob("*.rho"))) == 2
    assert [load_map(shared.library.path(name)).info.version for name in ("a", "b", "c")] == [1, 1, 1]


def test_copies_leave_a_full_disk_to_a_map_that_is_asked(open_storage: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    size, shared = len(map_to_bytes(tiny_map())), open_storage(cache_bytes=0)
    names = ["a", "b", "c"]
    for name in names:
        shared.library.put(name, tiny_map())
    fetch, folder = shared.objects.fetch, shared.library.folder

    def onto_a_small_disk(key: str, target: Path) -> int:
        if sum(path.stat().st_size for path in folder.iterdir()) + size > 3.5 * size:
            raise storage_full()
        return int(fetch(key, target))

    monkeypatch.setattr(shared.objects, "fetch", onto_a_small_disk)
    other = open_storage(cache_bytes=0)
    other.library.put("d", tiny_map())
    shared.refresh()
    assert [load_map(shared.library.path(name)).info.version for name in [*names, "d", *names]] == [1] * 7
    (folder / "ballast").write_bytes(bytes(4 * size))
    for path in folder.glob("*.rho"):
        path.unlink()
    with pytest.raises(StorageFull):
        shared.library.path("a")


def test_copies_leave_before_the_disk_is_full(open_storage: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Or nothing else could be written there for ever, such as the next map."""
    size, shared = len(map_to_bytes(tiny_map())), open_storage(cache_bytes=0)
    folder = shared.library.folder

    def usage(_: Path) -> SimpleNamespace:
        used = sum(path.stat().st_size for path in folder.iterdir())
        return SimpleNamespace(total=10 * size, free=10 * size - used)

    monkeypatch.setattr("rholoc.storage.object_cache.shutil.disk_usage", usage)
    for number in range(12):
        shared.library.put(f"map-{number}", tiny_map())
    assert usage(folder).free >= size
    assert len(list(folder.glob("*.rho"))) > 5
    (folder / "ballast").write_bytes(bytes(usage(folder).free))
    put = shared.objects.put

    def put_from_a_file_that_fits(key: str, source: Path) -> None:
        assert usage(folder).free >= 0, "what else filled the disk makes copies leave"
        put(key, source)

    monkeypatch.setattr(shared.objects, "put", put_from_a_file_that_fits)
    shared.library.put("another", tiny_map())


def test_files_that_no_map_needs_leave_the_storage(
    open_storage: Any, storage_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    shared = open_storage()
    for _ in range(8):
        shared.library.put("hall", tiny_map())
    stored = Path(storage_url.removeprefix("file://")) / "maps"
    assert len(list(stored.iterdir())) == 8
    shared.library.sweep()
    assert len(list(stored.iterdir())) == 8, "what is young may be on its way into the catalogue"
    monkeypatch.setattr("rholoc.library.shared_maps._ORPHANED_AFTER_S", -10)
    shared.library.sweep()
    assert len(list(stored.iterdir())) == 6, "the map and five versions"
    assert len(shared.library.versions("hall")) == 5
    shared.library.delete("hall")
    shared.library.sweep()
    assert not stored.exists()


def test_maps_that_are_known_are_answered_while_the_database_is_gone(
    open_storage: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    shared = open_storage(cache_bytes=0)
    shared.library.put("hall", tiny_map())
    monkeypatch.setattr(shared.engine, "connect", _no_database)
    assert shared.library.names() == ["hall"]
    assert shared.library.get("hall").info.version == 1
    with pytest.raises(UnknownMap, match="There are: hall"):
        shared.library.get("room")


def _no_database(*_: object) -> Callable[..., Any]:
    from sqlalchemy.exc import OperationalError

    raise OperationalError("SELECT", {}, Exception("the server closed the connection"))
