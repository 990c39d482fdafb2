"""The console in Chromium: what it shows, what it asks, and that it stays on its feet."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import cv2
import httpx
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect

from rholoc.maps import TrajectoryTable, trajectory_csv
from rholoc.service.guard import KeyPolicy
from rholoc.service.keys import KeyStore, Scope

DESK, PHONE = {"width": 1280, "height": 850}, {"width": 390, "height": 844}
HTML = "<img src=x onerror=\"document.title='taken over'\">"
PAGES = ["maps", "maps/room", "try/room", "jobs", "recordings", "cameras", "nothing"]
SOFTWARE_GL = "--enable-unsafe-swiftshader"
expect.set_options(timeout=20_000)


@pytest.fixture(scope="module")
def browser(launch: Callable[..., Browser]) -> Iterator[Browser]:
    browser = launch(SOFTWARE_GL)
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def named(service, picture_world):
    """The service with a map whose recording and waypoint have HTML for names, a camera, and a job."""
    waypoint = {"name": HTML, "position": [1.0, 2.0, 1.5], "residual_m": 0.012}
    content = picture_world.rho(sources=({"name": HTML, "frames": 4},), waypoints=(waypoint,))
    (service.settings.maps_dir / "strange.rho").write_bytes(content)
    camera = {"width": 640, "height": 480, "fx": 520, "fy": 520, "cx": 319.5, "cy": 239.5}
    assert httpx.put(f"{service.url}/v1/cameras/pixel", json=camera).is_success
    walk = {"file": ("walk.mp4", b"\0\0\0\x18ftypmp42" + b"\0" * 5000)}
    assert httpx.post(f"{service.url}/v1/recordings", files=walk, data={"map": "hall"}).is_success
    return service


@contextmanager
def opened(browser: Browser, url: str, where: str = "", failures: int = 0, **context) -> Iterator[Page]:
    """A page of the console; every error in Chromium's console fails the test.

    Chromium itself notes each answer of 400 and above there: the test says how many it expects (-1: any).
    """
    context = browser.new_context(**{"viewport": DESK, **context})
    page = context.new_page()
    page.set_default_timeout(20_000)
    complaints: list[str] = []
    page.on("console", lambda message: message.type in ("error", "warning") and complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(f"{url}/#/{where}")
    yield page
    context.close()
    answers = [text for text in complaints if text.startswith("Failed to load resource")]
    assert [text for text in complaints if text not in answers and "GPU stall" not in text] == []
    assert failures in (-1, len(answers)), answers


def settled(page: Page) -> Page:
    """The page once nothing is loading any more."""
    expect(page.locator("main h1, main h2").first).to_be_visible()
    expect(page.locator("main [aria-busy]")).to_have_count(0)
    return page


@pytest.mark.parametrize("where", PAGES)
@pytest.mark.parametrize(("viewport", "scheme"), [(PHONE, "light"), (DESK, "dark")], ids=["phone", "desk"])
def test_every_page_is_accessible_and_fits(browser, named, where, viewport, scheme):
    with opened(browser, named.url, where, viewport=viewport, color_scheme=scheme) as page:
        settled(page)
        found = Axe().run(page).response["violations"]
        assert [(one["id"], one["nodes"][0]["html"]) for one in found if one["impact"] in ("serious", "critical")] == []
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


@pytest.mark.parametrize("where", ["maps", "maps/room"])
def test_nothing_moves_while_a_page_loads(browser, named, where):
    with opened(browser, named.url, where) as page:
        settled(page)
        page.wait_for_timeout(300)
        shift = """() => new Promise((resolve) => new PerformanceObserver((list) => resolve(
            list.getEntries().reduce((sum, entry) => sum + entry.value, 0)
        )).observe({type: 'layout-shift', buffered: true}) || setTimeout(() => resolve(0), 300))"""
        assert page.evaluate(shift) < 0.1


def test_names_are_text(browser, named):
    with opened(browser, named.url, "maps/strange") as page:
        settled(page)
        assert page.locator("main").get_by_text(HTML).count() == 3  # the source, the waypoint's row and its label
        assert page.locator("main img[src=x]").count() == 0
        assert page.title() == "strange – rholoc"


def test_the_page_asks_once_for_a_key_that_is_good(browser, serve, picture_world):
    locked = serve(keys=KeyPolicy.ALWAYS)
    (locked.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    keys = KeyStore(locked.settings.data_dir)
    expired, good = keys.create("old", Scope.READ, lifetime_s=0), keys.create("new", Scope.READ)
    with opened(browser, locked.url, failures=-1) as page:
        for secret, told in ((expired, "asks for an API key"), (good, "expired")):
            dialog = page.get_by_role("dialog", name="API key")
            expect(dialog).to_contain_text(told)
            dialog.get_by_label("Key").fill(secret)
            dialog.get_by_role("button", name="Use this key").click()
        expect(page.get_by_role("link", name="room")).to_be_visible()
        page.reload()
        expect(page.get_by_role("link", name="room")).to_be_visible()
        expect(page.get_by_role("dialog")).to_have_count(0)
        page.goto(f"{locked.url}/#/maps/room")
        settled(page).get_by_role("button", name="Delete").click()
        page.get_by_role("dialog").get_by_role("button", name="Delete").click()
        expect(page.get_by_role("alert")).to_contain_text("admin is needed")
        keys.revoke("new")
        page.reload()
        expect(page.get_by_role("dialog", name="API key")).to_contain_text("revoked")


def test_a_map_that_was_deleted_while_it_was_open(browser, named, picture_world):
    (named.settings.maps_dir / "gone.rho").write_bytes(picture_world.rho())
    with opened(browser, named.url, "maps/gone", failures=-1) as page:
        settled(page)
        assert httpx.delete(f"{named.url}/v1/maps/gone").is_success
        page.get_by_role("button", name="Rename").click()
        page.get_by_role("dialog").get_by_role("button", name="Rename").click()
        expect(page.get_by_role("alert")).to_contain_text("There is no map")
        page.reload()
        expect(page.get_by_role("alert")).to_contain_text("There is no map")
        page.get_by_role("link", name="To the maps").click()
        expect(page.get_by_role("link", name="room")).to_be_visible()


def test_a_map_is_renamed_and_deleted_by_keyboard(browser, named, picture_world):
    (named.settings.maps_dir / "first.rho").write_bytes(picture_world.rho())
    with opened(browser, named.url, "maps/first") as page:
        settled(page).get_by_role("button", name="Rename").focus()
        page.keyboard.press("Enter")
        page.get_by_label("Name", exact=True).press("ControlOrMeta+a")
        page.keyboard.type("second")
        page.keyboard.press("Enter")
        expect(page.get_by_role("heading", level=1)).to_have_text("second")
        settled(page).get_by_role("button", name="Delete").focus()
        page.keyboard.press("Enter")
        expect(page.get_by_role("dialog")).to_be_visible()
        page.get_by_role("dialog").get_by_role("button", name="Delete").press("Enter")
        expect(page).to_have_url(re.compile("#/maps$"))
    assert not (named.settings.maps_dir / "second.rho").exists()


def test_the_map_turns_by_keyboard(browser, named):
    with opened(browser, named.url, "maps/room") as page:
        canvas = settled(page).locator("canvas.scene-canvas")
        canvas.focus()
        before = canvas.screenshot()
        for _ in range(5):
            page.keyboard.press("ArrowLeft")
        page.wait_for_timeout(200)
        assert canvas.screenshot() != before


def test_a_picture_is_localized_and_its_matches_are_drawn(browser, named, picture_world, tmp_path):
    (tmp_path / "frame.png").write_bytes(picture_world.png())
    (tmp_path / "blank.png").write_bytes(cv2.imencode(".png", np.full((480, 640), 128, np.uint8))[1].tobytes())
    with opened(browser, named.url, "try/room") as page:
        settled(page)
        page.get_by_label("Picture or trajectory").set_input_files(tmp_path / "frame.png")
        answer = page.locator(".answer")
        expect(answer).to_contain_text("localized")
        shown = re.search(r"Position(-?[\d.]+), (-?[\d.]+), (-?[\d.]+) m", answer.text_content())
        np.testing.assert_allclose([float(value) for value in shown.groups()], picture_world.pose.position, atol=0.1)
        green = """(canvas) => [...canvas.getContext('2d').getImageData(0, 0, 640, 480).data].filter(
            (red, i, data) => i % 4 == 0 && data[i + 1] > red + 80).length"""
        assert page.locator("canvas.frame").evaluate(green) > 500
        page.get_by_label("Picture or trajectory").set_input_files(tmp_path / "blank.png")
        expect(answer).to_contain_text("too blank, dark or blurred")


def test_a_picture_of_another_camera_and_a_file_that_is_none(browser, named, tmp_path):
    (tmp_path / "tall.png").write_bytes(cv2.imencode(".png", np.zeros((640, 480), np.uint8))[1].tobytes())
    (tmp_path / "text.png").write_bytes(b"no picture")
    with opened(browser, named.url, "try/room", failures=1) as page:
        take = settled(page).get_by_label("Picture or trajectory").set_input_files
        take(tmp_path / "tall.png")
        expect(page.get_by_role("alert")).to_contain_text("Choose a stored camera, or the field of view")
        page.get_by_text("Camera options").click()
        page.get_by_label("Intrinsics").select_option("by its field of view")
        take(tmp_path / "tall.png")
        expect(page.locator(".answer")).to_contain_text("no pose")
        take(tmp_path / "text.png")
        expect(page.get_by_role("alert")).to_contain_text("not a picture")


def test_a_trajectory_is_played(browser, named, picture_world, tmp_path):
    T = np.repeat(picture_world.pose.T_map_camera[None], 5, axis=0)
    T[:, 0, 3] += np.arange(5)
    times, frames = np.arange(5) / 10, np.arange(5)
    (tmp_path / "walk.csv").write_text(trajectory_csv(TrajectoryTable(times, frames, T, np.ones(5), frames)))
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with opened(browser, named.url, "try/room") as page:
        take = settled(page).get_by_label("Picture or trajectory").set_input_files
        take(tmp_path / "walk.csv")
        expect(page.locator(".answer")).to_contain_text("5 poses")
        expect(page.get_by_role("button", name="Play")).to_be_visible()  # it has come to its end
        expect(page.locator("main")).to_contain_text("0.4 s")
        take(tmp_path / "other.csv")
        expect(page.get_by_role("alert")).to_contain_text("no column timestamp")


def test_the_camera_is_localized_frame_by_frame(fake_camera, named, picture_world):
    browser = fake_camera([picture_world.image] * 10)
    with opened(browser, named.url, "try/room", permissions=["camera"]) as page:
        settled(page).get_by_role("button", name="Use the camera").click()
        expect(page.locator(".answer")).to_contain_text(
            re.compile(r"localized.*[1-9][\d.]* frames a second", re.DOTALL)
        )
        page.get_by_role("button", name="Stop the camera").click()
        expect(page.get_by_role("button", name="Use the camera")).to_be_visible()
    browser.close()


def test_a_camera_that_is_refused_is_told(browser, named):
    with opened(browser, named.url, "try/room") as page:
        settled(page).get_by_role("button", name="Use the camera").click()
        expect(page.get_by_role("alert")).to_contain_text(re.compile("camera was (refused|found)|No camera"))


def test_a_job_is_cancelled_and_tried_again(browser, named):
    with opened(browser, named.url, "jobs") as page:
        page.get_by_role("link", name="hall").first.click()
        page.get_by_role("button", name="Cancel").click()
        expect(page.locator("main .badge")).to_have_text("cancelled")
        page.get_by_role("button", name="Try again").click()
        expect(page.locator("main .badge")).to_have_text("queued")


def test_a_recording_is_uploaded(browser, named, tmp_path):
    (tmp_path / "stairs.mp4").write_bytes(b"\0\0\0\x18ftypmp42" + b"\1" * 5_000_000)
    with opened(browser, named.url, "recordings") as page:
        form = settled(page).locator("form")
        form.get_by_label("Recording").set_input_files(tmp_path / "stairs.mp4")
        form.get_by_label("Map", exact=True).fill("stairs")
        form.get_by_role("button", name="Upload").click()
        expect(page.get_by_role("heading", level=1)).to_have_text("Map stairs")
    listed = httpx.get(f"{named.url}/v1/recordings").json()["recordings"]
    assert [5_000_012, ["stairs.mp4"]] in [[one["size_bytes"], one["files"]] for one in listed]


def test_a_server_that_is_gone_is_told_and_tried_again(browser, named):
    with opened(browser, named.url, "cameras", failures=-1) as page:
        settled(page)
        page.route("**/v1/**", lambda route: route.abort())
        page.get_by_role("link", name="Maps").click()
        expect(page.get_by_role("alert")).to_contain_text("The server does not answer")
        page.unroute("**/v1/**")
        page.get_by_role("button", name="Try again").click()
        expect(page.get_by_role("link", name="room")).to_be_visible()


def test_the_description_of_the_api_needs_no_other_server(browser, named):
    with opened(browser, named.url) as page:
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.goto(f"{named.url}/docs")
        expect(page.get_by_text("/v1/maps/{map_name}/localize").first).to_be_visible()
        assert [url for url in asked if not url.startswith((named.url, "data:"))] == []
