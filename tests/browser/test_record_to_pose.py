"""From a phone in the hand to a pose: recorded, sent over a line that breaks, mapped, and a second walk's frame tried.

The fake camera shows the simulated walk from its start to its first waypoint and back, over and over; at both ends the
walker stands, so that video and motion sensors agree at every moment. The fake sensors feel what belongs to the frame
that the camera shows, which the page finds out by comparing pictures.
"""

from __future__ import annotations

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

from rholoc.geometry import ByteArray, FloatArray
from rholoc.recordings import Imu
from rholoc.simulation import PHONE_CAMERA, Light, make_test_site, make_walk, measure_imu, render_view

FIRST_WALK = make_walk(1)
START_S, END_S = FIRST_WALK.pause_times[:2]
CALM = 0.4  # of the turning: the camera is slow
FPS = 6  # of the camera: fewer keyframes, a sooner map
SIGNATURE = (16, 12)
POINTS = (0.1, 0.35, 0.65, 0.9)  # shares of the film: where points are marked, which are not on one line
QUERY_S = 5.5  # of the second walk: between the points marked, beyond which an error of their times grows
LONG_MS = 150_000


def calm_gaze(walked: FloatArray) -> FloatArray:
    """Yaw and pitch at metres walked, nearer to where the walk begins to look."""
    begin = FIRST_WALK.gaze(FIRST_WALK.stations[0])
    return np.asarray(begin + CALM * (FIRST_WALK.gaze(walked) - begin))


WALK = replace(FIRST_WALK, gaze=calm_gaze)

# Finds when the film began, in ms on the page's clock, and from then on lets the sensors feel what the film shows.
FOLLOW_THE_FILM = """async ({signatures, fps, rows, period}) => {
    const video = document.querySelector("video");
    const canvas = Object.assign(document.createElement("canvas"), {width: 16, height: 12});
    const context = canvas.getContext("2d", {willReadFrequently: true});
    const look = () => new Promise((resolve) => video.requestVideoFrameCallback((now, {captureTime}) => {
        context.drawImage(video, 0, 0, 16, 12);
        const seen = context.getImageData(0, 0, 16, 12).data.filter((value, i) => i % 4 === 1);
        const off = signatures.map((one) => one.reduce((sum, value, i) => sum + Math.abs(value - seen[i]), 0));
        resolve([captureTime / 1000, off.indexOf(Math.min(...off)) / fps]);
    }));
    const glimpses = [];
    for (let i = 0; i < 15; i++) glimpses.push(await look());
    const within = (time) => ((time % (2 * period)) + 2 * period) % (2 * period);
    const shown = (time) => Math.min(within(time), 2 * period - within(time));
    let best = [Infinity, 0];
    for (let begin = 0; begin < 2 * period; begin += 0.005) {
        const off = glimpses.reduce((sum, [at, film]) => sum + Math.min(0.2, Math.abs(shown(at - begin) - film)), 0);
        if (off < best[0]) best = [off, begin];
    }
    window.filmTime = (ms) => shown(ms / 1000 - best[1]);
    const forward = (ms) => within(ms / 1000 - best[1]) < period;
    window.fakeMotion = setInterval(() => {
        const now = performance.now();
        const [x, y, z, alpha, beta, gamma] = rows[Math.min(rows.length - 1, Math.round(filmTime(now) * 100))];
        const sign = forward(now) ? 1 : -1;
        dispatchEvent(new DeviceMotionEvent("devicemotion", {interval: 16, accelerationIncludingGravity: {x, y, z},
            rotationRate: {alpha: sign * alpha, beta: sign * beta, gamma: sign * gamma}}));
    }, 16);
    return best[0] / glimpses.length;
}"""
# Marks a point when the film shows a moment, and gives the moment that it really was.
MARK_AT = """(wanted) => new Promise((resolve) => {
    const watch = setInterval(() => {
        if (Math.abs(filmTime(performance.now()) - wanted) > 0.04) return;
        clearInterval(watch);
        document.querySelector("button.waypoint").click();
        resolve(filmTime(performance.now()));
    }, 5);
})"""
AT_AN_END = """(period) => new Promise((resolve) => setInterval(() => {
    const time = filmTime(performance.now());
    if (Math.min(time, period - time) < 0.05) resolve(time < period / 2);
}, 5))"""


@pytest.fixture(scope="module")
def pictures() -> list[ByteArray]:
    """The walk's pictures from one stop to the next."""
    site = make_test_site(0)
    times = np.arange(START_S, END_S, 1 / FPS)
    return [
        render_view(site, PHONE_CAMERA, pose, Light.ARTIFICIAL, seed=number)
        for number, pose in enumerate(WALK.poses(times))
    ]


@pytest.fixture(scope="module")
def browser(fake_camera: Callable[..., Browser], pictures: list[ByteArray]) -> Iterator[Browser]:
    browser = fake_camera([*pictures, *reversed(pictures)], fps=FPS)
    yield browser
    browser.close()


def felt() -> list[list[float]]:
    """What the sensors feel, 100 times a second of the film: m/s², degrees a second, in the device's axes."""
    imu: Imu = measure_imu(WALK, float(END_S), seed=0)
    at: FloatArray = np.arange(START_S, END_S, 0.01)
    columns = [*imu.acceleration.T, *np.degrees(imu.angular_velocity).T]
    return np.column_stack([np.interp(at, imu.times, column) for column in columns]).round(5).tolist()


def signature(picture: ByteArray) -> list[int]:
    green = cv2.resize(picture, SIGNATURE, interpolation=cv2.INTER_AREA)[..., 1]
    return [int(value) for value in green.ravel()]


def record_with_waypoints(page: Page, pictures: list[ByteArray]) -> list[float]:
    """Record from one end of the walk to the other, and mark four points; their times in the film, seconds."""
    page.get_by_role("button", name="Open the camera").click()
    expect(page.get_by_role("button", name="Record", exact=True)).to_be_enabled()
    film = {
        "signatures": [signature(picture) for picture in pictures],
        "fps": FPS,
        "rows": felt(),
        "period": len(pictures) / FPS,
    }
    assert page.evaluate(FOLLOW_THE_FILM, film) < 0.05
    moments = [share * film["period"] for share in POINTS]
    if not page.evaluate(AT_AN_END, film["period"]):
        moments.reverse()
    page.get_by_role("button", name="Record", exact=True).click()
    marked = [page.evaluate(MARK_AT, moment) for moment in moments]
    page.wait_for_timeout(300)
    page.get_by_role("button", name="Stop").click()
    return marked


@pytest.mark.slow
def test_a_walk_recorded_in_a_browser_becomes_a_map_that_a_second_walk_is_found_in(
    serve: Callable[..., Any], wire: Callable[..., Any], browser: Browser, pictures: list[ByteArray], tmp_path: Path
) -> None:
    running = serve(worker=True)
    camera = {name: getattr(PHONE_CAMERA, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    assert httpx.put(f"{running.url}/v1/cameras/phone", json=camera).is_success
    line = wire(running.address)
    permissions = ["camera", "accelerometer", "gyroscope", "magnetometer"]
    page = browser.new_context(viewport={"width": 390, "height": 844}, permissions=permissions).new_page()
    page.set_default_timeout(LONG_MS)
    page.goto(f"{line.url}/record")
    page.get_by_label("Name of the map").fill("hall")
    marked = record_with_waypoints(page, pictures)
    expect(page.get_by_role("heading", name="Your recording")).to_be_visible()
    for name, at in zip(("W1", "W2", "W3", "E"), marked, strict=True):
        for axis, value in zip("xyz", WALK.positions(np.array([START_S + at]))[0], strict=True):
            page.get_by_label(f"{axis} of {name} in metres").fill(f"{value:.3f}")
    page.get_by_label("Camera").select_option("phone")
    line.cut_after(100_000)
    page.get_by_role("button", name="Send").click()
    expect(page.get_by_text("The server cannot be reached.")).to_be_visible()
    page.reload()
    line.mend()
    ended = page.get_by_role("heading", name=re.compile("The map is ready|do not rely on it|Mapping failed"))
    expect(ended).to_be_visible(timeout=LONG_MS)
    assert page.get_by_role("alert").filter(visible=True).all_inner_texts() == []
    page.get_by_role("link", name="See the map").click()
    expect(page.get_by_role("heading", name="hall")).to_be_visible()
    (pose,) = make_walk(2).poses(np.array([QUERY_S]))
    frame = render_view(make_test_site(0), PHONE_CAMERA, pose, Light.ARTIFICIAL, seed=900)
    cv2.imwrite(str(tmp_path / "frame.png"), frame)
    page.goto(f"{line.url}/#/try/hall")
    page.get_by_label("Picture or trajectory").set_input_files(tmp_path / "frame.png")
    expect(page.locator(".answer")).to_contain_text("localized")
    shown = re.search(r"Position(-?[\d.]+), (-?[\d.]+), (-?[\d.]+) m", page.locator(".answer").text_content() or "")
    assert shown is not None
    found = np.array([float(value) for value in shown.groups()])
    assert np.linalg.norm(found - pose.position) < 0.10
    page.context.close()
