"""Maps corrected over HTTP: every kind, its answer, its undoing, and what is refused."""

import cv2
import httpx
import numpy as np
import pytest
from pyproj import Transformer

from rholoc.geometry import Similarity
from rholoc.maps import FramePose, SiteOnEarth, load_map, save_map
from rholoc_client import Client, RholocClientError

SQUARE = [[0, -9], [9, -9], [9, 9], [0, 9]]


@pytest.fixture(scope="module")
def site(serve, point_room, picture_world):
    """A service with the maps ``room``, which shows a picture, and ``hall``, which remembers what it learned from."""
    running = serve()
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    save_map(point_room.map_of(point_room.walk(30), "walk"), running.settings.maps_dir / "hall.rho")
    return running


def correct(site, name, body):
    return httpx.post(f"{site.url}/v1/maps/{name}/corrections", json=body, timeout=60)


def test_a_picture_s_pose_moves_by_what_the_map_reports_and_back(site, picture_world):
    client = Client(site.url)

    def pose():
        return client.localize("room", picture_world.png(), camera=None).pose.T_map_camera

    before = np.array(pose())
    turned = correct(site, "room", {"kind": "wall", "direction": [1, 1, 0], "version": 3})
    assert turned.status_code == 200, turned.text
    plan = [{"map": [0, 0, 0], "plan": [4, 2]}, {"map": [1, 0, 0], "plan": [4, 3.1]}]
    client.correct_map("room", {"kind": "plan", "points": plan, "scaled": True})
    done = client.correct_map("room", {"kind": "origin", "at": [1, 2, 0.5]})
    assert done.version == 6
    corrections = httpx.get(f"{site.url}/v1/maps/room").json()["corrections"]
    assert [one["kind"] for one in corrections] == ["wall", "plan", "origin"]
    assert corrections[1]["residual_m"] == pytest.approx(0, abs=1e-9)
    expected = before[None]
    for one in corrections:
        expected = Similarity(one["scale"], np.array(one["rotation"]), np.array(one["translation"])).poses(expected)
    np.testing.assert_allclose(pose(), expected[0], atol=1e-3)
    versions = httpx.get(f"{site.url}/v1/maps/room/versions").json()["versions"]
    assert [(one["number"], one["version"]) for one in versions] == [(1, 5), (2, 4), (3, 3)]
    assert client.restore_map("room", 3).version == 3
    np.testing.assert_allclose(pose(), before, atol=1e-6)


def test_a_region_a_piece_of_the_walk_and_names(site):
    before = load_map(site.settings.maps_dir / "hall.rho")
    door = {"name": "Tür", "position": [1, 2, 0.5], "kind": "door", "fields": {"fire": True, "width_m": 0.9, "no": 3}}
    named = {"points": [door], "areas": [{"name": "Küche", "outline": SQUARE}]}
    answer = correct(site, "hall", {"kind": "names", **named}).json()
    assert answer["names"] == {"points": [door], "areas": [{**named["areas"][0], "kind": "", "fields": {}}]}
    answer = correct(site, "hall", {"kind": "walk", "first_view": 20, "last_view": 29}).json()
    assert (answer["views"], answer["corrections"][-1]["views_removed"]) == (20, 10)
    answer = correct(site, "hall", {"kind": "region", "outline": SQUARE, "keep": "inside"}).json()
    after = load_map(site.settings.maps_dir / "hall.rho")
    assert answer["landmarks"] == len(after) < len(before)
    assert after.landmarks.positions[:, 0].min() >= 0
    assert answer["names"]["areas"][0]["name"] == "Küche"


@pytest.mark.parametrize(
    ("name", "body", "status", "code"),
    [
        ("nowhere", {"kind": "up"}, 404, "unknown_map"),
        ("room", {}, 422, "invalid_request"),
        ("room", {"kind": "sideways"}, 422, "invalid_request"),
        ("room", {"kind": "origin"}, 422, "invalid_request"),
        ("room", {"kind": "origin", "at": [0, 0]}, 422, "invalid_request"),
        ("room", {"kind": "origin", "at": ["0", "0", "x"]}, 422, "invalid_request"),
        ("room", {"kind": "origin", "at": [1e30, 0, 0]}, 422, "invalid_input"),
        ("room", {"kind": "origin", "at": [0, 0, 0], "version": 2}, 409, "conflict"),
        ("room", {"kind": "north", "direction": [0, 0, 1]}, 422, "invalid_input"),
        ("room", {"kind": "scale", "start": [0, 0, 0], "end": [1, 0, 0], "length_m": -1}, 422, "invalid_request"),
        ("room", {"kind": "scale", "start": [0, 0, 0], "end": [0, 0, 0], "length_m": 1}, 422, "invalid_input"),
        ("room", {"kind": "plan", "points": []}, 422, "invalid_input"),
        ("room", {"kind": "plan", "points": [{"map": [0, 0, 0], "plan": [0, 0]}]}, 422, "invalid_input"),
        ("room", {"kind": "region", "outline": [], "keep": "inside"}, 422, "invalid_input"),
        ("room", {"kind": "region", "outline": [[0, 0], [1, 1]], "keep": "inside"}, 422, "invalid_input"),
        ("room", {"kind": "region", "outline": SQUARE, "keep": "none"}, 422, "invalid_request"),
        ("room", {"kind": "walk", "first_view": 3, "last_view": 2}, 422, "invalid_input"),
        ("room", {"kind": "walk", "first_view": 0, "last_view": 2**53}, 422, "invalid_input"),
        ("room", {"kind": "walk", "first_view": 0, "last_view": 3}, 409, "conflict"),
        ("room", {"kind": "names", "points": [{"name": "", "position": [0, 0, 0]}]}, 422, "invalid_input"),
        ("room", {"kind": "names", "points": [{"name": "a\nb", "position": [0, 0, 0]}]}, 422, "invalid_input"),
        (
            "room",
            {"kind": "names", "points": [{"name": "a", "position": [0, 0, 0], "kind": "\n"}]},
            422,
            "invalid_input",
        ),
        (
            "room",
            {"kind": "names", "points": [{"name": "a", "position": [0, 0, 0], "fields": {"b": []}}]},
            422,
            "invalid_request",
        ),
    ],
)
def test_what_does_not_fit_is_refused_and_changes_nothing(site, name, body, status, code):
    before = (site.settings.maps_dir / "room.rho").read_bytes()
    answer = correct(site, name, body)
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
    assert answer.json()["message"]
    assert (site.settings.maps_dir / "room.rho").read_bytes() == before


def test_only_versions_that_are_kept_are_restored(site):
    answer = httpx.post(f"{site.url}/v1/maps/hall/restore", params={"number": 5})
    assert (answer.status_code, answer.json()["code"]) == (409, "conflict")
    assert httpx.post(f"{site.url}/v1/maps/hall/restore", params={"number": 0}).status_code == 422
    assert httpx.get(f"{site.url}/v1/maps/nowhere/versions").status_code == 404


def test_answers_name_where_the_camera_is(site, picture_world):
    client = Client(site.url)
    around = [[0, 0], [3, 0], [3, 4], [0, 4]]
    areas = [
        {"name": "flat", "outline": [[-9, -9], [9, -9], [9, 9], [-9, 9]]},
        {"name": "attic", "outline": [[5, 5], [6, 5], [6, 6]]},
        {"name": "kitchen", "outline": around},
    ]
    points = [
        {"name": "door", "position": [1, 3.5, 1.5]},
        {"name": "gate", "position": [1, 9, 1.5]},
        {"name": "table", "position": [1, 2.5, 1.5]},
    ]
    client.correct_map("room", {"kind": "names", "points": points, "areas": areas})
    answer = client.localize("room", picture_world.png(), camera=None)
    assert (answer.areas, answer.near) == (("kitchen", "flat"), ("table", "door"))
    blank = client.localize("room", np.full((480, 640, 3), 90, np.uint8), camera=None)
    assert (blank.localized, blank.areas, blank.near) == (False, (), ())
    client.restore_map("room")


def test_names_go_out_and_in_as_geojson(site):
    client = Client(site.url)
    door = {"name": "door", "kind": "way out", "position": [1, 2, 0.5], "fields": {"fire": True}}
    kitchen = {"name": "kitchen", "kind": "", "outline": [[0, 0], [4, 0], [4, 3]], "fields": {}}
    named = {"points": [door], "areas": [kitchen]}
    client.correct_map("hall", {"kind": "names", **named})
    in_metres = client.map_names("hall")
    assert in_metres["frame"] == "map"
    place = {"latitude_deg": 52.52, "longitude_deg": 13.405, "height_m": 40}
    client.correct_map("hall", {"kind": "earth", "heading_deg": 20, "points": [{"map": [1, 2, 0.5], **place}]})
    on_earth = client.map_names("hall")
    assert on_earth["features"][0]["geometry"]["coordinates"] == pytest.approx([13.405, 52.52, 40], abs=1e-5)
    for document in (on_earth, in_metres):
        client.correct_map("hall", {"kind": "names"})
        client.put_map_names("hall", document)
        found = httpx.get(f"{site.url}/v1/maps/hall").json()["names"]
        assert {**found["points"][0], "position": None} == {**door, "position": None}
        np.testing.assert_allclose(found["points"][0]["position"], door["position"], atol=1e-5)
        np.testing.assert_allclose(found["areas"][0]["outline"], kitchen["outline"], atol=1e-5)
    taken = httpx.get(f"{site.url}/v1/maps/hall/names")
    assert taken.headers["Content-Type"] == "application/geo+json"
    downloaded = httpx.get(f"{site.url}/v1/maps/hall/download", params={"format": "geojson"})
    assert downloaded.json() == taken.json()
    for kind, body, code in (
        ("text/plain", b"{}", "unsupported_media_type"),
        ("application/geo+json", b"{}", "invalid_input"),
        ("application/zip", b"PK", "invalid_input"),
    ):
        refused = httpx.put(f"{site.url}/v1/maps/hall/names", content=body, headers={"Content-Type": kind})
        assert refused.json()["code"] == code
    assert httpx.get(f"{site.url}/v1/maps/hall/names").json() == taken.json()


def test_a_map_is_on_earth_by_a_national_grid(site):
    client = Client(site.url)
    grid = {"easting": 391779.24, "northing": 5820072.41, "height_m": 40}
    document = {"kind": "earth", "heading_deg": 0, "crs": "EPSG:25833", "points": [{"map": [0, 0, 0], **grid}]}
    client.correct_map("hall", {"kind": "names", "points": [{"name": "desk", "position": [0, 0, 0]}]})
    client.correct_map("hall", document)
    there = Transformer.from_crs(25833, 4326, always_xy=True).transform(grid["easting"], grid["northing"])
    (found,) = client.map_names("hall")["features"]
    assert found["geometry"]["coordinates"] == pytest.approx([*there, 40], abs=1e-6)
    document["points"] = [{"map": [0, 0, 0], "latitude_deg": 52.52, "longitude_deg": 13.405}]
    with pytest.raises(RholocClientError, match="Give each easting and northing"):
        client.correct_map("hall", document)
    with pytest.raises(RholocClientError, match="Give each latitude_deg and longitude_deg"):
        client.correct_map("hall", {"kind": "earth", "points": [{"map": [0, 0, 0], **grid}]})


def test_a_map_is_on_earth_by_its_site(site):
    """Beside the map's own place, which its corrections gave it: the same point, by another way."""
    client = Client(site.url)
    client.correct_map("room", {"kind": "names", "points": [{"name": "door", "position": [3, 1, 0.5]}]})
    earth = {"latitude_deg": 52.52, "longitude_deg": 13.405, "height_m": 40.0, "heading_deg": 30.0}
    turned = {"position": [10, -5, 2], "quaternion_xyzw": [0, 0, 0.6, 0.8]}
    client.put_site("campus", {"maps": [{"map": "room", "pose": turned}], "earth": earth})
    (found,) = client.map_names("room")["features"]
    longitude, latitude, height = found["geometry"]["coordinates"]
    T = FramePose((10.0, -5.0, 2.0), (0.0, 0.0, 0.6, 0.8)).matrix
    expected = SiteOnEarth(**earth).place((T @ [3, 1, 0.5, 1])[:3])
    assert (latitude, longitude) == pytest.approx((expected.latitude_deg, expected.longitude_deg), abs=1e-8)
    assert height == pytest.approx(expected.height_m, abs=1e-4)
    client.put_map_names("room", client.map_names("room"))
    position = httpx.get(f"{site.url}/v1/maps/room").json()["names"]["points"][0]["position"]
    np.testing.assert_allclose(position, [3, 1, 0.5], atol=1e-4)
    client.delete_site("campus")
    assert client.map_names("room")["frame"] == "map"
    client.restore_map("room", 2)


def test_a_floor_plan_comes_as_a_map_server_has_it(site, tmp_path):
    cv2.imwrite(str(tmp_path / "hall.pgm"), np.zeros((30, 40), np.uint8))
    (tmp_path / "hall.yaml").write_text("image: hall.pgm\nresolution: 0.05\norigin: [-1, 2, 0]\nnegate: 0\n")
    client = Client(site.url)
    client.put_floor_plan("hall", tmp_path / "hall.yaml")
    plan = {"media_type": "image/png", "corner": [-1, 2], "turn_deg": 0, "m_per_unit": 0.05}
    assert httpx.get(f"{site.url}/v1/maps/hall").json()["plan"] == plan
    assert client.floor_plan("hall").startswith(b"\x89PNG")
    client.put_floor_plan("hall", tmp_path / "hall.yaml", x=3, turn_deg=90)
    assert httpx.get(f"{site.url}/v1/maps/hall").json()["plan"] == {**plan, "corner": [3, 2], "turn_deg": 90}
    client.delete_floor_plan("hall")
    assert httpx.get(f"{site.url}/v1/maps/hall").json()["plan"] is None


def test_labels_say_what_a_map_belongs_to(site):
    wanted = {"kind": "labels", "site": " plant 2 ", "floor": "1", "tags": ["night shift"]}
    assert correct(site, "hall", wanted).json()["labels"] == {"site": "plant 2", "floor": "1", "tags": ["night shift"]}
    listed = {one["name"]: one["labels"] for one in httpx.get(f"{site.url}/v1/maps").json()["maps"]}
    assert listed["room"] == {"site": "", "floor": "", "tags": []}
    assert listed["hall"]["site"] == "plant 2"
    for tags in (["a", "a"], [""], ["x" * 101], [str(number) for number in range(21)]):
        answer = correct(site, "hall", {"kind": "labels", "tags": tags})
        assert (answer.status_code, answer.json()["code"]) == (422, "invalid_input")


def test_a_floor_plan_is_kept_and_moves_with_the_map(site):
    url = f"{site.url}/v1/maps/hall"
    picture = cv2.imencode(".png", np.zeros((30, 40), np.uint8))[1].tobytes()
    placed = {"x": 1, "y": 2, "turn_deg": 10, "m_per_unit": 0.02}
    kept = httpx.put(f"{url}/plan", params=placed, content=picture, headers={"Content-Type": "image/png"}).json()
    assert kept["plan"] == {"media_type": "image/png", "corner": [1, 2], "turn_deg": 10, "m_per_unit": 0.02}
    correct(site, "hall", {"kind": "origin", "at": [1, 0, 0]})
    moved = correct(site, "hall", {"kind": "wall", "direction": [0, 1, 0]}).json()["plan"]
    np.testing.assert_allclose([*moved["corner"], moved["turn_deg"]], [2, 0, -80], atol=1e-9)
    taken = httpx.get(f"{url}/plan")
    assert (taken.content, taken.headers["Content-Type"]) == (picture, "image/png")
    assert (
        correct(site, "hall", {"kind": "up", "direction": [0, 1, 1]}).json()["plan"] is None
    )  # it lies on no floor now
    gone = httpx.get(f"{url}/plan")
    assert (gone.status_code, gone.json()["code"]) == (404, "unknown_picture")
    httpx.post(f"{url}/restore")
    assert httpx.get(f"{url}/plan").content == picture
    assert httpx.delete(f"{url}/plan").json()["plan"] is None


@pytest.mark.parametrize(
    ("content", "kind", "query", "code"),
    [
        (b"no PNG", "image/png", {}, "invalid_input"),
        (b"[1, 2]", "application/geo+json", {}, "invalid_input"),
        (b"{", "application/geo+json", {}, "invalid_input"),
        (b"<svg/>", "image/svg+xml", {}, "unsupported_media_type"),
        (b"{}", "application/geo+json", {"m_per_unit": 0}, "invalid_request"),
        (b"{}", "application/geo+json", {"x": "nan"}, "invalid_input"),
        (b"\xff\xd8\xff" + b"\0" * 2**23, "image/jpeg", {}, "too_large"),
    ],
    ids=lambda value: value[:12] if isinstance(value, bytes) else None,
)
def test_what_is_no_floor_plan_is_refused(site, content, kind, query, code):
    answer = httpx.put(
        f"{site.url}/v1/maps/hall/plan", params=query, content=content, headers={"Content-Type": kind}, timeout=30
    )
    assert answer.json()["code"] == code
