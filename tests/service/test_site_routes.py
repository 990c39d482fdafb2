"""Sites over HTTP: stored, linked, asked; answers in the site's frame and on Earth."""

from dataclasses import replace

import httpx
import numpy as np
import pytest

from rholoc.maps import Cloud, MapNames, NamedArea, NamedPoint, Room, map_to_bytes, save_map
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.settings import KeyPolicy
from rholoc_client import Client, Conflict, NearPlace, OfSite, UnknownMap, UnknownSite

PATIENCE_S = 60
PNG = {"content-type": "image/png"}
TURNED = {"position": [10.0, 20.0, 3.0], "quaternion_xyzw": [0.0, 0.0, 2**-0.5, 2**-0.5]}  # by 90° about z
EARTH = {"latitude_deg": 52.52, "longitude_deg": 13.405, "height_m": 74.0, "heading_deg": 0.0}
LINK = {"first": "room", "second": "west", "pose": {"position": [1.0, 0.0, 0.0]}}


@pytest.fixture(scope="module")
def campus(serve, picture_world, point_room):
    """A service with a room, two maps that overlap, and the rules of a site."""
    running = serve()
    folder = running.settings.maps_dir
    (folder / "room.rho").write_bytes(picture_world.rho())
    walk = point_room.walk(80)
    for name, poses in (("west", walk[:45:2]), ("east", walk[25:65:2])):
        save_map(point_room.map_of(poses, name), folder / f"{name}.rho")
    return running


@pytest.fixture
def client(campus):
    with Client(campus.url) as client:
        yield client
        for site in client.sites():
            client.delete_site(site.name)


def test_an_answer_is_in_the_sites_frame_and_on_earth(client, picture_world) -> None:
    client.put_site("campus", {"maps": [{"map": "room", "floor": "2", "pose": TURNED}], "earth": EARTH})
    answer = client.localize("room", picture_world.png(), dof=6)
    assert answer.localized
    x, y, z = answer.pose.position
    assert answer.site.position == pytest.approx((10.0 - y, 20.0 + x, 3.0 + z), abs=1e-6)
    assert answer.site.heading == pytest.approx(
        (-answer.pose.heading[1], answer.pose.heading[0], answer.pose.heading[2])
    )
    assert (answer.site.site, answer.site.version, answer.site.floor) == ("campus", 1, "2")
    assert answer.site.earth.latitude_deg == pytest.approx(52.52 + (20.0 + x) / 111_270, abs=1e-6)
    assert answer.site.earth.height_m == pytest.approx(77.0 + z, abs=1e-3)
    own, there = np.array(answer.covariance), np.array(answer.site.covariance)
    assert np.trace(there[:3, :3]) >= np.trace(own[:3, :3])
    client.delete_site("campus")
    assert client.localize("room", picture_world.png(), dof=6).site is None


@pytest.mark.parametrize("maps", [OfSite("campus"), NearPlace(52.5201, 13.4052, 100.0)])
def test_a_request_names_a_site_or_a_place_on_earth(client, picture_world, maps) -> None:
    client.put_site("campus", {"maps": [{"map": "room", "pose": TURNED}], "earth": EARTH})
    answer = client.localize(maps, picture_world.png(), dof=6)
    assert answer.map == "room"
    assert answer.site is not None


def test_a_renamed_map_stays_in_its_site(client) -> None:
    client.put_site("campus", {"maps": [{"map": "room", "pose": TURNED}]})
    client.rename_map("room", "study")
    (one,) = client.site("campus").maps
    assert (one.map, one.present) == ("study", True)
    client.rename_map("study", "room")


def test_a_request_without_maps_asks_all(campus, picture_world) -> None:
    answer = httpx.post(
        f"{campus.url}/v1/localize?dof=6",
        content=picture_world.png(),
        headers=PNG,
        timeout=PATIENCE_S,
    )
    assert answer.json()["map"] == "room"


@pytest.mark.parametrize(
    ("query", "code"),
    [
        ("site=nowhere", "unknown_site"),
        ("site=../x", "invalid_name"),
        ("site=campus&maps=all", "invalid_request"),
        ("site=campus&latitude=1&longitude=1", "invalid_request"),
        ("latitude=52", "invalid_request"),
        ("latitude=91&longitude=0", "invalid_request"),
        ("latitude=-33&longitude=151", "unknown_map"),
        ("latitude=nan&longitude=0", "invalid_request"),
    ],
)
def test_what_names_no_maps_is_refused(client, campus, picture_world, query: str, code: str) -> None:
    client.put_site("campus", {"maps": [{"map": "room", "pose": TURNED}], "earth": EARTH})
    answer = httpx.post(
        f"{campus.url}/v1/localize?{query}",
        content=picture_world.png(),
        headers=PNG,
        timeout=PATIENCE_S,
    )
    assert answer.json()["code"] == code


@pytest.mark.slow
def test_maps_that_overlap_are_placed(client) -> None:
    before = client.put_site("campus", {"maps": [{"map": "west"}, {"map": "east"}, {"map": "room"}]})
    assert [one.position is None for one in before.maps] == [False, True, True]
    after = client.find_site_link("campus", "west", "east")
    assert after.version == 2
    assert after.maps[1].position == pytest.approx((0, 0, 0), abs=0.03)  # both are in the frame of one walk
    assert after.links[0]["origin"] == "overlap"
    assert client.site("campus") == after
    assert client.sites() == [after]


@pytest.mark.parametrize(
    ("body", "status", "code"),
    [
        ({"maps": [{"map": "nowhere"}]}, 404, "unknown_map"),
        ({"maps": [{"map": "room"}, {"map": "room"}]}, 422, "invalid_input"),
        ({"maps": [{"map": "room", "pose": {"quaternion_xyzw": [0, 0, 0, 2.0]}}]}, 422, "invalid_input"),
        ({"maps": [{"map": "room"}], "links": [LINK]}, 422, "invalid_input"),
        ({"maps": [{"map": "room", "pose": {"position": [1.0, 2.0]}}]}, 422, "invalid_request"),
        ({"maps": [{"map": "room"}], "earth": {**EARTH, "latitude_deg": 91.0}}, 422, "invalid_input"),
        ({"maps": [{"map": "room"}], "colour": "red"}, 422, "invalid_request"),
        ({"maps": [{"map": "room"}], "version": 7}, 409, "conflict"),
        (
            {
                "maps": [{"map": "room", "pose": {}}, {"map": "west", "pose": {}}],
                "links": [LINK],
            },
            422,
            "invalid_input",
        ),
    ],
)
def test_what_can_be_no_site_is_refused(campus, client, body, status: int, code: str) -> None:
    answer = httpx.put(f"{campus.url}/v1/sites/campus", json=body, timeout=PATIENCE_S)
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
    assert client.sites() == []


def test_a_job_places_the_maps_of_a_site(campus, client) -> None:
    client.put_site("campus", {"maps": [{"map": "west"}, {"map": "east"}]})
    answer = httpx.post(f"{campus.url}/v1/sites/campus/place", timeout=PATIENCE_S)
    assert answer.status_code == 202
    job = client.job(answer.json()["id"])
    assert answer.headers["Location"] == f"/v1/jobs/{job.id}"
    assert (job.kind, job.site, job.map, job.recording, job.state) == ("place", "campus", "", "", "queued")
    assert answer.json()["trusted"] is None
    with pytest.raises(Conflict, match=job.id):
        client.place_site("campus")
    client.cancel_job(job.id)
    again = client.place_site("campus")
    assert again.id != job.id
    client.cancel_job(again.id)
    with pytest.raises(UnknownSite):
        client.place_site("nowhere")


@pytest.mark.parametrize(
    ("pair", "code"),
    [
        (("west", "nowhere"), "invalid_input"),
        (("west", "room"), "invalid_input"),  # which remembers nothing of its views
    ],
)
def test_maps_that_cannot_be_linked_are_refused(campus, client, pair: tuple[str, str], code: str) -> None:
    client.put_site("campus", {"maps": [{"map": "west"}, {"map": "east"}, {"map": "room"}]})
    body = {"first": pair[0], "second": pair[1]}
    answer = httpx.post(f"{campus.url}/v1/sites/campus/links", json=body, timeout=PATIENCE_S)
    assert answer.json()["code"] == code
    assert client.site("campus").version == 1


def test_a_map_that_is_deleted_is_said_to_be_gone(campus, client, picture_world) -> None:
    (campus.settings.maps_dir / "short.rho").write_bytes(picture_world.rho())
    client.put_site("campus", {"maps": [{"map": "short"}]})
    client.delete_map("short")
    assert [one.present for one in client.site("campus").maps] == [False]
    with pytest.raises(UnknownMap, match="No map of the site campus is here"):
        client.localize(OfSite("campus"), picture_world.png())


def test_a_change_from_an_old_version_is_refused(client) -> None:
    client.put_site("campus", {"maps": [{"map": "room"}]})
    client.put_site("campus", {"maps": [{"map": "west"}], "version": 1})
    with pytest.raises(Conflict, match="changed in the meantime"):
        client.put_site("campus", {"maps": [{"map": "room"}], "version": 1})


def test_a_broken_file_is_named_apart(campus, client) -> None:
    client.put_site("campus", {"maps": [{"map": "room"}]})
    broken = campus.settings.maps_dir / "sites" / "broken.json"
    broken.write_text("{")
    listed = httpx.get(f"{campus.url}/v1/sites").json()
    assert [site["name"] for site in listed["sites"]] == ["campus"]
    assert "broken" in listed["unreadable"]
    broken.unlink()


NAMES = MapNames((NamedPoint("door", (3.0, 2.0, 1.0)),), (NamedArea("lounge", ((0, 0), (2, 0), (2, 2), (0, 2))),))
TURNED_HALL = {"position": [10.0, 0.0, 0.0], "quaternion_xyzw": [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]}


@pytest.fixture(scope="module")
def site(serve, picture_world):
    """A service with keys, and a site of two maps, of which one has no place in it."""
    running = serve(keys=KeyPolicy.ALWAYS, live=True)
    store = KeyStore(running.settings.data_dir)
    keys = {
        "boss": store.create("boss", Scope.ADMIN),
        "visitor": store.create("visitor", Scope.VISIT, site="campus"),
        "other": store.create("other", Scope.VISIT, site="elsewhere"),
    }
    headers = {name: {"Authorization": f"Bearer {secret}"} for name, secret in keys.items()}
    corner = Cloud(np.zeros((3, 3), np.float32), np.zeros((3, 3), np.uint8), np.zeros(3, np.int32))
    map_ = replace(picture_world.map_, room=Room(corner), info=replace(picture_world.map_.info, names=NAMES))
    for name in ("hall", "cellar"):
        answer = httpx.put(f"{running.url}/v1/maps/{name}", content=map_to_bytes(map_), headers=headers["boss"])
        assert answer.status_code == 201
    wanted = {"maps": [{"map": "hall", "floor": "1", "pose": TURNED_HALL}, {"map": "cellar"}]}
    assert httpx.put(f"{running.url}/v1/sites/campus", json=wanted, headers=headers["boss"]).status_code == 201
    return running, headers


def test_a_visitor_sees_rooms_walks_and_names_in_the_sites_frame(site):
    running, headers = site
    shown = httpx.get(f"{running.url}/v1/here/campus", headers=headers["visitor"]).json()
    (room,) = shown["rooms"]
    assert (room["map"], room["floor"], room["room"]) == ("hall", "1", 3)
    np.testing.assert_allclose(np.array(room["walked"][0])[:, 0], 8.0, atol=0.2)  # 10 - y of the map's walk
    assert {(point["name"], *point["position"][:2]) for point in shown["points"]} == {
        ("door", 8.0, 3.0),
        ("lounge", 9.0, 1.0),
    }
    mesh = httpx.get(f"{running.url}/v1/here/campus/rooms/hall", headers=headers["visitor"])
    assert np.frombuffer(mesh.content[:8], "<u4").tolist() == [3, 0]
    assert httpx.get(f"{running.url}/v1/here/campus/rooms/none", headers=headers["visitor"]).status_code == 404


def test_a_visitors_picture_is_answered_in_the_sites_frame(site, picture_world):
    running, headers = site
    where = f"{running.url}/v1/here/campus/localize"
    kind = {"Content-Type": "image/png"}
    answer = httpx.post(where, content=picture_world.png(), headers={**headers["visitor"], **kind}, timeout=60).json()
    assert set(answer) == {"localized", "floor", "position", "heading", "sigma_m", "message"}
    if answer["localized"]:  # the two maps are alike: either may answer
        np.testing.assert_allclose(answer["position"], [8.0, 1.0, 1.5], atol=0.1)
        assert answer["floor"] == "1"
    else:
        assert answer["message"] == "This room has no place on the plan yet."
    black = httpx.post(where, content=_black(), headers={**headers["visitor"], **kind}, timeout=60).json()
    assert (black["localized"], black["position"]) == (False, None)
    assert black["message"]


def _black() -> bytes:
    import cv2

    return cv2.imencode(".png", np.zeros((480, 640, 3), np.uint8))[1].tobytes()


def test_a_visitor_is_not_shown_live(site, picture_world):
    running, headers = site
    where = f"{running.url}/v1/here/campus/localize"
    noted = running.app.state.rholoc.frames.live.number
    for picture in (picture_world.png(), _black()):
        httpx.post(where, content=picture, headers={**headers["visitor"], "Content-Type": "image/png"}, timeout=60)
    assert running.app.state.rholoc.frames.live.number == noted
    picture = {"content": picture_world.png(), "headers": {**headers["boss"], "Content-Type": "image/png"}}
    httpx.post(f"{running.url}/v1/maps/hall/localize", **picture, timeout=60)
    assert running.app.state.rholoc.frames.live.number == noted + 1


def test_a_visitors_key_allows_nothing_else(site):
    running, headers = site
    for path in ("/v1/maps", "/v1/maps/hall", "/v1/sites/campus", "/v1/jobs"):
        assert httpx.get(running.url + path, headers=headers["visitor"]).status_code == 403
    answer = httpx.get(f"{running.url}/v1/here/campus", headers=headers["other"])
    assert (answer.status_code, answer.json()["message"]) == (403, "This link is for another site.")
    assert httpx.post(f"{running.url}/v1/keys", json={}, headers=headers["visitor"]).status_code == 403


def test_a_key_for_visitors_is_handed_on_for_one_site(site):
    running, headers = site
    wanted = {"scope": "visit", "site": "campus", "lifetime_s": 3600}
    handed = httpx.post(f"{running.url}/v1/keys", json=wanted, headers=headers["boss"]).json()
    key = httpx.get(f"{running.url}/v1/keys/{handed['name']}", headers=headers["boss"]).json()
    assert (key["scope"], key["site"]) == ("visit", "campus")
    visitor = {"Authorization": f"Bearer {handed['key']}"}
    assert httpx.get(f"{running.url}/v1/here/campus", headers=visitor).status_code == 200
    assert httpx.get(f"{running.url}/v1/here/other", headers=visitor).status_code == 403
