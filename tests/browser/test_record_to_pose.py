"""From a phone in the hand to a pose: recorded, sent over a line that breaks, mapped, and a second walk's frame tried.

The phone (:mod:`walking_phone`) sees and feels the simulated walk from its beginning to its first stop.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect
from walking_phone import WalkingPhone

from rholoc.geometry import FloatArray
from rholoc.simulation import PHONE_CAMERA, Light, make_test_site, make_walk, measure_imu, render_view

FIRST_WALK = make_walk(1)
END_S = float(FIRST_WALK.pause_times[1])
CALM = 0.4  # of the turning: the camera is slow
FPS = 8  # of the camera: fewer keyframes, a sooner map
POINTS = (0.1, 0.35, 0.65, 0.9)  # shares of the walk: where points are marked, which are not on one line
QUERY_S = 5.5  # of the second walk: between the points marked, beyond which an error of their times grows
LONG_MS = 280_000
DOUBT = re.compile("is missed by|leave the map's rotation open")  # either follows from a point that is wrong
ADVICE = "Measure that point again, correct it, and map the recording again."


def calm_gaze(walked: FloatArray) -> FloatArray:
    """Yaw and pitch at metres walked, nearer to where the walk begins to look."""
    begin = FIRST_WALK.gaze(FIRST_WALK.stations[0])
    return np.asarray(begin + CALM * (FIRST_WALK.gaze(walked) - begin))


WALK = replace(FIRST_WALK, gaze=calm_gaze)


@pytest.fixture(scope="module")
def phone() -> WalkingPhone:
    """What a phone sees and feels from the walk's beginning to its first stop."""
    site = make_test_site(0)
    poses = WALK.poses(np.arange(0, END_S, 1 / FPS))
    pictures = [render_view(site, PHONE_CAMERA, pose, Light.ARTIFICIAL, seed=i) for i, pose in enumerate(poses)]
    return WalkingPhone(pictures, FPS, measure_imu(WALK, END_S, seed=0))


@pytest.fixture(scope="module")
def browser(launch: Callable[..., Browser]) -> Iterator[Browser]:
    browser = launch("--enable-unsafe-swiftshader")
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def running(serve: Callable[..., Any]) -> Any:
    """A service with a worker, which knows the phone's camera."""
    running = serve(worker=True)
    camera = {name: getattr(PHONE_CAMERA, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    assert httpx.put(f"{running.url}/v1/cameras/phone", json=camera).is_success
    return running


def record_walk(browser: Browser, phone: WalkingPhone, url: str, name: str, mistyped_m: float = 0.0) -> Page:
    """Record the walk, mark and measure its points, W2's x wrong by ``mistyped_m``; the page before sending."""
    page = browser.new_context(viewport={"width": 390, "height": 844}, reduced_motion="reduce").new_page()
    page.set_default_timeout(LONG_MS)
    phone.becomes(page)
    page.goto(f"{url}/record")
    page.get_by_label("Name of the map").fill(name)
    page.get_by_role("button", name="Open the camera").click()
    expect(page.get_by_role("button", name="Record", exact=True)).to_be_enabled()
    marked = phone.record(page, [share * END_S for share in POINTS])
    expect(page.get_by_role("heading", name="Your recording")).to_be_visible()
    points = WALK.positions(np.array(marked))
    points[1, 0] += mistyped_m
    for point, position in zip(("W1", "W2", "W3", "E"), points, strict=True):
        for axis, value in zip("xyz", position, strict=True):
            page.get_by_label(f"{axis} of {point} in metres").fill(f"{value:.3f}")
    page.get_by_label("Camera").select_option("phone")
    return page


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_walk_recorded_in_a_browser_becomes_a_trusted_map_that_a_second_walk_is_found_in(
    running: Any, wire: Callable[..., Any], browser: Browser, phone: WalkingPhone, tmp_path: Path
) -> None:
    line = wire(running.address)
    page = record_walk(browser, phone, line.url, "hall")
    line.cut_after(100_000)
    page.get_by_role("button", name="Send").click()
    expect(page.get_by_text("The server cannot be reached.")).to_be_visible()
    page.reload()
    line.mend()
    expect(page.get_by_role("heading", name="The map is ready")).to_be_visible(timeout=LONG_MS)
    assert page.get_by_role("alert").filter(visible=True).all_inner_texts() == []
    page.get_by_role("link", name="See the map").click()
    expect(page.get_by_role("heading", name="hall")).to_be_visible()
    expect(page.get_by_text("This map passed its checks.")).to_be_visible()
    (pose,) = make_walk(2).poses(np.array([QUERY_S]))
    frame = render_view(make_test_site(0), PHONE_CAMERA, pose, Light.ARTIFICIAL, seed=900)
    cv2.imwrite(str(tmp_path / "frame.png"), frame)
    page.goto(f"{line.url}/#/try/hall")
    page.get_by_label("Picture, video or trajectory").set_input_files(tmp_path / "frame.png")
    expect(page.locator(".answer")).to_contain_text("localized")
    shown = re.search(r"Position(-?[\d.]+), (-?[\d.]+), (-?[\d.]+) m", page.locator(".answer").text_content() or "")
    found = np.array([float(value) for value in shown.groups()])
    assert np.linalg.norm(found - pose.position) < 0.10

    page.get_by_role("button", name="Use the camera").click()
    answer = page.locator(".answer")
    expect(answer.locator(".badge")).to_have_text("tracking")
    phone.walk(page)
    expect(answer.locator(".badge")).to_have_text("tracking")
    expect(answer).to_contain_text("Jumps0")
    shown = re.search(r"Position(-?[\d.]+), (-?[\d.]+), (-?[\d.]+) m", answer.text_content() or "")
    found = np.array([float(value) for value in shown.groups()])
    assert np.linalg.norm(found - WALK.positions(np.array([END_S]))[0]) < 0.10
    page.context.close()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_mistyped_point_makes_a_map_that_is_not_trusted_until_it_is_corrected(
    running: Any, browser: Browser, phone: WalkingPhone
) -> None:
    page = record_walk(browser, phone, running.url, "mistyped", mistyped_m=0.3)
    page.get_by_role("button", name="Send").click()
    expect(page.get_by_role("heading", name="The map is made, but do not rely on it")).to_be_visible(timeout=LONG_MS)
    expect(page.get_by_role("alert")).to_contain_text("W2: its x looks wrong by")
    expect(page.locator("main")).to_contain_text(ADVICE)
    correct = page.get_by_role("link", name="Correct the points").get_attribute("href")

    page.goto(f"{running.url}/#/maps")
    card = page.locator("li.card", has=page.get_by_role("link", name="mistyped"))
    expect(card.locator(".badge").first).to_have_text("not trusted")
    expect(card).to_contain_text(DOUBT)
    page.goto(f"{running.url}/#/maps/mistyped")
    trust = page.get_by_role("region", name="Trust")
    expect(trust).to_contain_text("Do not rely on this map.")
    expect(trust).to_contain_text("W2: its x looks wrong by")
    expect(trust).to_contain_text(ADVICE)
    expect(page.locator("main")).to_contain_text("Against measured points")
    page.goto(f"{running.url}/#/try/mistyped")
    expect(page.locator("main .notice.bad")).to_contain_text(DOUBT)
    page.goto(f"{running.url}/#/jobs")
    expect(page.locator("li.card", has_text="mistyped")).to_contain_text("published, not trusted")

    page.goto(f"{running.url}/{correct}")
    points = page.get_by_role("region", name="Waypoints")
    x = points.get_by_role("row").nth(2).get_by_label("x", exact=True)
    x.fill(f"{float(x.input_value()) - 0.3:.3f}")
    points.get_by_role("button", name="Save waypoints").click()
    expect(points).to_contain_text("These were typed here")
    page.get_by_label("Name of the map").fill("corrected")
    page.get_by_label("Camera").select_option("phone")
    page.get_by_role("button", name="Map it", exact=True).click()
    expect(page.locator("main .badge")).to_have_text("published", timeout=LONG_MS)
    page.get_by_role("link", name="To the map").click()
    expect(page.get_by_role("region", name="Trust")).to_contain_text("This map passed its checks.")
    page.context.close()
