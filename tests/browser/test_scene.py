"""A map in 3-D: drawn by the processor as by a graphics card, with more points and pictures on demand, and levelled."""

import base64
import re
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
from playwright.sync_api import expect

from rholoc.geometry import Similarity
from rholoc.mapping.edit.moving import move_map
from rholoc.maps import Cloud, map_to_bytes

MAGENTA = (230, 20, 160)

# Draws the same surface, points and lines, some of which leave the picture, with both painters. None lies behind
# the camera: SwiftShader does not draw lines that begin there.
PAINTED = """async () => {
    const { GlPainter } = await import('/web/console/gl_painter.js');
    const { PlainPainter } = await import('/web/console/plain_painter.js');
    const { columns, lookAt, perspective } = await import('/web/console/matrix.js');
    const { multiply } = await import('/js/poses.js');
    let seed = 1;
    const random = () => (seed = (seed * 16807) % 2147483647) / 2147483647;
    const some = (count, scale) => Float32Array.from({ length: count }, () => scale * (random() - 0.5));
    const [positions, lines] = [some(600, 6), some(90, 6)];
    const corners = Float32Array.of(-2, -1, -1, 1, 2, -1, 1, 2, 1, -2, -1, 1);
    const tints = Uint8Array.from({ length: 600 }, () => 255 * random());
    const matrix = columns(multiply(perspective(0.9, 1.5, 0.02, 100), lookAt([4, -4, 2], [0, 0, 0])));
    const shown = (Painter) => {
        const canvas = Object.assign(document.createElement('canvas'), { width: 300, height: 200 });
        const painter = new Painter(canvas);
        painter.setPoints(positions, tints);
        painter.setSurface(corners, tints.subarray(0, 12), Uint32Array.of(0, 1, 2, 0, 2, 3, 0, 2, 1));
        painter.setLines('gone', lines);
        painter.setLines('gone', new Float32Array(0));
        painter.setLines('seen', lines);
        const styles = [['gone', [1, 1, 1, 1]], ['seen', [1, 0.5, 0, 1]]];
        painter.paint({ matrix, background: [0, 0, 0.2], surface: true, count: 200, size: 15, styles });
        const copy = Object.assign(document.createElement('canvas'), { width: 300, height: 200 }).getContext('2d');
        copy.drawImage(canvas, 0, 0);
        painter.dispose();
        return copy.canvas.toDataURL();
    };
    return [shown(GlPainter), shown(PlainPainter)];
}"""


def test_both_painters_draw_the_same(desk_browser):
    with closing(desk_browser.new_page()) as page:
        page.route("http://page.test/**", _file)
        page.goto("http://page.test/")
        gl, plain = map(_pixels, page.evaluate(PAINTED))
    drawn = np.abs(plain - [0, 0, 51]).max(axis=2) > 20
    assert 0.02 < drawn.mean() < 0.5
    # edges may fall on neighbouring pixels; what is smoothed over a few of them must agree
    far = np.abs(cv2.GaussianBlur(gl, (7, 7), 0) - cv2.GaussianBlur(plain, (7, 7), 0)).max(axis=2)
    assert np.mean(far > 40) < 0.02
    assert np.abs(far).mean() < 4


def _pixels(url):
    """RGB of a data URL of a picture."""
    file = base64.b64decode(url.partition(",")[2])
    return cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_COLOR_RGB).astype(float)


def _file(route):
    name = route.request.url.removeprefix("http://page.test/").replace("web/", "page/", 1)
    file = Path(__file__).parents[2] / "client" / name
    if file.is_file():
        route.fulfill(path=file, content_type="text/javascript")
    else:
        route.fulfill(body="<!doctype html>", content_type="text/html")


@pytest.fixture(scope="module")
def leaning(serve, picture_world):
    """A service with a map that lies on its side, magenta points beside its landmarks and pictures of its views."""
    running = serve(keep_pictures=True)
    turned = move_map(picture_world.map_, Similarity(1.0, np.diag([1.0, -1.0, -1.0]), np.zeros(3)))
    rng = np.random.default_rng(0)
    positions = (turned.landmarks.positions.mean(axis=0) + rng.normal(size=(4000, 3))).astype(np.float32)
    picture = cv2.imencode(".jpg", np.full((90, 120, 3), 200, np.uint8))[1].tobytes()
    map_ = replace(
        turned,
        info=replace(turned.info, upright=False),
        landmarks=replace(turned.landmarks, colours=np.zeros((len(turned), 3), np.uint8)),
        views=replace(turned.views, pictures=(picture,) * 3 + (b"",)),
        cloud=Cloud(positions, np.tile(np.array([MAGENTA], np.uint8), (4000, 1)), np.zeros(4000, np.int32)),
    )
    assert httpx.put(f"{running.url}/v1/maps/leaning", content=map_to_bytes(map_)).status_code == 201
    return running


def painted(page) -> int:
    """How many pixels of the scene are magenta."""
    page.wait_for_timeout(200)
    shot = cv2.imdecode(np.frombuffer(page.locator("canvas.scene-canvas").screenshot(), np.uint8), 1)
    return int((np.abs(shot[..., ::-1].astype(int) - MAGENTA).max(axis=2) < 30).sum())


@pytest.mark.slow
def test_more_points_pictures_and_a_level_room(desk_browser, leaning, opened):
    with opened(desk_browser, leaning.url, "maps/leaning", failures=1) as page:  # of the picture that is not there
        expect(page.get_by_text("Levelled for display: up is estimated")).to_be_visible()
        expect(page.get_by_role("button", name="more points")).to_be_visible()
        waypoint, origin = (page.locator(".scene-labels span", has_text=text) for text in ("W1", re.compile("^z$")))
        # the waypoint is 1.5 m under the origin in the map's own axes
        assert at(waypoint)[1] < at(origin)[1]
        assert painted(page) == 0
        page.get_by_role("button", name="Show 4,000 more points").click()
        expect(page.get_by_role("button", name="Landmarks only")).to_be_visible()
        assert painted(page) > 500
        page.get_by_role("button", name="Landmarks only").click()
        assert painted(page) == 0
        x, y = at(waypoint)  # where a view is, too
        page.locator("canvas.scene-canvas").click(position={"x": x, "y": y})
        said = page.locator(".scene-said")
        expect(said.get_by_role("img", name="What the camera saw there")).to_be_visible()
        for _ in range(4):  # round the walk once, past the view without a picture
            before = said.locator("span").inner_text()
            said.get_by_role("button", name="Next picture").press("Enter")
            expect(said.locator("span")).not_to_have_text(before)
        expect(said.get_by_role("img", name="What the camera saw there")).to_be_visible()


def at(label) -> tuple[float, float]:
    """Where a label of the scene stands, px."""
    x, y = map(float, re.findall(r"-?[\d.]+(?=px)", label.evaluate("(element) => element.style.transform")))
    return x, y
