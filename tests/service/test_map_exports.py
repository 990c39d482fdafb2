"""Maps over HTTP in other formats, and back from CSV."""

from __future__ import annotations

from xml.etree import ElementTree

import httpx
import numpy as np
import pytest

from rholoc.maps import map_to_ply, map_to_vtp, read_trajectory_csv


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


def _lose_column(cells):
    for row in cells:
        del row[5]


def _gain_column(cells):
    for row in cells:
        row.append("1")


def _change_degree(cells):
    cells[0] = [name.replace("2_2_2_2_2_2", "5_5_5_5_5_5") for name in cells[0]]


def _put_nan(cells):
    cells[2][1] = "nan"


def _repeat_descriptor(cells):
    cells[2] = [*cells[1][:-1], cells[2][-1]]


@pytest.mark.parametrize("damage", [_lose_column, _gain_column, _change_degree, _put_nan, _repeat_descriptor])
def test_bad_tables_replace_nothing(hall, damage):
    url, map_ = hall
    cells = [line.split(b",") for line in httpx.get(f"{url}/download?format=csv", timeout=60).content.splitlines()]
    texts = [[cell.decode() for cell in row] for row in cells]
    damage(texts)
    answer = httpx.put(url, content="\n".join(",".join(row) for row in texts).encode(), timeout=60)
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
