"""How heavy and how quick the web page is, in Debian's Chromium with software rendering.

    python benchmarks/web_page.py [--json]

Prints, for the first visit of a phone to the console and to the recorder, the bytes over the network and the time until
the page can be used, the processor throttled to a quarter; how many camera frames a second "try it" localizes and
draws, and how many it tracks; how many times a second a map of 50 000 and of 500 000 points is drawn: whole, and while
it is being turned, when as many points are drawn as keep it smooth, and how many those are; and how often a map's page
draws while 20 robots are answered five times a second each, and how many of their answers it hears.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import shutil
import socket
import tempfile
import threading
import time
from pathlib import Path

import uvicorn
from fastapi import FastAPI
from playwright.sync_api import Browser, Page, Playwright, sync_playwright

from rholoc.cli.server_process import running_server
from rholoc.service import Settings, create_app
from rholoc.service.caller import ASKER
from rholoc.service.frames.answers import LocalizationOut
from rholoc.service.http.models import EXAMPLES
from rholoc.service.state import State

MAPS = Path(__file__).parents[1] / "maps"
PHONE = {"width": 390, "height": 844}
DESK = {"width": 1280, "height": 850}
THROTTLE = 4
USABLE = {"/": "main li.map-card a", "/record": "main button"}
TRY_S = 12
STILL = 60  # pictures that the camera stays in a place for, 30 a second
POINTS = (50_000, 500_000)
DRAW_S = 4
ROBOTS, ROBOT_HZ, LIVE_S = 20, 5, 8
CHROMIUM = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-fake-device-for-media-stream"]

# Turns the map and waits for each picture's last pixel, so that no frame is counted that was only queued.
DRAW = """async ([count, seconds]) => {
    const { SceneView } = await import('/web/console/scene.js');
    const view = new SceneView('benchmark');
    view.element.style.cssText = 'position: fixed; inset: 0; height: 100vh; z-index: 9';
    document.body.append(view.element);
    const number = (_, i) => Math.random() * (i % 4 === 3 ? 0.1 : 8);
    const landmarks = Float32Array.from({ length: 4 * count }, number);
    view.showMap({ features: count, landmarks, views: new Float32Array(0), colours: null }, [], true);
    const { gl, context } = view.painter;
    const pixel = new Uint8Array(4);
    const finish = () =>
        gl ? gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel) : context.getImageData(0, 0, 1, 1);
    const rate = async (draw) => {
        const start = performance.now();
        let frames = 0;
        while (performance.now() - start < 1000 * seconds) {
            draw();
            await new Promise(requestAnimationFrame);
            finish();
            frames++;
        }
        return (1000 * frames) / (performance.now() - start);
    };
    const whole = await rate(() => view.redraw());
    const turned = await rate(() => view.turn(0.02, 0));
    const drawn = view.budget;
    view.dispose();
    view.element.remove();
    return [whole, turned, drawn];
}"""


# Counts the pictures that a map's page draws while others are answered, and the answers that it hears.
LIVE = """async (seconds) => {
    const { SceneView } = await import('/web/console/scene.js');
    const { Motions } = await import('/web/console/motions.js');
    let [drawn, heard] = [0, 0];
    const [draw, hear] = [SceneView.prototype.draw, Motions.prototype.hear];
    SceneView.prototype.draw = function () { drawn++; return draw.call(this); };
    Motions.prototype.hear = function (...all) { heard++; return hear.apply(this, all); };
    const start = performance.now();
    await new Promise((resolve) => setTimeout(resolve, 1000 * seconds));
    const passed = (performance.now() - start) / 1000;
    return [drawn / passed, heard / passed];
}"""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    as_json = parser.parse_args().json
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        with running_server(MAPS, folder / "data", folder / "log") as server:
            figures = measured(playwright, server.url, folder)
        figures |= live(playwright, folder)
    if as_json:
        print(json.dumps(figures, indent=2))
    else:
        for what, value in figures.items():
            print(f"{what:<28} {value:,.1f}")


def measured(playwright: Playwright, url: str, folder: Path) -> dict[str, float]:
    """All figures by name."""
    film = folder / "film.mjpeg"
    film.write_bytes(b"".join(path.read_bytes() * STILL for path in sorted((MAPS / "queries").glob("*.jpg"))))
    camera = ["--use-fake-ui-for-media-stream", f"--use-file-for-fake-video-capture={film}"]
    browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=[*CHROMIUM, *camera])
    figures: dict[str, float] = {}
    for path in USABLE:
        figures |= first_visit(browser, url, path)
    figures["try it, frames/s"] = try_rate(browser, url, tracked=False)
    figures["tracked, frames/s"] = try_rate(browser, url, tracked=True)
    page = browser.new_page(viewport=DESK)
    page.goto(url)
    for count in POINTS:
        whole, turned, drawn = page.evaluate(DRAW, [count, DRAW_S])
        figures |= {
            f"{count} points, frames/s": whole,
            f"{count} turned, frames/s": turned,
            f"{count} turned, drawn": drawn,
        }
    browser.close()
    return figures


def live(playwright: Playwright, folder: Path) -> dict[str, float]:
    """How a map's page keeps up with robots; their answers are made up, which are not what is measured."""
    app = create_app(Settings(maps_dir=MAPS, data_dir=folder / "live", worker=False, live=True))
    listener = socket.create_server(("127.0.0.1", 0))
    server = uvicorn.Server(uvicorn.Config(app, log_level="error"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.05)
    stop = threading.Event()
    threading.Thread(target=_ask, args=(app, stop), daemon=True).start()
    browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=CHROMIUM)
    page = browser.new_page(viewport=DESK)
    page.goto(f"http://127.0.0.1:{listener.getsockname()[1]}/#/maps/testsite")
    page.get_by_role("button", name="Live").click()
    page.locator("tbody tr").nth(ROBOTS - 1).wait_for()
    drawn, heard = page.evaluate(LIVE, LIVE_S)
    browser.close()
    stop.set()
    server.should_exit = True
    thread.join(10)
    return {"20 robots, frames/s": drawn, "20 robots, answers heard/s": heard}


def _ask(app: FastAPI, stop: threading.Event) -> None:
    """Robots that walk in circles and are answered."""
    state: State = app.state.rholoc
    example = EXAMPLES["LocalizationOut"]
    while not stop.is_set():
        for robot in range(ROBOTS):
            angle = 0.5 * time.monotonic() + robot
            x, y = 2 + 1.5 * math.cos(angle), 1 + 1.5 * math.sin(angle)
            pose = {**example["pose"], "position": [x, y, 1.5]}
            pose["T_map_camera"] = [[0, 0, 1, x], [-1, 0, 0, y], [0, -1, 0, 1.5], [0, 0, 0, 1]]
            ASKER.set(f"robot-{robot}")
            state.frames.live.note(LocalizationOut.model_validate({**example, "pose": pose}))
        stop.wait(1 / ROBOT_HZ)


def first_visit(browser: Browser, url: str, path: str) -> dict[str, float]:
    """Bytes over the network, and milliseconds until the page can be used, of a phone on its first visit."""
    context = browser.new_context(viewport=PHONE, has_touch=True)
    page = context.new_page()
    wire = context.new_cdp_session(page)
    wire.send("Network.enable")
    wire.send("Emulation.setCPUThrottlingRate", {"rate": THROTTLE})
    received: list[float] = []
    wire.on("Network.loadingFinished", lambda event: received.append(event["encodedDataLength"]))
    page.goto(url + path, wait_until="commit")
    usable_ms = page.wait_for_function(
        "(what) => document.querySelector(what) && performance.now()", arg=USABLE[path], polling=20
    ).json_value()
    page.wait_for_load_state("networkidle")
    context.close()
    return {f"{path} kB": sum(received) / 1000, f"{path} usable after ms": usable_ms}


def try_rate(browser: Browser, url: str, tracked: bool) -> float:
    """Camera frames a second from the camera to the drawn pose, each by itself or tracked."""
    context = browser.new_context(viewport=DESK, permissions=["camera"], base_url=url)
    page = context.new_page()
    page.goto("/#/try/testsite")
    page.get_by_label("track from frame to frame").set_checked(tracked)
    page.get_by_role("button", name="Use the camera").click()
    page.wait_for_timeout(1000 * TRY_S)
    rate = shown_rate(page)
    context.close()
    return rate


def shown_rate(page: Page) -> float:
    """The rate that the page itself shows."""
    text = page.locator(".answer").text_content() or ""
    found = re.search(r"([\d.]+) frames a second", text)
    return float(found[1]) if found else 0.0


if __name__ == "__main__":
    main()
