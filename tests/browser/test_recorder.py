"""The recorder as a person uses it, on a fake phone: recordings arrive whole, and whatever goes wrong is reported."""

import hashlib
import json
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect
from typer.testing import CliRunner

from rholoc.cli import app
from rholoc.recordings import read_recording
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.settings import KeyPolicy

PHONE = {"width": 390, "height": 844}
ON_A_PHONE = {"viewport": PHONE, "has_touch": True, "reduced_motion": "reduce"}
SENSORS = ("accelerometer", "gyroscope", "magnetometer")
LONG_MS = 60_000

MOTION = """({hz, rotationRate}) => {
    clearInterval(window.fakeMotion);
    window.fakeMotion = setInterval(() => dispatchEvent(new DeviceMotionEvent("devicemotion", {
        accelerationIncludingGravity: {x: 0.2, y: 9.8, z: 0.4}, rotationRate, interval: 1000 / hz})), 1000 / hz);
}"""


@pytest.fixture(scope="module")
def running(serve: Callable[..., Any]) -> Any:
    """A service without a worker: what it gets stays as it came."""
    return serve()


@pytest.fixture
def phone(phone_browser: Browser) -> Iterator[Callable[..., Page]]:
    """Opens the recorder of a service on a phone without history."""
    opened = []

    def open_page(url: str, permissions: tuple[str, ...] = ("camera", *SENSORS)) -> Page:
        context = phone_browser.new_context(**ON_A_PHONE, permissions=list(permissions))
        opened.append(context)
        page = context.new_page()
        page.set_default_timeout(LONG_MS)
        page.goto(f"{url}/record")
        return page

    yield open_page
    for context in opened:
        context.close()


def move(page: Page, hz: float = 60, **rates: float | None) -> None:
    """Motion events from now on; rates in degrees a second."""
    page.evaluate(MOTION, {"hz": hz, "rotationRate": {"alpha": 2, "beta": 3, "gamma": 1, **rates}})


def hold_key(page: Page, key: str) -> None:
    """Store a key in the phone's browser."""
    page.evaluate("(key) => localStorage.setItem('rholoc-api-key', key)", key)


def open_camera(page: Page) -> None:
    page.get_by_role("button", name="Open the camera").click()
    expect(page.get_by_role("button", name="Record", exact=True)).to_be_enabled(timeout=LONG_MS)


def record(page: Page, seconds: float) -> None:
    page.get_by_role("button", name="Record", exact=True).click()
    page.wait_for_timeout(1000 * seconds)
    stop = page.get_by_role("button", name="Stop")
    stop.click()
    expect(page.get_by_role("heading", name="Your recording")).to_be_visible(timeout=LONG_MS)


def recording_that_came(running: Any) -> Path:
    """The file of the newest recording."""
    files = list((running.settings.data_dir / "recordings").glob("*/*.zip"))
    return max(files, key=lambda path: path.stat().st_mtime)


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.slow
def test_a_recording_arrives_whole_through_a_lost_connection_and_a_reload(running, phone, wire, tmp_path):
    line = wire(running.address)
    page = phone(line.url)
    page.evaluate("navigator.serviceWorker.ready.then(() => {})")
    page.get_by_label("Name of the map").fill("hall")
    page.get_by_text("Measured points").click()
    for name, position in {"W1": "0 0 1.5", "W2": "2 0 1.5", "W3": "2 3,5 1.5", "E": "-1 2 1.5"}.items():
        for axis, value in zip("xyz", position.split(), strict=True):
            page.get_by_label(f"{axis} of {name} in metres").fill(value)
    open_camera(page)
    move(page)
    page.get_by_role("button", name="Record", exact=True).click()
    for _ in range(4):
        page.wait_for_timeout(1500)
        page.locator("button.waypoint").click()
    page.get_by_role("button", name="Stop").click()
    expect(page.get_by_role("heading", name="Your recording")).to_be_visible()
    with page.expect_download() as download:
        page.get_by_role("button", name="Save as a file").click()
    download.value.save_as(tmp_path / "saved.zip")

    line.cut_after((tmp_path / "saved.zip").stat().st_size // 3)
    page.get_by_role("button", name="Send").click()
    expect(page.get_by_text("The server cannot be reached.")).to_be_visible()
    page.reload()  # without a connection: the page is kept on the phone
    expect(page.get_by_text("The server cannot be reached.")).to_be_visible()
    sent = line.sent
    line.mend()
    expect(page.get_by_role("heading", name="The server makes the map")).to_be_visible()
    assert page.get_by_text("Received").get_attribute("aria-current") == "step"
    came = recording_that_came(running)
    assert digest(came) == digest(tmp_path / "saved.zip")
    assert line.sent - sent < 0.8 * came.stat().st_size  # it went on, and did not begin again

    info = CliRunner().invoke(app, ["recording", "info", str(came), "--json"])
    assert info.exit_code == 0
    assert json.loads(info.stdout)["format"] == "rholoc"
    walk = read_recording(came)
    assert [one.name for one in walk.waypoints] == ["W1", "W2", "W3", "E"]
    assert walk.waypoints[2].position == (2.0, 3.5, 1.5)
    assert np.diff([one.time for one in walk.waypoints]) == pytest.approx(1.5, abs=1)
    assert walk.frames.size == (640, 480)
    assert walk.frames.times[0] == 0
    assert walk.imu.includes_gravity
    assert walk.imu.times[0] < 1
    assert walk.imu.times[-1] == pytest.approx(walk.frames.times[-1], abs=1.5)
    np.testing.assert_allclose(walk.imu.acceleration, np.tile([0.2, 9.8, 0.4], (len(walk.imu.times), 1)))
    np.testing.assert_allclose(walk.imu.angular_velocity[0], np.radians([2, 3, 1]))
    page.get_by_role("link", name="Record", exact=True).click()
    expect(page.get_by_text("sent", exact=True)).to_be_visible()


@pytest.mark.slow
def test_an_upload_cut_five_times_goes_on_from_what_the_server_has(running, phone, wire):
    """60 MB; after each cut the next piece begins where the server stands, and in the end the bytes are the same."""
    line = wire(running.address)
    page = phone(line.url)
    pieces: list[tuple[str, int]] = []
    page.on("request", lambda one: pieces.append((one.method, int(one.headers.get("upload-offset", -1)))))
    acknowledged: list[int] = []
    page.on("response", lambda one: acknowledged.append(int(one.headers.get("upload-offset", -1))))
    size = page.evaluate(
        """async () => {
            const {zip, crc32} = await import("/web/record/zip.js");
            const {Client} = await import("/js/client.js");
            const bytes = new Uint8Array(60e6);
            for (let at = 0; at < bytes.length; at += 65536) crypto.getRandomValues(bytes.subarray(at, at + 65536));
            bytes.set([0x1a, 0x45, 0xdf, 0xa3]);  // what every WebM begins with
            window.file = zip([{name: "video.webm", blob: new Blob([bytes]), crc: crc32(bytes)}], new Date(0));
            const rholoc = new Client(location.origin);
            window.ended = rholoc.upload(file, {name: "big.zip", map: "big", kind: "build", tries: Infinity});
            return file.size;
        }"""
    )
    for cut in range(5):
        line.cut_after(9_000_000)
        deadline = time.monotonic() + 60
        while line.up:
            assert time.monotonic() < deadline, f"cut {cut} did not come"
            page.wait_for_timeout(50)
        page.wait_for_timeout(300)
        line.mend()
    page.evaluate("window.ended")
    came = recording_that_came(running)
    expected = page.evaluate(
        """async () => Array.from(new Uint8Array(await crypto.subtle.digest("SHA-256", await file.arrayBuffer())),
            (byte) => byte.toString(16).padStart(2, "0")).join("")"""
    )
    assert digest(came) == expected
    offsets = [offset for method, offset in pieces if method == "PATCH"]
    assert offsets == sorted(offsets)
    assert set(offsets) <= {0, *acknowledged}
    assert max(acknowledged) == size


@pytest.mark.slow
def test_a_server_that_restarts_in_mid_upload_gets_the_rest(serve, phone, wire):
    before = serve()
    line = wire(before.address)
    page = phone(line.url)
    open_camera(page)
    move(page)
    record(page, 5.5)
    expect(page.get_by_role("region", name="Seconds that will fail")).to_have_count(0)
    line.cut_after(300_000)
    page.get_by_role("button", name="Send").click()
    expect(page.get_by_text("The server cannot be reached.")).to_be_visible()
    after = serve(data_dir=before.settings.data_dir, maps_dir=before.settings.maps_dir)
    line.target = after.address
    line.mend()
    expect(page.get_by_role("heading", name="The server makes the map")).to_be_visible()
    assert read_recording(recording_that_came(before)).imu is not None


@pytest.mark.slow
def test_a_refused_key_keeps_the_recording_and_another_sends_it(serve, phone):
    running = serve(keys=KeyPolicy.ALWAYS)
    keys = KeyStore(running.settings.data_dir)
    old, new = keys.create("old", Scope.MAP, lifetime_s=0.01), keys.create("new", Scope.MAP)
    page = phone(running.url)
    hold_key(page, new)
    open_camera(page)
    record(page, 5.5)
    hold_key(page, old)
    page.get_by_role("button", name="Send").click()
    page.get_by_role("dialog").get_by_role("button", name="Cancel").click()
    expect(page.get_by_role("heading", name="It could not be sent")).to_be_visible()
    expect(page.get_by_text("still on this phone")).to_be_visible()
    page.get_by_role("link", name="Later").click()
    page.get_by_role("link", name="Go on sending").click()
    page.get_by_role("textbox", name="Key").fill(old)
    page.get_by_role("button", name="Use this key").click()
    expect(page.get_by_text("This API key has expired.")).to_be_visible()
    page.get_by_role("textbox", name="Key").fill(new)
    page.get_by_role("button", name="Use this key").click()
    expect(page.get_by_role("heading", name="The server makes the map")).to_be_visible()
    page.get_by_role("button", name="Cancel").click()
    expect(page.get_by_role("heading", name="The job was cancelled")).to_be_visible()


def test_a_camera_that_is_refused_is_reported_with_what_to_do(running, phone):
    page = phone(running.url)
    page.evaluate(
        """() => {
            navigator.mediaDevices.getUserMedia = async () => { throw new DOMException("no", "NotAllowedError"); };
        }"""
    )
    page.get_by_role("button", name="Open the camera").click()
    expect(page.get_by_role("heading", name="The camera was refused.")).to_be_visible()
    expect(page.get_by_role("alert")).to_contain_text("browser's settings")


@pytest.mark.slow
def test_refused_sensors_leave_video_alone(running, phone):
    page = phone(running.url, permissions=("camera",))
    page.get_by_role("button", name="Open the camera").click()
    expect(page.get_by_role("heading", name="The motion sensors were refused.")).to_be_visible()
    page.get_by_role("button", name="Record video alone").click()
    expect(page.get_by_text("No motion sensors: video only")).to_be_visible()


@pytest.mark.slow
def test_a_missing_gyroscope_and_slow_sensors_are_reported(running, phone):
    page = phone(running.url)
    open_camera(page)
    move(page, alpha=None, beta=None, gamma=None)
    expect(page.get_by_text("No gyroscope: video only")).to_be_visible()
    move(page, hz=10)
    expect(page.locator(".advice")).to_contain_text("25 are needed")
    expect(page.locator(".readings .badge.warn")).to_contain_text("Hz")
    move(page, beta=90)
    expect(page.locator(".advice")).to_contain_text("Turn more slowly")


@pytest.mark.slow
def test_a_page_in_the_background_ends_its_recording_and_keeps_it(running, phone):
    page = phone(running.url)
    open_camera(page)
    page.get_by_role("button", name="Record", exact=True).click()
    page.wait_for_timeout(2000)
    page.evaluate(
        """Object.defineProperty(document, "hidden", {value: true});
        document.dispatchEvent(new Event("visibilitychange"));"""
    )
    expect(page.get_by_text("ended when you left this page")).to_be_visible()
    expect(page.locator(".facts")).to_contain_text(re.compile(r"Length0:0[1-9]"))


@pytest.mark.slow
def test_a_phone_turned_in_mid_recording_ends_it_and_keeps_it(running, phone):
    page = phone(running.url)
    open_camera(page)
    page.get_by_role("button", name="Record", exact=True).click()
    page.wait_for_timeout(2000)
    page.context.new_cdp_session(page).send(
        "Emulation.setDeviceMetricsOverride",
        {
            "width": 844,
            "height": 390,
            "deviceScaleFactor": 1,
            "mobile": True,
            "screenOrientation": {"type": "landscapePrimary", "angle": 90},
        },
    )
    expect(page.get_by_text("ended when the phone was turned")).to_be_visible()


@pytest.mark.slow
def test_a_full_phone_ends_the_recording_and_keeps_what_came_before(running, phone):
    page = phone(running.url)
    devtools = page.context.new_cdp_session(page)
    devtools.send("Storage.overrideQuotaForOrigin", {"origin": running.url, "quotaSize": 2_500_000})
    page.reload()
    open_camera(page)
    page.get_by_role("button", name="Record", exact=True).click()
    expect(page.get_by_text("this phone has no space left")).to_be_visible(timeout=LONG_MS)
    expect(page.locator(".facts")).to_contain_text(re.compile(r"Length0:0[1-9]"))
    page.get_by_role("link", name="Later").click()
    expect(page.get_by_role("link", name="Look at it")).to_be_visible()


@pytest.mark.slow
def test_little_storage_is_reported_beforehand(running, phone):
    page = phone(running.url)
    page.add_init_script("navigator.storage.estimate = async () => ({quota: 3e8, usage: 2e8})")
    page.reload()
    expect(page.get_by_text("This phone's storage is almost full: 100 MB left")).to_be_visible()


@pytest.mark.slow
def test_a_reload_in_mid_recording_keeps_what_came_before(running, phone):
    page = phone(running.url)
    open_camera(page)
    move(page)
    page.get_by_role("button", name="Record", exact=True).click()
    page.wait_for_timeout(7000)
    page.goto(f"{running.url}/record")
    page.get_by_role("link", name="Look at it").click()
    expect(page.get_by_text("Recording broke off.")).to_be_visible()
    page.get_by_role("button", name="Send").click()
    expect(page.get_by_role("heading", name="The server makes the map")).to_be_visible()
    walk = read_recording(recording_that_came(running))
    assert walk.frames.times[-1] > 2


def test_a_page_without_https_says_what_is_missing(serve, phone):
    port = serve(keys=KeyPolicy.NEVER).address[1]
    page = phone(f"http://rholoc.test:{port}", permissions=())
    expect(page.get_by_role("alert")).to_contain_text("camera app and upload the video")
    expect(page.get_by_role("alert")).to_contain_text("rholoc serve --tls")
    expect(page.get_by_role("link", name="Upload a walk")).to_have_attribute("href", "./#/recordings")
    expect(page.get_by_role("button", name="Open the camera")).to_be_disabled()


@pytest.mark.slow
def test_two_seconds_are_too_short_to_be_sent_and_are_deleted_only_after_asking(running, phone):
    page = phone(running.url)
    open_camera(page)
    record(page, 2)
    expect(page.get_by_role("alert")).to_contain_text("too short for a map")
    expect(page.get_by_role("button", name="Send")).to_be_disabled()
    page.get_by_role("link", name="Later").click()
    page.get_by_role("button", name="Delete").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(page.get_by_role("link", name="Look at it")).to_have_count(0)
    page.reload()
    expect(page.get_by_role("heading", name="Record a walk")).to_be_visible()
    expect(page.get_by_role("link", name="Look at it")).to_have_count(0)


@pytest.mark.slow
@pytest.mark.parametrize(("viewport", "scheme"), [(PHONE, "light"), ({"width": 1280, "height": 800}, "dark")])
def test_every_view_is_accessible_and_fits_and_nothing_complains(running, phone, viewport, scheme):
    page = phone(running.url)
    page.set_viewport_size(viewport)
    page.emulate_media(color_scheme=scheme)
    complaints: list[str] = []
    page.on("console", lambda message: message.type in ("error", "warning") and complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))

    def check() -> None:
        found = Axe().run(page).response["violations"]
        serious = [one for one in found if one["impact"] in ("serious", "critical")]
        assert [(one["id"], one["nodes"][0]["html"]) for one in serious] == []
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")

    page.get_by_text("Measured points").click()
    check()
    open_camera(page)
    move(page, beta=90)
    expect(page.locator(".advice")).not_to_be_empty()
    check()
    page.get_by_role("button", name="Record", exact=True).click()
    page.wait_for_timeout(5500)
    page.get_by_role("button", name="W1").click()
    page.get_by_role("button", name="Points").click()
    check()
    page.get_by_role("button", name="Done").click()
    page.get_by_role("button", name="Stop").click()
    expect(page.get_by_role("heading", name="Your recording")).to_be_visible()
    check()
    page.get_by_role("button", name="Send").click()
    expect(page.get_by_role("heading", name="The server makes the map")).to_be_visible()
    check()
    page.get_by_role("link", name="Record", exact=True).click()
    expect(page.get_by_text("sent", exact=True)).to_be_visible()
    check()
    assert complaints == []


@pytest.mark.slow
def test_the_page_can_be_installed(running, phone):
    page = phone(running.url)
    page.evaluate("navigator.serviceWorker.ready.then(() => {})")
    devtools = page.context.new_cdp_session(page)
    manifest = devtools.send("Page.getAppManifest")
    assert manifest["errors"] == []
    assert manifest["url"].endswith("/web/record/manifest.webmanifest")
    problems = devtools.send("Page.getInstallabilityErrors")["installabilityErrors"]
    assert [one["errorId"] for one in problems] in ([], ["in-incognito"])


@pytest.mark.slow
def test_a_bare_wall_a_blur_and_standing_are_said_while_recording_and_before_sending(running, fake_camera):
    rng = np.random.default_rng(3)
    wall = np.full((480, 640, 3), 190, np.uint8)
    wall = np.clip(wall + rng.normal(0, 4, wall.shape), 0, 255).astype(np.uint8)
    sharp = np.repeat(rng.integers(40, 215, (60, 80, 1), dtype=np.uint8), 3, axis=2).repeat(8, 0).repeat(8, 1)
    for picture, advice, flaw in (
        (wall, "Nothing to recognise here", "nothing to recognise"),
        (cv2.GaussianBlur(sharp, (0, 0), 8), "Blurred", "blurred"),
    ):
        browser = fake_camera([picture] * 10)
        context = browser.new_context(**ON_A_PHONE, permissions=["camera", *SENSORS])
        page = context.new_page()
        page.set_default_timeout(LONG_MS)
        page.goto(f"{running.url}/record")
        open_camera(page)
        move(page)
        expect(page.locator(".advice")).to_contain_text(advice)
        record(page, 5.5)
        section = page.get_by_role("region", name="Seconds that will fail")
        expect(section).to_contain_text("better walk again")
        expect(section.get_by_role("button").first).to_contain_text(flaw)
        section.get_by_role("button").first.click()
        browser.close()
    browser = fake_camera([sharp] * 10)
    page = browser.new_context(**ON_A_PHONE, permissions=["camera", *SENSORS]).new_page()
    page.set_default_timeout(LONG_MS)
    page.goto(f"{running.url}/record")
    open_camera(page)
    page.get_by_role("button", name="Record", exact=True).click()
    expect(page.locator(".advice")).to_have_text("Nothing new in view. Walk on.", timeout=LONG_MS)
    page.get_by_role("button", name="Stop").click()
    expect(page.locator(".doubts")).to_contain_text("it stood still")
    browser.close()


def test_a_double_tap_marks_one_point_and_an_added_one_stands_before_the_end(running, phone):
    page = phone(running.url)
    open_camera(page)
    page.get_by_role("button", name="Record", exact=True).click()
    page.wait_for_timeout(500)
    page.locator("button.waypoint").dblclick()
    expect(page.locator("button.waypoint strong")).to_have_text("W2")
    page.get_by_role("button", name="Points (1)").click()
    page.get_by_role("button", name="Add a point").click()
    names = page.get_by_label("Name of point").all()
    assert [one.input_value() for one in names] == ["W1", "W2", "W3", "W4", "E"]


@pytest.mark.slow
def test_a_name_that_a_map_has_is_asked_about_before_it_is_sent(serve, phone, picture_world):
    running = serve()
    (running.settings.maps_dir / "hall.rho").write_bytes(picture_world.rho())
    page = phone(running.url)
    page.get_by_label("Name of the map").fill("hall")
    open_camera(page)
    record(page, 5.5)
    page.get_by_role("button", name="Send").click()
    expect(page.get_by_role("heading", name="Your recording")).to_be_visible()
    page.get_by_label("The map learns it").check()
    page.get_by_role("button", name="Send").click()
    expect(page.get_by_role("alert")).to_contain_text("does not keep what it was built from")
    page.get_by_role("button", name="Change it").click()
    page.get_by_label("The map is replaced").check()
    page.get_by_role("button", name="Send").click()
    expect(page.get_by_role("heading", name="The server makes the map")).to_be_visible()


@pytest.mark.slow
def test_a_map_that_is_not_trusted_is_not_said_to_be_ready(running, phone):
    why = "Two reconstructions disagree: 3.1% of the median depth and 1.2° apart, nine in ten keyframes within 5.4%."
    job = {
        "id": "0" * 32, "recording": "1" * 32, "map": "hall", "state": "published", "stage": "published",
        "progress": 1, "message": "", "log": [], "error": None, "created": 1.0, "started": 1.0, "ended": 2.0,
        "attempts": 1, "trusted": False, "warnings": [f"The frame poses are not trusted: {why}"],
    }  # fmt: skip
    page = phone(running.url)
    page.route("**/v1/jobs/*/events", lambda route: route.fulfill(body=f"data: {json.dumps(job)}\n\n"))
    open_camera(page)
    record(page, 5.5)
    page.get_by_role("button", name="Send").click()
    expect(page.get_by_role("heading", name="do not rely on it")).to_be_visible()
    expect(page.get_by_role("alert")).to_contain_text("two different shapes")
    expect(page.get_by_text("Record the walk again")).to_be_visible()
    expect(page.get_by_role("link", name="Walk again")).to_be_visible()

    # a map may be good without a point that was left out: then that is said
    mistake = "W2: its x looks wrong by 1.00 m; it was left out."
    report = {"report": {"trajectories": [{"waypoint_mistake": mistake}]}}
    page.route("**/v1/maps/hall/report", lambda route: route.fulfill(json=report))
    job["warnings"] = []
    page.reload()
    expect(page.get_by_role("heading", name="The map is ready")).to_be_visible()
    expect(page.get_by_role("alert")).to_contain_text(mistake)
    expect(page.get_by_text("Measure that point again")).to_be_visible()
    expect(page.get_by_role("link", name="Correct the points")).to_have_attribute("href", f"./#/recordings/{'1' * 32}")

    # a good map comes with advice, too
    report["report"] = {}
    page.reload()
    expect(page.get_by_text("Try it with a few pictures")).to_be_visible()

    # a failure is said once, and marked where it happened
    error = {"code": "mapping_failed", "message": "The camera stayed in one place.", "hint": "It covers 74% of it."}
    job.update(state="failed", stage="poses", error=error)
    page.reload()
    expect(page.get_by_role("alert")).to_contain_text("one place. It covers 74 % of it.")
    expect(page.get_by_text("The camera stayed in one place.").filter(visible=True)).to_have_count(1)
    expect(page.locator(".stages .failed")).to_have_text("Finding where each picture was taken")
    job["error"] = None

    # while it is made, there is a line about what is done, and the time left
    job.update(state="running", stage="poses", progress=0.5, started=time.time() - 230, ended=None, trusted=None)
    page.reload()
    expect(page.get_by_role("status")).to_have_text("Finding where each picture was taken – about 4 minutes left")
    expect(page.get_by_role("button", name="Cancel")).to_be_visible()


@pytest.mark.slow
def test_sending_can_be_cancelled(running, phone):
    page = phone(running.url)
    page.route("**/v1/recordings**", lambda route: route.abort())
    open_camera(page)
    record(page, 5.5)
    page.get_by_role("button", name="Send").click()
    expect(page.get_by_role("alert")).to_contain_text("The server cannot be reached")
    page.get_by_role("button", name="Cancel").click()
    expect(page.get_by_role("heading", name="Your recording")).to_be_visible()
    expect(page.get_by_role("button", name="Send")).to_be_enabled()


@pytest.mark.slow
def test_a_key_that_allows_too_little_is_asked_for_again(serve, phone):
    running = serve(keys=KeyPolicy.ALWAYS)
    keys = KeyStore(running.settings.data_dir)
    small, enough = keys.create("small", Scope.READ), keys.create("enough", Scope.MAP)
    page = phone(running.url)
    hold_key(page, small)
    page.get_by_role("button", name="Open the camera").click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("map is needed")
    expect(dialog).to_contain_text("rholoc key create NAME --scope map")
    dialog.get_by_role("button", name="Cancel").click()
    expect(page.get_by_role("heading", name="Record a walk")).to_be_visible()  # no walk is recorded in vain
    page.get_by_role("button", name="Open the camera").click()
    page.get_by_role("textbox", name="Key").fill(enough)
    page.get_by_role("button", name="Use this key").click()
    expect(page.get_by_role("button", name="Record", exact=True)).to_be_enabled(timeout=LONG_MS)


def test_a_key_is_asked_for_in_plain_words_and_any_title_is_a_name(serve, phone):
    running = serve(keys=KeyPolicy.ALWAYS)
    page = phone(running.url)
    button = page.get_by_role("button", name="Open the camera")
    box = button.bounding_box()
    assert box["y"] + box["height"] < PHONE["height"]  # nobody has to look for it
    page.get_by_label("Name of the map").fill("Büro, 2nd floor")
    button.click()
    expect(page.get_by_role("dialog")).not_to_contain_text("Bearer")
    expect(page.get_by_role("dialog")).to_contain_text("rholoc key create NAME --scope map")
    page.get_by_role("textbox", name="Key").fill(KeyStore(running.settings.data_dir).create("one", Scope.MAP))
    page.get_by_role("button", name="Use this key").click()
    expect(page.get_by_role("button", name="Record", exact=True)).to_be_enabled(timeout=LONG_MS)
    assert page.evaluate("JSON.parse(localStorage.getItem('rholoc-recorder-draft')).map") == "Buero-2nd-floor"


@pytest.mark.slow
def test_pictures_stand_before_the_first_walk_until_they_were_seen(running, phone):
    page = phone(running.url)
    pictures = page.locator(".guide svg")
    expect(pictures).to_have_count(3)
    expect(pictures.first).to_be_visible()
    page.get_by_role("button", name="Got it").click()
    expect(pictures.first).to_be_hidden()
    page.reload()
    expect(page.get_by_role("heading", name="Record a walk")).to_be_visible()
    expect(pictures.first).to_be_hidden()
    page.get_by_text("Before the first walk").click()
    expect(pictures.first).to_be_visible()


@pytest.mark.slow
def test_a_walk_that_comes_back_is_told_to_hold_on(running, phone):
    page = phone(running.url)  # its camera sees the same wall every five seconds
    open_camera(page)
    page.get_by_role("button", name="Record", exact=True).click()
    expect(page.locator(".ring")).to_be_visible()
    expect(page.locator(".advice")).to_have_text(
        "You have been here before: hold still for two seconds.", timeout=LONG_MS
    )
    expect(page.locator(".ring text")).to_have_text("✓")
    page.get_by_role("button", name="Stop").click()
    expect(page.get_by_role("heading", name="Your recording")).to_be_visible(timeout=LONG_MS)
    expect(page.locator(".doubts")).not_to_contain_text("No loop was seen")
