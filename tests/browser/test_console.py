"""The console in Chromium: what it shows, what it asks, and that it stays on its feet."""

import json
import re
import time

import cv2
import httpx
import numpy as np
import pytest
from playwright.sync_api import expect

from rholoc.maps import TrajectoryTable, trajectory_csv
from rholoc.maps.info import Source
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.settings import KeyPolicy

HTML = "<img src=x onerror=\"document.title='taken over'\">"


@pytest.fixture(scope="module")
def named(service, picture_world):
    """The service with a map whose recording and waypoint have HTML for names, a camera, and a job."""
    waypoint = {"name": HTML, "position": [1.0, 2.0, 1.5], "residual_m": 0.012}
    content = picture_world.rho(sources=(Source(HTML, frames=4),), waypoints=(waypoint,))
    (service.settings.maps_dir / "strange.rho").write_bytes(content)
    camera = {"width": 640, "height": 480, "fx": 520, "fy": 520, "cx": 319.5, "cy": 239.5}
    assert httpx.put(f"{service.url}/v1/cameras/pixel", json=camera).is_success
    walk = {"file": ("walk.mp4", b"\0\0\0\x18ftypmp42" + b"\0" * 5000)}
    assert httpx.post(f"{service.url}/v1/recordings", files=walk, data={"map": "hall"}).is_success
    return service


@pytest.mark.parametrize("where", ["maps", pytest.param("maps/room", marks=pytest.mark.slow)])
def test_nothing_moves_while_a_page_loads(desk_browser, named, where, opened, settled):
    with opened(desk_browser, named.url, where) as page:
        settled(page)
        page.wait_for_timeout(300)
        shift = """() => new Promise((resolve) => new PerformanceObserver((list) => resolve(
            list.getEntries().reduce((sum, entry) => sum + entry.value, 0)
        )).observe({type: 'layout-shift', buffered: true}) || setTimeout(() => resolve(0), 300))"""
        assert page.evaluate(shift) < 0.1


def test_names_are_text(desk_browser, named, opened, settled):
    with opened(desk_browser, named.url, "maps/strange") as page:
        settled(page)
        expect(page.locator("main").get_by_text(HTML)).to_have_count(3)  # the source, the waypoint's row and its label
        expect(page.locator("main img[src=x]")).to_have_count(0)
        assert page.title() == "strange – rholoc"


@pytest.mark.slow
def test_the_page_asks_once_for_a_key_that_is_good(desk_browser, serve, picture_world, opened, settled):
    locked = serve(keys=KeyPolicy.ALWAYS)
    (locked.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    keys = KeyStore(locked.settings.data_dir)
    expired, good = keys.create("old", Scope.READ, lifetime_s=0), keys.create("new", Scope.READ)
    with opened(desk_browser, locked.url, failures=-1) as page:
        for secret, reply in ((expired, "requires an API key"), (good, "expired")):
            dialog = page.get_by_role("dialog", name="API key")
            expect(dialog).to_contain_text(reply)
            dialog.get_by_label("Key").fill(secret)
            dialog.get_by_role("button", name="Use this key").click()
        expect(page.get_by_role("link", name="room")).to_be_visible()
        page.reload()
        expect(page.get_by_role("link", name="room")).to_be_visible()
        expect(page.get_by_role("dialog")).to_have_count(0)
        page.goto(f"{locked.url}/#/maps/room")
        settled(page).get_by_text("More", exact=True).click()
        page.get_by_role("button", name="Delete").click()
        page.get_by_role("dialog").get_by_role("button", name="Delete").click()
        expect(page.get_by_role("dialog", name="API key")).to_contain_text("admin is needed")
        page.get_by_role("dialog", name="API key").get_by_role("button", name="Cancel").click()
        expect(page.get_by_role("alert")).to_contain_text("admin is needed")
        page.get_by_role("dialog").get_by_role("button", name="Cancel").click()
        keys.revoke("new")
        page.reload()
        expect(page.get_by_role("dialog", name="API key")).to_contain_text("revoked")


@pytest.mark.slow
def test_a_map_that_was_deleted_while_it_was_open(desk_browser, named, picture_world, opened, settled):
    (named.settings.maps_dir / "gone.rho").write_bytes(picture_world.rho())
    with opened(desk_browser, named.url, "maps/gone", failures=-1) as page:
        settled(page).get_by_text("More", exact=True).click()
        page.get_by_role("button", name="Rename").click()
        assert httpx.delete(f"{named.url}/v1/maps/gone").is_success
        page.get_by_role("dialog").get_by_role("button", name="Rename").click()
        expect(page.get_by_role("dialog").get_by_role("alert")).to_contain_text("There is no map")
        page.reload()
        expect(page.get_by_role("alert")).to_contain_text("There is no map")
        page.get_by_role("link", name="To the maps").click()
        expect(page.get_by_role("link", name="room")).to_be_visible()


@pytest.mark.slow
def test_a_map_is_renamed_and_deleted_by_keyboard(desk_browser, named, picture_world, opened, settled):
    (named.settings.maps_dir / "first.rho").write_bytes(picture_world.rho())
    with opened(
        desk_browser, named.url, "maps/first", failures=-1
    ) as page:  # what is asked as a name goes is not found
        settled(page).get_by_text("More", exact=True).press("Enter")
        page.get_by_role("button", name="Rename").focus()
        page.keyboard.press("Enter")
        page.get_by_label("Name", exact=True).press("ControlOrMeta+a")
        page.keyboard.type("second")
        page.keyboard.press("Enter")
        expect(page.get_by_role("heading", level=1)).to_have_text("second")
        settled(page).get_by_text("More", exact=True).press("Enter")
        page.get_by_role("button", name="Delete").focus()
        page.keyboard.press("Enter")
        expect(page.get_by_role("dialog")).to_be_visible()
        page.get_by_role("dialog").get_by_role("button", name="Delete").press("Enter")
        expect(page).to_have_url(re.compile("#/maps$"))
    assert not (named.settings.maps_dir / "second.rho").exists()


@pytest.mark.slow
def test_the_map_turns_by_keyboard(desk_browser, named, opened, settled):
    with opened(desk_browser, named.url, "maps/room") as page:
        canvas = settled(page).locator("canvas.scene-canvas")
        canvas.focus()
        before = canvas.screenshot()
        for _ in range(5):
            page.keyboard.press("ArrowLeft")
        page.wait_for_timeout(200)
        assert canvas.screenshot() != before


def test_a_picture_is_localized_and_its_matches_are_drawn(
    desk_browser, named, picture_world, tmp_path, opened, settled
):
    (tmp_path / "frame.png").write_bytes(picture_world.png())
    (tmp_path / "blank.png").write_bytes(cv2.imencode(".png", np.full((480, 640), 128, np.uint8))[1].tobytes())
    with opened(desk_browser, named.url, "try/room") as page:
        settled(page)
        page.get_by_label("Picture, video or trajectory").set_input_files(tmp_path / "frame.png")
        answer = page.locator(".answer")
        expect(answer).to_contain_text("localized")
        shown = re.search(r"Position(-?[\d.]+), (-?[\d.]+), (-?[\d.]+) m", answer.text_content())
        np.testing.assert_allclose([float(value) for value in shown.groups()], picture_world.pose.position, atol=0.1)
        green = """(canvas) => [...canvas.getContext('2d').getImageData(0, 0, 640, 480).data].filter(
            (red, i, data) => i % 4 == 0 && data[i + 1] > red + 80).length"""
        assert page.locator("canvas.frame").evaluate(green) > 500
        page.get_by_label("Picture, video or trajectory").set_input_files(tmp_path / "blank.png")
        expect(answer).to_contain_text("hardly anything but a bare surface")


def test_a_trajectory_is_played(desk_browser, named, picture_world, tmp_path, opened, settled):
    T = np.repeat(picture_world.pose.T_map_camera[None], 5, axis=0)
    T[:, 0, 3] += np.arange(5)
    times, frames = np.arange(5) / 10, np.arange(5)
    (tmp_path / "walk.csv").write_text(trajectory_csv(TrajectoryTable(times, frames, T, np.ones(5), frames)))
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with opened(desk_browser, named.url, "try/room") as page:
        take = settled(page).get_by_label("Picture, video or trajectory").set_input_files
        take(tmp_path / "walk.csv")
        expect(page.locator(".answer")).to_contain_text("5 poses")
        expect(page.get_by_role("button", name="Play")).to_be_visible()  # it has come to its end
        expect(page.locator("main")).to_contain_text("0.4 s")
        take(tmp_path / "other.csv")
        expect(page.get_by_role("alert")).to_contain_text("no column timestamp")


def test_the_camera_is_localized_frame_by_frame(fake_camera, named, picture_world, opened, settled):
    browser = fake_camera([picture_world.image] * 10)
    with opened(browser, named.url, "try/room", permissions=["camera"]) as page:
        settled(page).get_by_label("track from frame to frame").uncheck()
        page.get_by_role("button", name="Use the camera").click()
        expect(page.locator(".answer")).to_contain_text(
            re.compile(r"localized.*[1-9][\d.]* frames a second", re.DOTALL)
        )
        page.get_by_role("button", name="Stop the camera").click()
        expect(page.get_by_role("button", name="Use the camera")).to_be_visible()
    browser.close()


@pytest.mark.slow
def test_a_camera_that_is_refused_is_reported(desk_browser, named, opened, settled):
    with opened(desk_browser, named.url, "try/room") as page:
        settled(page).get_by_role("button", name="Use the camera").click()
        expect(page.get_by_role("alert")).to_contain_text(re.compile("camera was refused|There is no camera"))


def test_a_job_is_cancelled_and_tried_again(desk_browser, named, opened):
    with opened(desk_browser, named.url, "jobs") as page:
        page.get_by_role("link", name="hall").first.click()
        page.get_by_role("button", name="Cancel").click()
        expect(page.locator("main .badge")).to_have_text("cancelled")
        page.get_by_role("button", name="Try again").click()
        expect(page.locator("main .badge")).to_have_text("queued")
        with page.expect_response(lambda answer: answer.request.method == "PATCH"):
            page.get_by_label("Priority").select_option("high")
        expect(page.get_by_label("Priority")).to_have_value("high")
        newest = httpx.get(f"{named.url}/v1/jobs").json()["jobs"][0]
        assert (newest["map"], newest["priority"]) == ("hall", "high")


@pytest.mark.slow
def test_a_running_job_says_what_it_does_and_how_long_that_takes(desk_browser, named, opened):
    job = httpx.get(f"{named.url}/v1/jobs").json()["jobs"][0]
    running = {"state": "running", "stage": "poses", "progress": 0.4, "message": "", "started": time.time() - 70}
    job |= running | {"error": None, "ended": None}
    with opened(desk_browser, named.url) as page:
        page.route("**/v1/jobs", lambda route: route.fulfill(json={"jobs": [job], "more": False}))
        page.route("**/v1/jobs/*/events", lambda route: route.fulfill(body=f"data: {json.dumps(job)}\n\n"))
        page.route(f"**/v1/jobs/{job['id']}", lambda route: route.fulfill(json=job))
        page.goto(f"{named.url}/#/jobs")
        expect(page.locator("main li")).to_contain_text("Finding where each picture was taken – about 2 minutes left")
        page.goto(f"{named.url}/#/jobs/{job['id']}")
        expect(page.locator("main")).to_contain_text("about 2 minutes left")
        expect(page.locator("main")).to_contain_text("You may close this page")


def test_a_recording_is_uploaded(desk_browser, named, tmp_path, opened, settled):
    (tmp_path / "stairs.mp4").write_bytes(b"\0\0\0\x18ftypmp42" + b"\1" * 5_000_000)
    with opened(desk_browser, named.url, "recordings") as page:
        form = settled(page).locator("form")
        form.get_by_label("Recording").set_input_files(tmp_path / "stairs.mp4")
        form.get_by_label("Name of the map").fill("stairs")
        form.get_by_role("button", name="Upload").click()
        expect(page.get_by_role("heading", level=1)).to_have_text("Map stairs")
    listed = httpx.get(f"{named.url}/v1/recordings").json()["recordings"]
    assert [5_000_012, ["stairs.mp4"]] in [[one["size_bytes"], one["files"]] for one in listed]


@pytest.mark.slow
def test_a_server_that_is_gone_is_reported_and_tried_again(desk_browser, named, opened, settled):
    with opened(desk_browser, named.url, "cameras", failures=-1) as page:
        settled(page)
        page.route("**/v1/**", lambda route: route.abort())
        page.get_by_role("link", name="Maps").click()
        expect(page.get_by_role("alert")).to_contain_text("The server does not answer")
        expect(page.get_by_role("button", name="Try again")).to_be_visible()
        page.unroute("**/v1/**")  # and then nobody does anything
        expect(page.get_by_role("link", name="room")).to_be_visible()


@pytest.mark.slow
def test_the_description_of_the_api_needs_no_other_server(desk_browser, named, opened):
    with opened(desk_browser, named.url) as page:
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.goto(f"{named.url}/docs")
        expect(page.get_by_text("/v1/maps/{map_name}/localize").first).to_be_visible()
        assert [url for url in asked if not url.startswith((named.url, "data:"))] == []
