"""Sites as documents: what they may hold, how they are kept, where they lie on Earth."""

import json
import math
import os
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from rholoc.errors import Conflict, InvalidInput, InvalidName, UnknownSite
from rholoc.geometry import Similarity
from rholoc.geometry.earth import EarthPlace, enu_of
from rholoc.library.sites import SiteLibrary
from rholoc.maps import FramePose, Site, SiteLink, SiteMap, SiteOnEarth, check_site

HALF_TURN = (0.0, 0.0, 1.0, 0.0)
EARTH = SiteOnEarth(52.52, 13.405, 74.0, heading_deg=90.0)
HALL = SiteMap("hall", "0", pose=FramePose(), covariance=tuple(map(tuple, (1e-4 * np.eye(6)).tolist())))
KITCHEN = SiteMap(
    "kitchen", "1", given=FramePose((5.0, 0.0, 3.0), HALF_TURN), pose=FramePose((5.0, 0.0, 3.0), HALF_TURN)
)
LINK = SiteLink("hall", "kitchen", FramePose((5.0, 0.0, 3.0), HALF_TURN))
SITE = Site(maps=(HALL, KITCHEN, SiteMap("attic")), links=(LINK,), earth=EARTH)


def test_a_site_is_kept_as_it_is(tmp_path: Path) -> None:
    library = SiteLibrary(tmp_path)
    assert library.put("campus", SITE).version == 1
    assert library.put("campus", SITE).version == 2
    assert library.get("campus") == replace(SITE, version=2)
    assert library.names() == ["campus"]
    assert library.all() == {"campus": replace(SITE, version=2)}
    assert library.site_of("kitchen") == "campus"
    assert library.site_of("attic") is None  # it has no pose
    assert json.loads((tmp_path / "sites" / "campus.json").read_text())["format"] == "rholoc-site"
    library.delete("campus")
    assert library.all() == {}
    with pytest.raises(UnknownSite, match="There are none yet"):
        library.get("campus")


def test_a_change_of_what_was_changed_meanwhile_is_refused(tmp_path: Path) -> None:
    library = SiteLibrary(tmp_path)
    library.put("campus", SITE)
    library.put("campus", SITE, replaces=1)
    with pytest.raises(Conflict, match="version 2"):
        library.put("campus", SITE, replaces=1)


def test_of_changes_at_the_same_moment_none_is_lost(tmp_path: Path) -> None:
    """Each by a library of its own, as in another process."""
    SiteLibrary(tmp_path).put("campus", Site())

    def add(name: str) -> None:
        library = SiteLibrary(tmp_path)
        while True:
            site = library.get("campus")
            with suppress(Conflict):
                library.put("campus", replace(site, maps=(*site.maps, SiteMap(name))), replaces=site.version)
                return

    names = [f"room-{number}" for number in range(12)]
    with ThreadPoolExecutor(len(names)) as pool:
        list(pool.map(add, names))
    site = SiteLibrary(tmp_path).get("campus")
    assert sorted(one.map for one in site.maps) == sorted(names)
    assert site.version == 1 + len(names)


def rows(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, matrix.tolist()))


@pytest.mark.parametrize(
    ("site", "says"),
    [
        (replace(SITE, maps=(HALL, HALL)), "listed twice"),
        (replace(SITE, maps=(HALL,)), "kitchen, which is not the site's"),
        (replace(SITE, links=(replace(LINK, second="hall"),)), "to itself"),
        (replace(SITE, links=(replace(LINK, sigma_m=0.0),)), "sigmas"),
        (replace(SITE, links=(replace(LINK, sigma_deg=math.nan),)), "sigmas"),
        (replace(SITE, links=(replace(LINK, pose=FramePose((math.inf, 0, 0))),)), "not a pose"),
        (replace(SITE, maps=(replace(HALL, given=FramePose(quaternion_xyzw=(0, 0, 0, 2))), KITCHEN)), "length is 2"),
        (replace(SITE, maps=(replace(HALL, given=FramePose(quaternion_xyzw=(0, 0, 0, 0))), KITCHEN)), "no rotation"),
        (replace(SITE, maps=(replace(HALL, covariance=rows(-np.eye(6))), KITCHEN)), "covariance"),
        (replace(SITE, maps=(replace(HALL, covariance=rows(np.eye(5))), KITCHEN)), "covariance"),
        (replace(SITE, maps=(replace(HALL, covariance=rows(np.triu(np.ones((6, 6))))), KITCHEN)), "covariance"),
        (replace(SITE, maps=(replace(HALL, covariance=((1.0,), (1.0, 2.0))), KITCHEN)), "covariance"),
        (replace(SITE, maps=(replace(HALL, floor="x" * 101), KITCHEN)), "floor"),
        (replace(SITE, earth=replace(EARTH, latitude_deg=91.0)), "on Earth"),
        (replace(SITE, earth=replace(EARTH, longitude_deg=math.nan)), "on Earth"),
    ],
)
def test_what_can_be_no_site_is_refused(tmp_path: Path, site: Site, says: str) -> None:
    library = SiteLibrary(tmp_path)
    with pytest.raises(InvalidInput, match=says):
        library.put("campus", replace(site, maps=(*site.maps, *(() if "kitchen" in says else (SiteMap("cellar"),)))))
    assert library.names() == []


def test_names_of_sites_and_maps_are_names(tmp_path: Path) -> None:
    with pytest.raises(InvalidName):
        SiteLibrary(tmp_path).put("../campus", SITE)
    with pytest.raises(InvalidName):
        check_site(Site(maps=(SiteMap("../hall"),)))


@pytest.mark.parametrize("text", ["", "{}", "[]", "null", '{"format": "rholoc-site"}', "[" * 100_000])
def test_a_broken_file_is_said_to_be_broken(tmp_path: Path, text: str) -> None:
    library = SiteLibrary(tmp_path)
    library.put("good", SITE)
    (tmp_path / "sites" / "campus.json").write_text(text)
    with pytest.raises(InvalidInput, match="campus is broken"):
        library.get("campus")
    assert list(library.all()) == ["good"]


def changed_at(maps_dir: Path, time_ns: int) -> None:
    """Let the folder of sites have changed then, long ago: so that it does not depend on the clock's ticks."""
    os.utime(maps_dir / "sites", ns=(time_ns, time_ns))


def test_the_site_of_a_map_follows_every_change(tmp_path: Path) -> None:
    one, other = SiteLibrary(tmp_path), SiteLibrary(tmp_path)
    assert one.site_of("hall") is None
    for number, expected in enumerate(["b", "a", "a"]):
        other.put("ba"[number % 2], Site(maps=(SiteMap("hall", pose=FramePose()), SiteMap("yard"))))
        changed_at(tmp_path, number)
        assert (one.site_of("hall"), one.site_of("yard")) == (expected, None)
    other.delete("a")
    changed_at(tmp_path, 3)
    assert one.site_of("hall") == "b"


def test_sites_are_read_again_only_after_a_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    library = SiteLibrary(tmp_path)
    library.put("campus", Site(maps=(SiteMap("hall", pose=FramePose()),)))
    changed_at(tmp_path, 1)
    assert library.site_of("hall") == "campus"
    monkeypatch.setattr(SiteLibrary, "get", lambda *_: pytest.fail("a file was read"))
    assert (library.site_of("hall"), library.site_of("yard")) == ("campus", None)


def test_a_renamed_map_stays_in_its_sites(tmp_path: Path) -> None:
    library = SiteLibrary(tmp_path)
    hall, yard = SiteMap("hall", floor="1", pose=FramePose((1.0, 2.0, 3.0))), SiteMap("yard")
    library.put("campus", Site(maps=(hall, yard), links=(SiteLink("yard", "hall", FramePose()),)))
    library.put("both", Site(maps=(hall, SiteMap("lobby"))))
    library.rename_map("hall", "lobby")
    campus = library.get("campus")
    assert campus.maps == (replace(hall, map="lobby"), yard)
    assert [(link.first, link.second) for link in campus.links] == [("yard", "lobby")]
    assert [one.map for one in library.get("both").maps] == ["hall", "lobby"], "it has a map of that name already"


def test_a_site_turned_to_the_east_looks_east() -> None:
    ahead = EARTH.place(np.array([0.0, 100.0, 0.0]))  # along y, which points to the east
    assert ahead.longitude_deg > EARTH.longitude_deg
    assert ahead.latitude_deg == pytest.approx(EARTH.latitude_deg, abs=1e-6)
    assert EARTH.heading_deg_of(np.array([0.0, 1.0, 0.0])) == pytest.approx(90.0)
    assert EARTH.heading_deg_of(np.array([1.0, 0.0, 0.0])) == pytest.approx(180.0)
    assert EARTH.heading_deg_of(np.array([0.0, 0.0, 1.0])) is None


def test_maps_near_a_place_on_earth_are_found() -> None:
    at_kitchen = EARTH.place(np.array([5.0, 0.0, 0.0]))
    assert SITE.maps_near(at_kitchen, 3.0) == ["kitchen"]
    assert SITE.maps_near(at_kitchen, 10.0) == ["kitchen", "hall"]
    assert SITE.maps_near(EarthPlace(0.0, 0.0), 1000.0) == []
    assert replace(SITE, earth=None).maps_near(at_kitchen, 10.0) == []


TRUE = SiteOnEarth(52.52, 13.405, 74.0, 33.0)
POINTS = np.array([[0.0, 0.0, 0.0], [12.0, 3.0, 1.0], [-4.0, 7.0, 2.5]])


def apart_m(a, b):
    return float(np.linalg.norm(enu_of(a, b)))


@pytest.mark.parametrize("heading_deg", [0.0, 33.0, 180.0, 271.0])
@pytest.mark.parametrize("count", [2, 3])
def test_points_give_it(heading_deg, count):
    true = SiteOnEarth(-33.9, 151.2, 12.0, heading_deg)
    found, missed_m = SiteOnEarth.through(POINTS[:count], [true.place(point) for point in POINTS[:count]])
    assert missed_m < 1e-4
    assert apart_m(found.origin, true.origin) < 1e-3
    assert (found.heading_deg - heading_deg + 180) % 360 - 180 == pytest.approx(0, abs=1e-3)


def test_a_point_and_a_heading_give_it():
    found, missed_m = SiteOnEarth.through(POINTS[1:2], [TRUE.place(POINTS[1])], heading_deg=33.0)
    assert missed_m < 1e-4
    assert apart_m(found.origin, TRUE.origin) < 1e-4


@pytest.mark.parametrize(
    ("points", "places", "words"),
    [
        (POINTS[:1], [TRUE.place(POINTS[0])], "two points"),
        (POINTS[[0, 0]], [TRUE.place(POINTS[0])] * 2, "no direction"),
        (POINTS[:2], [TRUE.place(POINTS[0]), TRUE.place(2 * POINTS[1])], "times as far apart"),
    ],
)
def test_points_that_do_not_give_it_are_refused(points, places, words):
    with pytest.raises(InvalidInput, match=words):
        SiteOnEarth.through(points, places)


@given(st.floats(-180, 180), st.tuples(*[st.floats(-100, 100)] * 3))
def test_points_stay_where_they_are_when_the_frame_moves(turn_deg, shift):
    similarity = Similarity(1.0, Rotation.from_euler("z", turn_deg, degrees=True).as_matrix(), np.array(shift))
    moved = TRUE.moved(similarity)
    for point in POINTS:
        # Over 150 m the Earth curves by 2 mm, and meridians converge by 3e-5 rad, which is 5 mm.
        assert apart_m(moved.place(similarity.points(point[None])[0]), TRUE.place(point)) < 1e-2


def test_the_origin_stays_where_it_is_when_the_scale_changes():
    assert apart_m(TRUE.moved(Similarity(1.3, np.eye(3), np.zeros(3))).origin, TRUE.origin) < 1e-6


def test_a_tilted_frame_has_none():
    tilted = Similarity(1.0, Rotation.from_euler("x", 20, degrees=True).as_matrix(), np.zeros(3))
    assert TRUE.moved(tilted) is None
