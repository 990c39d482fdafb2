"""Every page for everybody: axe finds nothing, it fits at 200 % and on a narrow phone, and needs no mouse."""

from pathlib import Path

import cv2
import httpx
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect

from rholoc.library.recording_notes import notes_of
from rholoc.library.recordings import RecordingStore
from rholoc.recordings import MemoryFrames, Recording, Waypoint

DESK, ZOOMED, PHONE = (
    {"width": 1280, "height": 850},
    {"width": 640, "height": 425},  # the same window at 200 %
    {"width": 360, "height": 740},
)
PAGES = (
    "#/maps",
    "#/maps/room",
    "#/maps/room/correct",
    "#/try/room",
    "#/jobs",
    "#/jobs/JOB",
    "#/recordings",
    "#/recordings/RECORDING",
    "#/cameras",
    "#/sites",
    "#/sites/plant",
    "#/keys",
    "here/plant",
    "#/nothing",
    "record",
    "record#/live",
)
# Notes which elements had the focus, and whether it could be seen on them.
WATCH_FOCUS = """() => {
    window.focused = new Map();
    addEventListener("focusin", ({target}) => {
        const shown = [target, target.closest("label")].filter(Boolean).map((one) => getComputedStyle(one));
        const seen = shown.some(({outlineStyle, boxShadow}) => outlineStyle !== "none" || boxShadow !== "none");
        focused.set(target, seen);
    });
}"""
# What somebody with a mouse could use: all that Tab is to reach.
CONTROLS = """() => [...document.querySelectorAll(
    "a[href], button, input, select, textarea, summary, video[controls], [tabindex='0']")].filter((one) =>
    !one.disabled && one.type !== "hidden" && one.checkVisibility({visibilityProperty: true}))"""
MISSED = f"""() => ({CONTROLS})().filter((one) => !focused.has(one)).map((one) => one.outerHTML.slice(0, 120))"""
UNSEEN = """() => [...focused].filter(([one, seen]) => !seen).map(([one]) => one.outerHTML.slice(0, 120))"""


@pytest.fixture(scope="module")
def addresses(service, picture_world):
    """The addresses of all pages: there is a camera, a job that waits, and its recording, which was read."""
    camera = {"width": 640, "height": 480, "fx": 520, "fy": 520, "cx": 319.5, "cy": 239.5}
    assert httpx.put(f"{service.url}/v1/cameras/pixel", json=camera).is_success
    site = {"maps": [{"map": "room", "floor": "1", "pose": {}}]}
    assert httpx.put(f"{service.url}/v1/sites/plant", json=site).is_success
    walk = {"file": ("walk.mp4", b"\0\0\0\x18ftypmp42" + b"\0" * 5000)}
    job = httpx.post(f"{service.url}/v1/recordings", files=walk, data={"map": "hall"}).json()
    frames = MemoryFrames([cv2.resize(picture_world.image, (160, 120))] * 75, 1.0)
    points = tuple(Waypoint(f"W{i}", 20.0 * i, (2.0 * i, i * i, 1.5)) for i in range(3))
    walk = Recording(frames, "walk", Path("walk"), waypoints=points)
    RecordingStore(service.settings.data_dir).note(job["recording"], notes_of(walk))
    return {
        where: f"{service.url}/{where.replace('JOB', job['job']['id']).replace('RECORDING', job['recording'])}"
        for where in PAGES
    }


def faults(page: Page) -> list[tuple[str, str]]:
    """What axe finds that matters."""
    found = Axe().run(page).response["violations"]
    return [(one["id"], one["nodes"][0]["html"]) for one in found if one["impact"] in ("serious", "critical")]


def fits(page: Page) -> bool:
    return bool(page.evaluate("document.documentElement.scrollWidth <= innerWidth"))


@pytest.mark.parametrize(
    "where", [pytest.param(where, marks=() if where == "#/maps" else pytest.mark.slow) for where in PAGES]
)
def test_a_page_is_for_everybody(desk_browser, addresses, where, settled):
    context = desk_browser.new_context(viewport=DESK, color_scheme="dark", reduced_motion="reduce")
    page = context.new_page()
    page.set_default_timeout(20_000)
    page.goto(addresses[where])
    if where != "record#/live":
        settled(page)
    expect(page.locator("main :is(h1, section)").first).to_be_visible()
    assert faults(page) == []
    page.evaluate(WATCH_FOCUS)
    controls = page.evaluate(f"({CONTROLS})().length")
    for _ in range(controls + 2):
        page.keyboard.press("Tab")
    assert page.evaluate(MISSED) == []
    assert page.evaluate(UNSEEN) == []
    page.set_viewport_size(ZOOMED)
    assert fits(page)
    page.set_viewport_size(PHONE)
    page.emulate_media(color_scheme="light")
    assert fits(page)
    assert faults(page) == []
    context.close()


@pytest.mark.slow
def test_the_room_is_looked_at_by_keyboard(desk_browser, service, opened, settled):
    with opened(desk_browser, service.url, "maps/room") as page:
        canvas = settled(page).locator("canvas.scene-canvas")

        def drawn() -> bytes:
            page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
            return canvas.screenshot()

        before = drawn()
        for tool in ("From above", "Whole room"):
            page.get_by_role("button", name=tool).press("Enter")
            now = drawn()
            assert now != before
            before = now
        for key in ("ArrowLeft", "Shift+ArrowUp", "+", "Home"):
            canvas.press(key)
            now = drawn()
            assert now != before, key
            before = now
        canvas.press("Enter")
        expect(page.locator(".scene-said")).to_be_visible()


@pytest.mark.slow
def test_a_dialog_gives_the_focus_back(desk_browser, service, opened, settled):
    with opened(desk_browser, service.url, "maps/room", failures=-1) as page:
        settled(page).get_by_text("More", exact=True).press("Enter")
        for name in ("Rename", "Delete", "Share", "Site, floor, tags"):
            button = page.get_by_role("button", name=name)
            button.press("Enter")
            dialog = page.get_by_role("dialog")
            expect(dialog.locator(":focus")).to_have_count(1)
            dialog.press("Escape")
            expect(dialog).to_have_count(0)
            expect(button).to_be_focused()
        page.get_by_role("button", name="Rename").press("Enter")
        page.get_by_label("Name", exact=True).fill("loose")  # which another map has
        save = page.get_by_role("dialog").get_by_role("button", name="Rename")
        save.press("Enter")
        expect(page.get_by_role("alert")).to_be_visible()
        expect(save).to_be_focused()  # what was refused is tried again from there
