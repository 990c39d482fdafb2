"""What is drawn of maps: once a version, kept, and by a process of its own."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor

import cv2
import httpx
import numpy as np
import pytest

from rholoc.errors import InvalidMap, UnknownMap
from rholoc.library import MapLibrary
from rholoc.pictures.rendering import Rendering
from rholoc.service.maps.renderings import Renderings
from rholoc.service.threads.storage import StorageLanes


@pytest.fixture
def library(tmp_path, picture_world) -> MapLibrary:
    library = MapLibrary(tmp_path / "maps")
    library.put("room", picture_world.map_)
    return library


def test_a_rendering_is_made_once_and_again_when_the_map_changes_and_not_of_one_that_is_gone_or_damaged(
    tmp_path, library, picture_world
):
    async def scenario() -> None:
        renderings = Renderings(tmp_path / "kept", library, StorageLanes())
        first, same = await asyncio.gather(*(renderings.get("room", Rendering.COVERAGE) for _ in range(2)))
        assert first == same
        (kept,) = (tmp_path / "kept").iterdir()
        made = kept.stat().st_mtime_ns
        assert await renderings.get("room", Rendering.COVERAGE) == first
        assert kept.stat().st_mtime_ns == made
        library.put_file("room", picture_world.rho(version=4))
        assert (await renderings.get("room", Rendering.COVERAGE)).etag != first.etag
        renderings.sweep()
        assert kept not in (tmp_path / "kept").iterdir()
        assert len(list((tmp_path / "kept").iterdir())) == 1
        with pytest.raises(UnknownMap):
            await renderings.get("nowhere", Rendering.PREVIEW)
        library.path("room").write_bytes(b"damaged")
        with pytest.raises(InvalidMap, match=r"room\.rho"):
            await renderings.get("room", Rendering.PREVIEW)
        await renderings.close()

    asyncio.run(scenario())


@pytest.mark.slow
def test_a_process_that_is_killed_is_started_again(tmp_path, library):
    async def scenario() -> None:
        renderings = Renderings(tmp_path / "kept", library, StorageLanes())
        await renderings.get("room", Rendering.COVERAGE)
        assert renderings._program is not None
        renderings._program._process.kill()
        assert cv2.imdecode(np.frombuffer((await renderings.get("room", Rendering.PREVIEW)).content, np.uint8), 1).any()
        await renderings.close()

    asyncio.run(scenario())


def test_a_browser_that_has_a_picture_gets_304(service):
    for what in ("preview.png", "report.png", "coverage", "scene", "scene?landmarks=50"):
        url = f"{service.url}/v1/maps/room/{what}"
        first = httpx.get(url, timeout=60)
        assert first.headers["Cache-Control"] == "private, no-cache"
        if what.endswith("png"):
            assert first.headers["Content-Type"] == "image/png"
            picture = cv2.imdecode(np.frombuffer(first.content, np.uint8), cv2.IMREAD_COLOR)
            assert min(picture.shape[:2]) > 500
            assert picture.std() > 5
        again = httpx.get(url, headers={"If-None-Match": f'"other", {first.headers["ETag"]}'})
        assert (again.status_code, again.content) == (304, b"")
    whole, part = (httpx.get(f"{service.url}/v1/maps/room/scene{query}") for query in ("", "?landmarks=50"))
    assert int.from_bytes(part.content[:4], "little") == 50
    assert part.headers["ETag"] != whole.headers["ETag"]


@pytest.mark.slow
def test_pictures_take_no_place_among_the_frames_that_are_localized(serve, picture_world):
    """With one thread for frames and no queue, any picture that took it would have frames refused."""
    running = serve(concurrency=1, queue_length=0)
    for number in range(4):
        (running.settings.maps_dir / f"room{number}.rho").write_bytes(picture_world.rho(version=number + 1))
    localize = f"{running.url}/v1/maps/room0/localize"
    headers = {"Content-Type": "image/png"}
    with ThreadPoolExecutor(4) as pool:
        pictures = [pool.submit(httpx.get, f"{running.url}/v1/maps/room{n}/preview.png", timeout=120) for n in range(4)]
        answers = []
        while not all(picture.done() for picture in pictures):
            answers.append(httpx.post(localize, content=picture_world.png(), headers=headers, timeout=60).status_code)
    assert answers
    assert set(answers) == {200}
    assert {picture.result().status_code for picture in pictures} == {200}
