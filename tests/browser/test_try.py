"""Trying a map: what is shown belongs to what was asked last, and says how far it can be relied on."""

import json
import re
import shutil
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace

import cv2
import httpx
import numpy as np
import pytest
from playwright.sync_api import Error, Page, expect

from rholoc.maps import TrajectoryTable, trajectory_csv

COPY = """(canvas) => {
    const copy = Object.assign(document.createElement("canvas"), {width: canvas.width, height: canvas.height});
    const context = copy.getContext("2d", {willReadFrequently: true});
    context.drawImage(canvas, 0, 0);
    const {data} = context.getImageData(0, 0, copy.width, copy.height);
    return RESULT;
}"""
CIRCLES = COPY.replace("RESULT", "data.filter((red, i) => i % 4 === 0 && data[i + 1] > red + 80).length")
DRAWN = COPY.replace("RESULT", "data.some((value) => value > 0)")


@pytest.fixture(scope="module")
def running(service, picture_world):
    """The service with maps of other cameras and of doubtful walks."""
    maps = service.settings.maps_dir
    wide = replace(picture_world.map_.info.camera, width=1280, height=720, fx=1040.0, fy=1040.0, cx=639.5, cy=359.5)
    (maps / "wide.rho").write_bytes(picture_world.rho(camera=wide))
    why = "A waypoint is missed by 0.31 m."
    report = {"trajectories": [{"method": "visual", "trusted": False, "why": why}]}
    (maps / "doubtful.rho").write_bytes(picture_world.rho(report=report))
    return service


def take(page: Page, *files: object) -> None:
    for file in files:
        page.get_by_label("Picture, video or trajectory").set_input_files(file)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory, picture_world):
    """Files: the map's own picture, a blank one, one of another shape, and no picture at all."""
    folder = tmp_path_factory.mktemp("pictures")
    (folder / "frame.png").write_bytes(picture_world.png())
    (folder / "blank.png").write_bytes(cv2.imencode(".png", np.full((480, 640), 128, np.uint8))[1].tobytes())
    tall = cv2.resize(picture_world.image, (360, 480))
    (folder / "tall.png").write_bytes(cv2.imencode(".png", tall)[1].tobytes())
    (folder / "text.png").write_bytes(b"no picture")
    return folder


@pytest.mark.slow
def test_a_file_that_is_no_picture_clears_the_picture_before_and_an_error_its_circles(
    desk_browser, running, pictures, opened, settled
):
    with opened(desk_browser, running.url, "try/room", failures=1) as page:
        take(settled(page), pictures / "frame.png")
        expect(page.locator(".answer")).to_contain_text("localized")
        canvas = page.locator("canvas.frame")
        assert canvas.evaluate(CIRCLES) > 500
        take(page, pictures / "text.png")
        expect(page.get_by_role("alert")).to_contain_text("not a picture")
        expect(page.get_by_text("Drop a picture")).to_be_visible()  # the frame is not left empty
        assert not canvas.evaluate(DRAWN)
        expect(canvas).to_have_attribute("aria-label", "No picture yet")
        take(page, pictures / "frame.png")
        expect(page.locator(".answer")).to_contain_text("localized")
        assert canvas.evaluate(CIRCLES) > 500
        answer = {"code": "busy", "message": "Much to do.", "hint": "Wait.", "request_id": "1"}
        page.route("**/localize*", lambda route: route.fulfill(status=503, json=answer))
        page.get_by_text("Camera options").click()
        page.get_by_label("hand-held").uncheck()
        expect(page.get_by_role("alert")).to_contain_text("Much to do.")
        assert canvas.evaluate(CIRCLES) == 0


@pytest.mark.slow
def test_an_older_answer_does_not_take_the_place_of_a_newer(desk_browser, running, pictures, opened, settled):
    with opened(desk_browser, running.url, "try/room") as page:
        settled(page)
        held = []
        page.route("**/localize*", lambda route: held.append(route) if not held else route.continue_())
        with page.expect_request("**/localize*"):
            take(page, pictures / "frame.png")
        take(page, pictures / "blank.png")
        expect(page.locator(".answer")).to_contain_text("hardly anything but a bare surface")
        with suppress(Error):  # a page that has given the older question up takes no answer to it
            held[0].continue_()
        page.wait_for_timeout(1000)
        expect(page.locator(".answer")).to_contain_text("hardly anything but a bare surface")
        assert page.locator("canvas.frame").evaluate(CIRCLES) == 0


def test_changed_options_try_the_picture_again(desk_browser, running, pictures, opened, settled):
    """A typed field of view claims no confidence; a camera that is not known is estimated and said to be."""
    asked: list[str] = []
    with opened(desk_browser, running.url, "try/room") as page:
        page.on("request", lambda request: "localize" in request.url and asked.append(request.url))
        take(settled(page), pictures / "frame.png")
        answer = page.locator(".answer")
        expect(answer).to_contain_text(re.compile(r"confidence (over )?\d+ %"))
        page.get_by_text("Camera options").click()
        with page.expect_response("**/localize*"):
            page.get_by_label("hand-held").uncheck()
        assert ["dof=5" in url for url in asked] == [False, True]
        camera = page.get_by_label("Which camera took it?")
        camera.select_option("another, by its field of view")
        expect(page.get_by_role("alert")).to_contain_text("Type the picture's horizontal field of view")
        page.get_by_label("Horizontal field of view").fill("63.2")
        page.get_by_label("Horizontal field of view").press("Tab")
        expect(answer).to_contain_text("confidence unknown")
        expect(answer).to_contain_text("localized")
        expect(answer).to_contain_text("typed, not measured")
        expect(answer).to_contain_text(re.compile(r"Off by aboutunknown"))
        camera.select_option("unknown: estimate its focal length")
        expect(answer).to_contain_text("The camera is not known")
        found = re.search(r"Focal length(\d+) px, estimated", answer.text_content() or "")
        assert int(found[1]) == pytest.approx(520, rel=0.1)


@pytest.mark.slow
def test_no_answer_claims_to_be_certain_and_it_names_the_areas_the_camera_is_in(
    desk_browser, running, pictures, opened, settled
):
    with opened(desk_browser, running.url, "try/room") as page:
        settled(page)
        changes = {"recognized": 0.9998, "confidence": 0.9996, "areas": ["kitchen", "flat"], "near": ["table"]}
        page.route("**/localize*", lambda route: route.fulfill(json={**route.fetch().json(), **changes}))
        take(page, pictures / "frame.png")
        for said in ("confidence over 99 %", "right place over 99 %", "kitchen, flat", "table"):
            expect(page.locator(".answer")).to_contain_text(said)


@pytest.mark.slow
def test_all_maps_are_tried(desk_browser, running, pictures, opened, settled):
    with opened(desk_browser, running.url, "try/loose") as page:
        take(settled(page), pictures / "frame.png")
        page.get_by_role("button", name="Try all maps").click()
        said = page.get_by_text("Most confident of all maps:")
        expect(said).to_contain_text(re.compile(r"confidence (over )?\d+ %"))
        found = said.get_by_role("link").inner_text()
        assert found in {one["name"] for one in httpx.get(f"{running.url}/v1/maps").json()["maps"]}
        said.get_by_role("link").click()
        expect(page.get_by_role("combobox").first).to_have_value(found)
        take(settled(page), pictures / "blank.png")
        page.get_by_role("button", name="Try all maps").click()
        expect(page.get_by_text("No map localizes this picture.")).to_be_visible()


@pytest.mark.slow
def test_a_map_that_is_not_trusted_says_so_beside_its_answers(desk_browser, running, pictures, opened, settled):
    with opened(desk_browser, running.url, "try/doubtful") as page:
        take(settled(page), pictures / "frame.png")
        expect(page.locator(".answer")).to_contain_text("The map itself is not trusted")
        expect(page.locator("main .badge").first).to_have_text("not trusted")


AUTOMATIC, OF_THE_MAP = "", "the camera that made the map"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("size", "name", "choice"),
    [
        ((640, 480), "room", AUTOMATIC),
        ((480, 640), "wide", OF_THE_MAP),
        ((640, 360), "room", AUTOMATIC),
        ((640, 480), "wide", AUTOMATIC),
    ],
)
def test_a_camera_of_any_shape_is_taken(desk_browser, running, opened, settled, name, size, choice):
    """A camera of another shape than the map's is estimated, or taken for the map's, turned or cropped."""
    asked: list[str] = []
    with opened(desk_browser, running.url, f"try/{name}") as page:
        settled(page)
        page.on("request", lambda request: "localize" in request.url and asked.append(request.url))
        page.evaluate(
            """([width, height]) => {
                const canvas = Object.assign(document.createElement("canvas"), {width, height});
                const context = canvas.getContext("2d");
                setInterval(() => { context.fillStyle = `hsl(${performance.now() / 10} 50% 50%)`;
                    context.fillRect(0, 0, width, height); }, 50);
                navigator.mediaDevices.getUserMedia = async () => canvas.captureStream(10);
            }""",
            list(size),
        )
        page.get_by_text("Camera options").click()
        page.get_by_label("Which camera took it?").select_option(choice)
        page.get_by_role("button", name="Use the camera").click()
        expect(page.locator(".answer")).to_contain_text("frames a second")
        page.get_by_role("button", name="Stop the camera").click()
        expect(page.get_by_role("alert")).to_have_count(0)
    own_shape = size == ((640, 480) if name == "room" else (640, 360))
    focal = 520 if name == "room" else 1040
    expected = {"fx": focal * max(size) / (640 if name == "room" else 1280)}
    for url in asked:
        query = httpx.URL(url).params
        if choice or own_shape:
            assert float(query["fx"]) == pytest.approx(expected["fx"], abs=0.1)
        else:
            assert query["intrinsics"] == "unknown"


@pytest.mark.slow
def test_trajectories_roll_and_the_frustum_has_the_pictures_shape(
    desk_browser, running, picture_world, opened, settled
):
    with opened(desk_browser, running.url, "try/wide") as page:
        settled(page)
        rolled = replace_roll(picture_world.pose.T_map_camera, np.radians(30))
        table = TrajectoryTable(np.array([0.0]), np.array([0]), rolled[None], np.ones(1), np.array([9]))
        read = page.evaluate(
            "async (text) => (await import('/web/console/trajectory.js')).readTrajectory(text)[0].T",
            trajectory_csv(table),
        )
        np.testing.assert_allclose(read, rolled, atol=1e-4)
        without = "\n".join(",".join(line.split(",")[:7]) for line in trajectory_csv(table).splitlines())
        upright = page.evaluate(
            "async (text) => (await import('/web/console/trajectory.js')).readTrajectory(text)[0].T", without
        )
        np.testing.assert_allclose(upright, picture_world.pose.T_map_camera, atol=1e-4)
        extents = page.evaluate(
            """async () => {
                const m = await import('/web/console/intrinsics.js');
                const camera = {width: 1280, height: 720, fx: 1040, fy: 1040, cx: 639.5, cy: 359.5, distortion: []};
                return m.halfExtents(m.intrinsicsFor(camera, 640, 360), 640, 360);
            }"""
        )
        assert extents[0] / extents[1] == pytest.approx(16 / 9)


def replace_roll(T_map_camera, roll):
    """The pose turned about its optical axis."""
    cos, sin = np.cos(roll), np.sin(roll)
    turn = np.eye(4)
    turn[:2, :2] = [[cos, -sin], [sin, cos]]
    return T_map_camera @ turn


@pytest.mark.slow
def test_the_landscape_around_the_pose_is_shown_until_another_picture_is_tried(
    desk_browser, running, pictures, opened, settled
):
    with opened(desk_browser, running.url, "try/room") as page:
        take(settled(page), pictures / "frame.png")
        page.get_by_role("button", name="Show the landscape").click()
        landscape = page.locator("canvas.landscape")
        expect(landscape).to_have_attribute("aria-label", re.compile("around the pose"))
        bright = COPY.replace("RESULT", "data.filter((red, i) => i % 4 === 0 && red > 200 && data[i + 1] > 200).length")
        assert landscape.evaluate(bright) > 50
        page.get_by_role("button", name="Play the ascents").click()
        take(page, pictures / "blank.png")
        expect(page.locator(".answer")).to_contain_text("no pose")
        expect(landscape).to_have_count(0)
        page.get_by_role("button", name="Show the landscape").click()
        expect(page.get_by_text("Too little in the picture matches")).to_be_visible()


@pytest.mark.slow
def test_an_answer_is_copied_as_a_program_that_gets_it_again(
    desk_browser, running, pictures, opened, settled, tmp_path
):
    with opened(desk_browser, running.url, "try/room", permissions=["clipboard-write", "clipboard-read"]) as page:
        take(settled(page), pictures / "frame.png")
        expect(page.locator(".answer")).to_contain_text("localized")
        programs = {}
        for name in ("curl", "Python", "JavaScript"):
            page.get_by_role("button", name=f"Copy as {name}").click()
            expect(page.locator(".copy pre")).to_be_visible()
            programs[name] = page.locator(".copy pre").text_content()
    (tmp_path / "frame.png").write_bytes((pictures / "frame.png").read_bytes())
    (tmp_path / "ask.py").write_text(programs["Python"])
    (tmp_path / "ask.mjs").write_text(programs["JavaScript"])
    commands = [["bash", "-c", programs["curl"]], [sys.executable, "ask.py"], ["node", "ask.mjs"]]
    for command in commands:
        if shutil.which(command[0]) is None:
            continue
        ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
        assert ran.returncode == 0, ran.stderr
        assert "position" in ran.stdout


@pytest.fixture(scope="module")
def camera_browser(fake_camera, picture_world):
    """A Chromium whose camera shows the map's own picture."""
    browser = fake_camera([picture_world.image] * 10)
    yield browser
    browser.close()


@pytest.mark.slow
def test_the_camera_is_tracked_and_the_track_says_when_it_is_lost_and_when_it_jumps(
    camera_browser, running, picture_world, opened, settled
):
    changes: dict[str, object] = {}

    def meddle(socket):
        server = socket.connect_to_server()

        def hear(text):
            message = json.loads(text)
            if message["type"] == "tracked":
                message |= {name: value for name, value in changes.items() if name != "aside"}
                if message["pose"] is not None and "aside" in changes:
                    message["pose"]["position"][0] += changes["aside"]
            socket.send(json.dumps(message))

        server.on_message(hear)

    # A picture on its way through the meddler, which hands it on later, may find the connection closed by the page.
    late = "WebSocket is already in CLOSING or CLOSED state"
    with opened(camera_browser, running.url, "try/room", permissions=["camera"], ignored=late) as page:
        page.route_web_socket("**/track", meddle)
        settled(page).get_by_role("button", name="Use the camera").click()
        answer = page.locator(".answer")
        expect(answer.locator(".badge")).to_have_text("tracking")
        shown = re.search(r"Position(-?[\d.]+), (-?[\d.]+), (-?[\d.]+) m", answer.text_content() or "")
        np.testing.assert_allclose([float(one) for one in shown.groups()], picture_world.pose.position, atol=0.05)
        expect(answer).to_contain_text(re.compile(r"Off by about[\d.]+ cm"))
        expect(answer).to_contain_text("Jumps0")
        changes |= {"reset_counter": 1, "aside": 0.42}
        expect(answer).to_contain_text("The pose jumped by 42 cm")
        expect(answer).to_contain_text("Jumps1")
        changes |= {"status": "lost"}
        expect(answer.locator(".badge")).to_have_text("lost")
        expect(answer).to_contain_text("the pose is a guess")
        page.get_by_role("button", name="Stop the camera").click()
        expect(page.get_by_role("button", name="Use the camera")).to_be_visible()
        expect(page.get_by_role("alert")).to_have_count(0)


@pytest.mark.slow
def test_a_video_is_tracked_to_its_end(desk_browser, running, picture_world, opened, settled, tmp_path):
    height, width = picture_world.image.shape[:2]
    film = cv2.VideoWriter(str(tmp_path / "film.webm"), cv2.VideoWriter_fourcc(*"VP80"), 10, (width, height))
    for _ in range(30):
        film.write(picture_world.image)
    film.release()
    with opened(desk_browser, running.url, "try/room") as page:
        take(settled(page), tmp_path / "film.webm")
        expect(page.get_by_role("button", name="Stop the video")).to_be_visible()
        expect(page.locator(".answer .badge")).to_have_text("tracking")
        expect(page.get_by_role("button", name="Use the camera")).to_be_visible()  # it has come to its end
        expect(page.locator(".answer .badge")).to_have_text("stopped")
        (tmp_path / "broken.webm").write_bytes(b"\x1a\x45\xdf\xa3 no video")
        take(page, tmp_path / "broken.webm")
        expect(page.get_by_role("alert")).to_contain_text("not a video that the browser can play")


@pytest.mark.slow
def test_a_track_whose_connection_breaks_off_says_so(camera_browser, running, opened, settled):
    late = "WebSocket is already in CLOSING or CLOSED state."  # of a frame that playwright hands on after it closed
    with opened(camera_browser, running.url, "try/room", permissions=["camera"], ignored=late) as page:
        sockets = []

        def keep(socket):
            socket.connect_to_server()
            sockets.append(socket)

        page.route_web_socket("**/track", keep)
        settled(page).get_by_role("button", name="Use the camera").click()
        expect(page.locator(".answer .badge")).to_have_text("tracking")
        sockets[0].close(code=1011)
        expect(page.get_by_role("alert")).to_contain_text("The connection broke off.")
        expect(page.locator(".answer .badge")).to_have_text("tracking")  # the server is there again
        expect(page.get_by_role("button", name="Stop the camera")).to_be_visible()
