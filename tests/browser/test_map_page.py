"""A map's page and the list of maps: trust first, where it works, and names that are in use already."""

import json
import re
import time
from dataclasses import replace

import cv2
import httpx
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect

from kept_queries import a_query
from rholoc.library.queries import QueryStore
from rholoc.maps import load_map, map_to_bytes, save_map
from rholoc.storage import ObjectStorage

LONG = "a-long-name-without-any-blank-in-it-that-goes-on-to-sixty-four-l"
DISAGREE = (
    "Two reconstructions disagree: 3.1% of the median depth and 1.2° apart, nine in ten keyframes within 5.4%. "
    "A waypoint is missed by 0.31 m."
)
MISTAKE = "W2 seems to be mistyped: with y 2.10 instead of 1.20 m it would fit the others."
PHONE = {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def running(service, picture_world):
    """The service with a map that is not trusted, one that is, and one with the longest of names."""
    maps = service.settings.maps_dir
    held_out = {"frames": 8, "localized": 8, "median_m": 0.005, "median_deg": 0.1, "p90_m": 0.02}
    doubted = {"method": "visual", "trusted": False, "why": DISAGREE, "waypoint_mistake": MISTAKE}
    checked = {"method": "visual", "trusted": True, "why": DISAGREE.replace("disagree", "agree").split(". A")[0] + "."}
    given = {"method": "given", "trusted": True, "why": "The poses were given."}
    for name, walk in (("doubtful", doubted), ("sound", checked), ("given", given), (LONG, doubted)):
        path = maps / f"{name}.rho"
        path.write_bytes(picture_world.rho(report={"trajectories": [walk], "held_out": held_out}))
        if walk is not given:
            map_ = load_map(path)
            bent = map_.views.positions.astype(np.float32)
            bent[:, 2] += np.linspace(0, 0.8, len(bent), dtype=np.float32)
            save_map(replace(map_, views=replace(map_.views, second_positions=bent)), path)
    assert len(LONG) == 64
    return service


def test_an_untrusted_map_says_so_first(desk_browser, running, opened, settled):
    with opened(desk_browser, running.url, "maps/doubtful") as page:
        notice = settled(page).get_by_role("region", name="Trust")
        expect(notice).to_contain_text("Do not rely on this map.")
        expect(notice).to_contain_text("came out in two different shapes")
        expect(notice).to_contain_text(MISTAKE)
        expect(notice).to_contain_text("Measure that point again")
        assert "nine in ten" not in notice.locator("p").first.inner_text()
        top = notice.bounding_box()["y"]
        assert all(top < one.bounding_box()["y"] for one in page.locator("main h2").all())
        expect(page.locator("main")).to_contain_text("agrees with itself")
        expect(page.locator("main")).to_contain_text("If the walk as a whole is bent, they do not show it.")
        expect(page.get_by_text("Median error")).to_have_count(0)
        page.goto(f"{running.url}/#/maps")
        card = settled(page).locator("li.card", has=page.get_by_role("link", name="doubtful"))
        expect(card.locator(".badge").first).to_have_text("not trusted")
        expect(card).to_contain_text("two different shapes")
        expect(card).not_to_contain_text("0.5 cm")


@pytest.mark.slow
def test_a_doubted_map_shows_both_reconstructions(desk_browser, running, opened, settled):
    legend = "in a second reconstruction: where they drift apart, the map may be wrong"
    with opened(desk_browser, running.url, "maps/doubtful") as page:
        both = settled(page).get_by_role("button", name="Both reconstructions")
        expect(both).to_have_attribute("aria-pressed", "true")
        expect(page.get_by_text(legend)).to_be_visible()
        shown = page.locator(".scene-canvas").screenshot()
        both.click()
        expect(page.get_by_text(legend)).to_be_hidden()
        assert page.locator(".scene-canvas").screenshot() != shown
        page.goto(f"{running.url}/#/maps/sound")
        expect(settled(page).get_by_role("button", name="Both reconstructions")).to_have_attribute(
            "aria-pressed", "false"
        )
        page.goto(f"{running.url}/#/maps/given")
        expect(settled(page).get_by_role("button", name="Both reconstructions")).to_have_count(0)


@pytest.mark.slow
def test_a_trusted_map_and_one_of_unknown_origin(desk_browser, running, opened, settled):
    with opened(desk_browser, running.url, "maps/sound") as page:
        notice = settled(page).get_by_role("region", name="Trust")
        expect(notice).to_contain_text("This map passed its checks.")
        expect(notice).not_to_contain_text("What to do")
        assert page.locator("main h2").all_inner_texts()[:2] == ["The room", "Where it works"]
        page.goto(f"{running.url}/#/maps/given")
        notice = settled(page).get_by_role("region", name="Trust", exact=True)
        expect(notice).to_contain_text("Nothing else has checked this map")
        expect(notice).not_to_have_class(re.compile("good"))
        page.goto(f"{running.url}/#/try")
        expect(settled(page).get_by_role("combobox", name="Map")).to_have_value("sound")
        page.goto(f"{running.url}/#/maps/room")
        expect(settled(page).get_by_role("region", name="Trust")).to_contain_text("Nothing has checked this map.")


@pytest.mark.slow
def test_a_job_whose_map_is_not_trusted_is_no_success(desk_browser, running, opened, settled):
    job = {
        "id": "0" * 32, "recording": "1" * 32, "map": "hall", "state": "published", "stage": "published",
        "progress": 1, "message": "published", "log": [], "error": None, "created": 1767607200, "started": 1767607201,
        "ended": 1767607260, "attempts": 1, "priority": "normal", "kind": "build", "site": None, "trusted": False,
        "warnings": [f"The frame poses are not trusted: {DISAGREE}"],
    }  # fmt: skip
    with opened(desk_browser, running.url, "cameras", failures=-1) as page:
        page.route("**/v1/jobs", lambda route: route.fulfill(json={"jobs": [job]}))
        page.route("**/v1/jobs/*/events", lambda route: route.fulfill(body=f"data: {json.dumps(job)}\n\n"))
        page.goto(f"{running.url}/#/jobs")
        expect(page.locator("main .badge")).to_have_text("published, not trusted")
        page.get_by_role("link", name="hall").click()
        expect(page.get_by_role("alert")).to_contain_text("Do not rely on this map.")
        expect(page.get_by_role("alert")).to_contain_text("two different shapes")
        unplaced = "Nothing joins study to the others."
        job |= {"kind": "place", "site": "house", "map": "", "recording": "", "trusted": None, "warnings": [unplaced]}
        page.goto(f"{running.url}/#/jobs")
        expect(page.locator("main .badge")).to_have_text("published")
        page.get_by_role("link", name="Site house").click()
        expect(page.get_by_role("alert")).to_contain_text(unplaced)
        expect(page.get_by_role("heading", level=1)).to_have_text("Site house")
        expect(page.locator(".stages li")).to_have_text(["received", "links", "published"])
        expect(page.get_by_role("link", name="To the map")).to_have_count(0)


@pytest.mark.slow
def test_the_longest_name_fits_everywhere(desk_browser, running, opened, settled):
    with opened(desk_browser, running.url, viewport=PHONE) as page:
        for where in ("maps", f"maps/{LONG}", f"try/{LONG}", "recordings", "jobs"):
            page.goto(f"{running.url}/#/{where}")
            settled(page)
            assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), where
            assert page.evaluate(
                "[...document.querySelectorAll('main .card')].every((card) => card.scrollWidth <= card.clientWidth + 1)"
            ), where


@pytest.mark.slow
def test_deleting_does_not_offer_itself(desk_browser, running, opened, settled):
    with opened(desk_browser, running.url, "maps/sound") as page:
        settled(page).get_by_text("More", exact=True).click()
        page.get_by_role("button", name="Delete").click()
        expect(page.get_by_role("dialog").get_by_role("button", name="Cancel")).to_be_focused()
        page.keyboard.press("Enter")
        expect(page.get_by_role("dialog")).to_have_count(0)
        assert (running.settings.maps_dir / "sound.rho").exists()


@pytest.mark.slow
def test_an_upload_onto_a_map_asks_and_what_it_replaced_is_restored(
    desk_browser, running, picture_world, opened, settled, tmp_path
):
    first, second = (picture_world.rho(id=f"{number:032x}", version=number) for number in (1, 2))
    (running.settings.maps_dir / "taken.rho").write_bytes(first)
    (tmp_path / "taken.rho").write_bytes(second)
    with opened(desk_browser, running.url, "maps") as page:
        settled(page).get_by_role("button", name="Upload a map").click()
        dialog = page.get_by_role("dialog")
        dialog.get_by_label("File").set_input_files(tmp_path / "taken.rho")
        name = dialog.get_by_label("Name of the map")
        expect(name).to_have_value("taken-2")  # a free one is proposed
        name.fill("taken")
        dialog.get_by_role("button", name="Upload").click()
        expect(dialog).to_be_visible()  # the question stands
        assert httpx.get(f"{running.url}/v1/maps/taken").json()["version"] == 1
        dialog.get_by_label("The map is replaced").check()
        dialog.get_by_role("button", name="Upload").click()
        expect(dialog).to_have_count(0)
        assert httpx.get(f"{running.url}/v1/maps/taken").json()["version"] == 2
        page.goto(f"{running.url}/#/maps/taken")
        settled(page).get_by_role("button", name="Restore it").click()
        page.get_by_role("dialog").get_by_role("button", name="Restore").click()
        expect(page.get_by_role("dialog")).to_have_count(0)
        page.get_by_text("For developers").click()
        expect(page.locator(".facts", has_text="ID")).to_contain_text("00000000")
    assert httpx.get(f"{running.url}/v1/maps/taken").json()["version"] == 1


@pytest.mark.slow
def test_a_recording_for_a_map_that_exists_learns_or_replaces_only_when_asked(
    desk_browser, running, opened, settled, tmp_path
):
    (tmp_path / "room.mp4").write_bytes(b"\0\0\0\x18ftypmp42" + b"\1" * 5000)
    with opened(desk_browser, running.url, "recordings") as page:
        form = settled(page).locator("form")
        form.get_by_label("Recording").set_input_files(tmp_path / "room.mp4")
        expect(form.get_by_label("Name of the map")).to_have_value(re.compile(r"^room-\d$"))
        form.get_by_label("Name of the map").fill("room")
        form.get_by_role("button", name="Upload").click()
        expect(page.get_by_role("heading", level=1)).to_have_text("Recordings")
        expect(form.get_by_role("group", name="There is a map room")).to_be_visible()
        form.get_by_role("button", name="Use another name").click()
        expect(form.get_by_role("group")).to_have_count(0)
        form.get_by_role("button", name="Upload").click()
        expect(page.get_by_role("heading", level=1)).to_have_text(re.compile(r"Map room-\d"))


@pytest.mark.slow
def test_a_name_proposed_before_it_is_known_which_are_taken_is_proposed_anew(
    desk_browser, running, opened, settled, tmp_path
):
    (tmp_path / "room.mp4").write_bytes(b"\0\0\0\x18ftypmp42" + b"\1" * 5000)
    with opened(desk_browser, running.url, "recordings") as page:
        settled(page)
        held = []
        page.route(re.compile(r"/v1/maps$"), lambda route: held.append(route))
        page.reload()
        page.get_by_label("Recording", exact=True).set_input_files(tmp_path / "room.mp4")
        name = page.get_by_label("Name of the map")
        expect(name).to_have_value("room")
        for route in held:
            route.continue_()
        expect(name).to_have_value(re.compile(r"^room-\d$"))


def test_where_it_works_is_pointed_at_and_walked_by_keyboard(desk_browser, running, opened, settled):
    with opened(desk_browser, running.url, "maps/room") as page:
        canvas = settled(page).locator("canvas.coverage")
        expect(canvas).to_have_attribute("aria-label", re.compile(r"60 landmarks or more in \d+ %"))
        coverage = httpx.get(f"{running.url}/v1/maps/room/coverage").json()
        canvas.focus()
        page.keyboard.press("ArrowRight")
        said = page.get_by_text("landmarks in view;")
        expect(said).to_contain_text(f"looking 0°: {coverage['counts'][0][0]} landmarks")
        page.keyboard.press("PageUp")
        expect(said).to_contain_text(f"looking 30°: {coverage['counts'][0][1]} landmarks")
        camera = np.array(
            page.evaluate("async (c) => (await import('/web/console/coverage_view.js')).cameraAt(c, 0, 1)", coverage)
        )
        np.testing.assert_allclose(camera[:3, :3] @ camera[:3, :3].T, np.eye(3), atol=1e-9)
        assert np.linalg.det(camera[:3, :3]) == pytest.approx(1)
        assert np.degrees(np.arctan2(camera[1, 2], camera[0, 2])) == pytest.approx(30)


def test_maps_are_searched_and_sorted(desk_browser, running, opened, settled):
    with opened(desk_browser, running.url, "maps") as page:
        settled(page).get_by_label("Search").fill("OUBT")
        expect(page.locator("li.map-card h2")).to_have_text(["doubtful"])
        page.get_by_label("Search").fill("no such map")
        expect(page.get_by_text("No map matches.")).to_be_visible()
        page.get_by_label("Search").fill("")
        page.get_by_label("Order").select_option("those in doubt first")
        expect(page.locator("li.map-card .badge").first).to_have_text("not trusted")


@pytest.mark.slow
def test_a_server_that_stops_is_said_and_waited_for(desk_browser, running, opened, settled):
    walk = {"file": ("walk.mp4", b"\0\0\0\x18ftypmp42" + b"\0" * 5000)}
    job = httpx.post(f"{running.url}/v1/recordings", files=walk, data={"map": "attic"}).json()["job"]["id"]
    with opened(desk_browser, running.url, "maps", failures=-1) as page:
        for where in (f"jobs/{job}", "jobs"):
            page.goto(f"{running.url}/#/{where}")
            expect(page.get_by_text("attic").first).to_be_visible()
            page.route("**/v1/**", lambda route: route.abort())
            page.evaluate("dispatchEvent(new HashChangeEvent('hashchange'))")
            expect(page.get_by_role("alert")).to_contain_text("The server does not answer")
            page.unroute("**/v1/**")
            expect(page.get_by_role("alert")).to_have_count(0)
            expect(page.get_by_text("attic").first).to_be_visible()


@pytest.mark.slow
def test_a_stored_key_is_changed_and_removed(desk_browser, running, opened, settled):
    with opened(desk_browser, running.url, "maps") as page:
        button = page.get_by_role("button", name="My key")
        expect(button).to_have_count(0)
        page.evaluate("localStorage.setItem('rholoc-api-key', 'rho_first-secret')")
        page.reload()
        settled(page)
        button.click()
        expect(page.get_by_role("dialog")).to_contain_text("rho_firs…")
        page.get_by_label("Another key").fill("rho_second")
        with page.expect_navigation():
            page.get_by_role("button", name="Use this key").click()
        expect(page.get_by_role("dialog")).to_have_count(0)
        assert page.evaluate("localStorage.getItem('rholoc-api-key')") == "rho_second"
        settled(page)
        button.click()
        with page.expect_navigation():
            page.get_by_role("button", name="Remove the key").click()
        expect(button).to_have_count(0)


@pytest.mark.slow
@pytest.mark.parametrize("where", ["maps", "maps/doubtful", "try/doubtful", "recordings"])
def test_pages_with_doubts_are_accessible_at_twice_the_size(desk_browser, running, opened, settled, where):
    half = {"width": 640, "height": 425}  # 1280 × 850 at 200 %
    with opened(desk_browser, running.url, where, viewport=half, color_scheme="light") as page:
        settled(page)
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            found = Axe().run(page).response["violations"]
            serious = [one for one in found if one["impact"] in ("serious", "critical")]
            assert [(one["id"], one["nodes"][0]["html"]) for one in serious] == [], scheme
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


@pytest.mark.slow
def test_the_room_has_the_colours_of_its_pictures_and_is_clicked(desk_browser, running, picture_world, opened, settled):
    map_ = picture_world.map_
    colours = np.tile(np.array([[230, 20, 160]], np.uint8), (len(map_), 1))
    (running.settings.maps_dir / "coloured.rho").write_bytes(
        map_to_bytes(replace(map_, landmarks=replace(map_.landmarks, colours=colours)))
    )

    def painted(page) -> int:
        page.wait_for_timeout(300)
        shot = cv2.imdecode(np.frombuffer(page.locator("canvas.scene-canvas").screenshot(), np.uint8), 1)
        blue, green, red = shot.astype(int).transpose(2, 0, 1)
        return int(((red > 200) & (green < 60) & (blue > 130)).sum())

    with opened(desk_browser, running.url, "maps/coloured") as page:
        settled(page)
        assert painted(page) > 200
        page.get_by_role("button", name="Colour by uncertainty").click()
        assert painted(page) == 0
        page.get_by_role("button", name="From above").click()
        label = page.locator(".scene-waypoint", has_text="W1")  # a view is where the waypoint is
        said = page.locator(".scene-said")
        for _ in range(20):  # the label moves while the view turns
            x, y = map(float, re.findall(r"-?[\d.]+(?=px)", label.evaluate("(element) => element.style.transform")))
            page.locator("canvas.scene-canvas").click(position={"x": x, "y": y})
            page.wait_for_timeout(300)
            if said.is_visible():
                break
        expect(said).to_contain_text(re.compile(r"Picture \d of the walk, from [\d.]+, [\d.]+"))
        page.goto(f"{running.url}/#/maps/room")
        settled(page)
        expect(page.get_by_role("button", name="Colours of the pictures")).to_have_count(0)


@pytest.mark.slow
def test_a_landmark_that_is_clicked_shows_where_it_may_be_seen_from(
    desk_browser, running, picture_world, opened, settled
):
    map_ = picture_world.map_
    colours = np.tile(np.array([[230, 20, 160]], np.uint8), (len(map_), 1))
    (running.settings.maps_dir / "clicked.rho").write_bytes(
        map_to_bytes(replace(map_, landmarks=replace(map_.landmarks, colours=colours)))
    )

    def pixels(page) -> np.ndarray:
        page.wait_for_timeout(300)
        shot = cv2.imdecode(np.frombuffer(page.locator("canvas.scene-canvas").screenshot(), np.uint8), 1)
        return shot.astype(int)

    with opened(desk_browser, running.url, "maps/clicked") as page:
        settled(page)
        before = pixels(page)
        rows, columns = np.nonzero(np.abs(before - [160, 20, 230]).max(axis=2) < 20)
        middle = np.argmin(np.abs(rows - np.median(rows)) + np.abs(columns - np.median(columns)))
        with page.expect_response("**/features/*"):
            page.locator("canvas.scene-canvas").click(position={"x": int(columns[middle]), "y": int(rows[middle])})
        said = page.locator(".scene-said")
        expect(said).to_contain_text(re.compile("Landmark at"))
        expect(said).to_contain_text(re.compile(r"Seen in \d+ pictures"))
        drawn = np.abs(pixels(page) - before).max(axis=2) > 10
        assert drawn.sum() > 500  # the cone, and lines to the views


@pytest.mark.slow
def test_a_map_says_what_it_learns_from_those_who_use_it(desk_browser, serve, picture_world, opened, settled):
    learning = serve(learn=True)
    (learning.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    for place in range(3):
        QueryStore(ObjectStorage(learning.settings.data_dir)).add(
            picture_world.map_.info.id, a_query(x=place, time_s=time.time())
        )
    with opened(desk_browser, learning.url, "maps/room") as page:
        said = settled(page).locator("section", has=page.get_by_role("heading", name="Learned from"))
        expect(said).to_contain_text("It learns from those who use it: 3 queries are kept. From 30 on it can learn.")
    with opened(desk_browser, learning.url, "maps/room", locale="de-DE") as page:
        expect(settled(page).get_by_text("Sie lernt von denen, die sie benutzen: 3 Anfragen")).to_be_visible()


@pytest.mark.slow
def test_a_map_that_nobody_lets_learn_says_nothing_of_it(desk_browser, running, opened, settled):
    with opened(desk_browser, running.url, "maps/room") as page:
        expect(settled(page).get_by_role("heading", name="Learned from")).to_be_visible()
        expect(page.get_by_text("those who use it")).to_have_count(0)


def test_a_german_browser_is_spoken_to_in_german(desk_browser, running, opened, settled):
    with opened(desk_browser, running.url, "maps/doubtful", locale="de-DE") as page:
        expect(settled(page).get_by_text("Auf diese Karte ist kein Verlass.")).to_be_visible()
        assert page.evaluate("document.documentElement.lang") == "de"
        expect(page.get_by_role("link", name="Aufträge")).to_be_visible()
        page.get_by_text("Mehr", exact=True).click()
        page.get_by_role("button", name="Löschen").click()
        expect(page.get_by_role("dialog").get_by_role("button", name="Abbrechen")).to_be_focused()


@pytest.mark.slow
def test_the_next_walk_is_proposed_and_taken_up_by_the_recorder(desk_browser, running, opened, settled):
    with opened(desk_browser, running.url, "maps/room") as page:
        expect(settled(page).get_by_text("Walk here next:")).to_be_visible()
        page.get_by_role("link", name="Record it").click()
        expect(
            page.get_by_text(re.compile(r"For the map room: .* walk to about -?[\d.]+, -?[\d.]+, look"))
        ).to_be_visible()
        expect(page.get_by_label("Name of the map")).to_have_value("room")
