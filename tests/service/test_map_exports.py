"""Maps over HTTP in other formats, and back from CSV."""

import asyncio
from concurrent.futures import ThreadPoolExecutor
from xml.etree import ElementTree

import cv2
import httpx
import numpy as np
import pytest

from rholoc.errors import InvalidMap, UnknownMap
from rholoc.library.maps import MapLibrary
from rholoc.maps import map_to_ply, map_to_vtp, read_trajectory_csv
from rholoc.pictures.rendering import Rendering
from rholoc.service.maps.renderings import Renderings
from rholoc.service.threads.storage import StorageLanes


@pytest.fixture(scope="module")
def hall(serve, point_room):
    """A service with the map ``hall``, which remembers its observations; the map's URL, and the map."""
    from rholoc.maps import save_map

    running, map_ = serve(), point_room.map_of(point_room.walk(60)[:8], "walk")
    save_map(map_, running.settings.maps_dir / "hall.rho")
    return running.url + "/v1/maps/hall", map_


@pytest.mark.parametrize(
    ("wanted", "name", "kind"),
    [
        ("rho", "hall.rho", "application/octet-stream"),
        ("csv", "hall.csv", "text/csv"),
        ("observations", "hall-observations.csv", "text/csv"),
        ("trajectory", "hall-trajectory.csv", "text/csv"),
        ("ply", "hall.ply", "application/octet-stream"),
        ("vtp", "hall.vtp", "application/xml"),
        ("gltf", "hall.glb", "model/gltf-binary"),
        ("surfaces&features=0:9", "hall-surfaces.vtp", "application/xml"),
        pytest.param("surfaces", "hall-surfaces.vtp", "application/xml", marks=pytest.mark.slow),  # by a process
        ("colmap", "hall-colmap.zip", "application/zip"),
        ("nerfstudio", "hall-transforms.json", "application/json"),
        pytest.param("png", "hall.png", "image/png", marks=pytest.mark.slow),
    ],
)
def test_every_format_is_served(hall, wanted, name, kind):
    answer = httpx.get(f"{hall[0]}/download?format={wanted}", timeout=120)
    assert answer.status_code == 200
    assert answer.headers["Content-Type"].split(";")[0] == kind
    assert f'filename="{name}"' in answer.headers["Content-Disposition"]


def test_the_files_hold_the_map(hall, tmp_path):
    url, map_ = hall
    files = {
        form: httpx.get(f"{url}/download", params={"format": form}, timeout=30).content
        for form in ("ply", "vtp", "observations", "trajectory")
    }
    assert files["ply"] == map_to_ply(map_)
    assert files["vtp"] == map_to_vtp(map_)
    assert files["observations"].count(b"\n") == 1 + len(map_.observations.features)
    (tmp_path / "trajectory.csv").write_bytes(files["trajectory"])
    positions = read_trajectory_csv(tmp_path / "trajectory.csv").positions
    np.testing.assert_allclose(positions, map_.views.positions, atol=1e-5)
    surfaces = httpx.get(f"{url}/download", params={"format": "surfaces", "features": "3,5:7"}, timeout=60).content
    triangles, _ = ElementTree.fromstring(surfaces).iter("Piece")
    features = (triangles.findtext("CellData/DataArray[@Name='feature']") or "").split()
    assert set(features) == {"3", "5", "6"}


@pytest.mark.parametrize(
    ("asked", "status", "span"),
    [
        ("bytes=0-3", 206, slice(0, 4)),
        ("Bytes = 2-", 206, slice(2, None)),
        ("bytes=-5", 206, slice(-5, None)),
        ("bytes=0-99999999999", 206, slice(None)),
        ("bytes=5-2", 200, slice(None)),
        ("bytes=-", 200, slice(None)),
        ("bytes=a-b", 200, slice(None)),
        ("bytes=0-" + "9" * 5000, 200, slice(None)),
        ("lines=0-3", 200, slice(None)),
        ("nothing", 200, slice(None)),
        ("", 200, slice(None)),
    ],
)
def test_a_part_of_the_file_is_sent_and_all_of_it_where_the_part_is_not_understood(hall, asked, status, span):
    url = f"{hall[0]}/download?format=rho"
    answer = httpx.get(url, headers={"Range": asked})
    assert answer.status_code == status
    assert answer.content == httpx.get(url).content[span]


@pytest.mark.parametrize("params", [{}, {"degree": 1}])
def test_a_table_can_be_uploaded_again(hall, params):
    url, map_ = hall
    table = httpx.get(f"{url}/download", params={"format": "csv", **params}, timeout=60).content
    again = httpx.put(url.replace("hall", "again"), content=table, timeout=60)
    assert again.status_code in (200, 201)
    assert again.json()["landmarks"] == len(map_)
    assert again.json()["density"] == ("tensor" if params else "ray")
    assert [source["name"] for source in again.json()["sources"]] == ["again.csv"]


def test_bad_tables_replace_nothing(hall):
    url, map_ = hall
    header, first, *others = httpx.get(f"{url}/download?format=csv", timeout=60).content.splitlines()
    descriptor, _, *rest = first.split(b",")
    damaged = b"\n".join([header, b",".join([descriptor, b"nan", *rest]), *others])
    answer = httpx.put(url, content=damaged, timeout=60)
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_map")
    assert "hall.csv" in answer.json()["message"]
    assert httpx.get(url).json()["id"] == map_.info.id


@pytest.mark.parametrize(
    ("params", "code"),
    [
        ({"format": "ply", "degree": 2}, "invalid_input"),
        ({"degree": 2}, "invalid_input"),
        pytest.param({"format": "csv", "degree": 9}, "invalid_input", marks=pytest.mark.slow),
        ({"format": "csv", "degree": "two"}, "invalid_request"),
        ({"format": "surfaces", "features": "all"}, "invalid_input"),
        pytest.param(  # by a process, too
            {"format": "surfaces", "features": "0:999999999"}, "invalid_input", marks=pytest.mark.slow
        ),
    ],
)
def test_exports_without_sense_are_refused(hall, params, code):
    answer = httpx.get(f"{hall[0]}/download", params=params, timeout=60)
    assert (answer.status_code, answer.json()["code"]) == (422, code)


def test_a_map_without_memory_has_no_observations(service):
    answer = httpx.get(f"{service.url}/v1/maps/room/download?format=observations")
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_input")


def test_no_map_is_named_all(service, picture_world):
    url = service.url + "/v1/maps"
    for answer in (
        httpx.put(f"{url}/all", content=picture_world.rho()),
        httpx.patch(f"{url}/room", json={"name": "all"}),
        httpx.get(f"{url}/all"),
    ):
        assert (answer.status_code, answer.json()["code"]) == (422, "invalid_name")
    (service.settings.maps_dir / "all.rho").write_bytes(picture_world.rho())
    assert [one["name"] for one in httpx.get(url).json()["maps"]] == ["loose", "room"]
    png = {"Content-Type": "image/png"}
    answer = httpx.post(f"{service.url}/v1/localize?maps=all&dof=6", content=picture_world.png(), headers=png)
    assert answer.json()["localized"]
    (service.settings.maps_dir / "all.rho").unlink()


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
        renderings._program._process.kill()
        assert cv2.imdecode(np.frombuffer((await renderings.get("room", Rendering.PREVIEW)).content, np.uint8), 1).any()
        await renderings.close()

    asyncio.run(scenario())


@pytest.mark.slow
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
