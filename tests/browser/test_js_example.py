"""The example page of @rholoc/client in Chromium: a waypoint is drawn where it is in the fake camera's picture."""

import functools
import threading
from collections.abc import Iterator
from dataclasses import replace
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import expect

from rholoc.maps import MapNames, NamedPoint, map_to_bytes

FOLDER = Path(__file__).parents[2] / "client" / "js"
BESIDE_M, AHEAD_M = 0.4, 3.0


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def pages() -> Iterator[str]:
    """Another site's web server with the example."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(FOLDER)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://localhost:{server.server_port}"
    server.shutdown()


@pytest.fixture
def service(serve, pages, picture_world):
    """A service that this site may use, whose map names a point ahead of the picture's camera and one behind it."""
    running = serve(origins=pages)
    T = picture_world.pose.T_map_camera
    places = {"lift": [BESIDE_M, 0.0, AHEAD_M], "exit": [0.0, 0.0, -AHEAD_M]}
    points = [NamedPoint(name, tuple((T[:3, :3] @ one + T[:3, 3]).tolist())) for name, one in places.items()]
    map_ = picture_world.map_
    named = replace(map_, info=replace(map_.info, names=MapNames(tuple(points))))
    (running.settings.maps_dir / "room.rho").write_bytes(map_to_bytes(named))
    return running


def started(browser, pages, service, point):
    page = browser.new_page(viewport={"width": 640, "height": 800})
    page.goto(f"{pages}/example/?service={service.url}&map=room&point={point}")
    page.get_by_role("button", name="Look around").click()
    return page


def test_a_waypoint_is_drawn_where_it_is(fake_camera, pages, service, picture_world):
    browser = fake_camera([picture_world.image])
    page = started(browser, pages, service, "lift")
    marker = page.locator("#marker")
    expect(marker).to_be_visible()
    expect(marker).to_have_text("lift")
    expect(page.get_by_role("status")).to_contain_text("Here, to 0.")
    box, video = marker.bounding_box(), page.locator("video").bounding_box()
    camera = picture_world.map_.info.camera
    at = np.array([box["x"] + box["width"] / 2 - video["x"], box["y"] + box["height"] - video["y"]])
    shown = at / (video["width"], video["height"]) * (camera.width, camera.height)
    expected = [camera.fx * BESIDE_M / AHEAD_M + camera.cx, camera.cy]
    np.testing.assert_allclose(shown, expected, atol=8)
    browser.close()


@pytest.mark.slow
@pytest.mark.parametrize("point", ["lift", "exit"])
def test_nothing_is_drawn_where_it_is_not_seen(fake_camera, pages, service, picture_world, point):
    """What is not known, and what is behind the camera."""
    picture = np.full_like(picture_world.image, 40) if point == "lift" else picture_world.image
    browser = fake_camera([picture])
    page = started(browser, pages, service, point)
    expect(page.get_by_role("status")).not_to_be_empty()
    page.wait_for_timeout(500)
    expect(page.locator("#marker")).to_be_hidden()
    browser.close()


def test_what_does_not_fit_is_said(fake_camera, pages, service, picture_world):
    browser = fake_camera([picture_world.image])
    page = browser.new_page()
    page.goto(f"{pages}/example/?service={service.url}&map=attic")
    page.get_by_role("button", name="Look around").click()
    expect(page.get_by_role("status")).to_contain_text("attic")
    expect(page.locator("form")).to_be_visible()
    browser.close()
