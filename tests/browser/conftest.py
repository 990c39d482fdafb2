"""Debian's Chromium, driven by playwright; and the fake phone that the recorder runs on."""

import os
import shutil
import socket
import sys
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, Playwright, expect, sync_playwright

from rholoc.geometry import ByteArray

sys.path.insert(0, str(Path(__file__).parent))  # for walking_phone

PATIENCE_MS = 120_000  # only a stuck page takes so long, or a busy machine
# Chromium draws two pages of its address bar, in a process of their own, for every window: two thirds of a window's
# processor time. The last switch counts, so it has to name what Playwright turns off, too.
_FEATURES_OFF = (
    "WebUIOmniboxPopup,WebUIOmniboxAimPopup,SpareRendererForSitePerProcess,"
    "AvoidUnnecessaryBeforeUnloadCheckSync,DestroyProfileOnBrowserClose,HttpsUpgrades,HttpsFirstBalancedModeAutoEnable,"
    "AimEnabled,AvoidCorsURLLoaderRestartOnRedirect,LensOverlay,MediaRouter,PaintHolding,ThirdPartyStoragePartitioning,OptimizationHints,NetworkTimeServiceQuerying,PreconnectToSearch"
)


class _Shared:
    """Playwright, and browsers that several modules use: to start them takes seconds of processor time."""

    def __init__(self) -> None:
        self._open = ExitStack()
        self._playwright: Playwright | None = None
        self._browsers: dict[str, Browser] = {}

    def playwright(self) -> Playwright:
        if self._playwright is None:
            self._playwright = self._open.enter_context(sync_playwright())
        return self._playwright

    def browser(self, name: str, start: Callable[[], Browser]) -> Browser:
        """The browser of this name; ``start`` starts it if there is none any more."""
        if name not in self._browsers or not self._browsers[name].is_connected():
            self._browsers[name] = start()
            self._open.callback(self._browsers[name].close)
        return self._browsers[name]

    def close(self) -> None:
        self._playwright, self._browsers = None, {}
        self._open.close()


_SHARED = _Shared()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None, None, None]:
    """Hook of pytest: Playwright ends before tests of other folders begin, for its event loop would be in their way."""
    try:
        return (yield)
    finally:
        if nextitem is None or not nextitem.path.is_relative_to(Path(__file__).parent):
            _SHARED.close()


@pytest.fixture(scope="module")
def playwright() -> Playwright:
    """Playwright itself. Slow pages are waited for."""
    expect.set_options(timeout=PATIENCE_MS)
    return _SHARED.playwright()


@pytest.fixture(scope="module")
def launch(playwright: Playwright) -> Callable[..., Browser]:
    """Starts Chromium with further command line arguments; the caller closes it."""
    executable = shutil.which("chromium")
    if executable is None:
        if os.environ.get("RHOLOC_REQUIRE_BROWSER") == "1":
            pytest.fail("RHOLOC_REQUIRE_BROWSER=1, but Chromium is absent: apt-get install chromium")
        pytest.skip("Chromium is absent: apt-get install chromium")
    # Tests run as root in containers, where Chromium's sandbox does not.
    return lambda *arguments: playwright.chromium.launch(
        executable_path=executable,
        args=["--no-sandbox", f"--disable-features={_FEATURES_OFF}", *arguments],
        timeout=60_000,
    )


@pytest.fixture(scope="module")
def fake_camera(launch: Callable[..., Browser], tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Browser]:
    """Starts a Chromium whose camera shows pictures (H, W, 3) BGR, so many a second, over and over."""

    def start(pictures: Iterable[ByteArray], fps: int = 30) -> Browser:
        film = tmp_path_factory.mktemp("camera") / "film.y4m"
        with film.open("wb") as file:
            for number, picture in enumerate(pictures):
                height, width = picture.shape[:2]
                if number == 0:
                    file.write(f"YUV4MPEG2 W{width} H{height} F{fps}:1 Ip A1:1 C420\n".encode())
                file.write(b"FRAME\n" + cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_I420).tobytes())
        return launch(
            "--use-fake-device-for-media-stream",
            "--use-fake-ui-for-media-stream",
            f"--use-file-for-fake-video-capture={film}",
            "--host-resolver-rules=MAP rholoc.test 127.0.0.1",  # a name that does not count as this machine
        )

    return start


@pytest.fixture(scope="module")
def phone_browser(fake_camera: Callable[..., Browser]) -> Browser:
    """A Chromium whose camera pans over a textured wall."""

    def start() -> Browser:
        rng = np.random.default_rng(0)
        texture = rng.integers(60, 220, (60, 160, 3), dtype=np.uint8)
        wall = cv2.resize(texture, (1280, 480), interpolation=cv2.INTER_CUBIC)
        return fake_camera([wall[:, 4 * i : 4 * i + 640] for i in range(150)])

    return _SHARED.browser("phone", start)


class Wire:
    """A TCP relay in front of a server, to cut connections with: what a phone at the edge of the WLAN goes through."""

    def __init__(self, target: tuple[str, int]) -> None:
        self.target = target
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self.listener.getsockname()[1]}"
        self.up = True
        self.left: int | None = None  # bytes towards the server until the wire breaks
        self.sent = 0
        self._open: set[socket.socket] = set()
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Break all connections, and take no new ones."""
        self.up = False
        for one in list(self._open):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def cut_after(self, count: int) -> None:
        """Cut once so many more bytes have gone to the server."""
        self.left = count

    def mend(self) -> None:
        """Take connections again."""
        self.up = True

    def close(self) -> None:
        """Break it for good."""
        self.cut()
        self.listener.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self.listener.accept()
                threading.Thread(target=self._relay, args=(client,), daemon=True).start()

    def _relay(self, client: socket.socket) -> None:
        with closing(client), suppress(OSError):
            if not self.up:
                return
            with closing(socket.create_connection(self.target)) as server:
                self._open |= {client, server}
                back = threading.Thread(target=self._pump, args=(server, client), daemon=True)
                back.start()
                self._pump(client, server, counted=True)
                back.join()
                self._open -= {client, server}

    def _pump(self, source: socket.socket, sink: socket.socket, counted: bool = False) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                if counted and self.left is not None:
                    data, broken = data[: self.left], len(data) >= self.left
                    self.left -= len(data)
                    if broken:
                        sink.sendall(data)
                        self.sent += len(data)
                        self.left = None
                        self.cut()
                        return
                sink.sendall(data)
                self.sent += len(data) if counted else 0
        for one in (source, sink):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)


@pytest.fixture
def wire() -> Iterator[Callable[[tuple[str, int]], Wire]]:
    """Lays wires to servers; they are broken at the end."""
    laid: list[Wire] = []

    def lay(target: tuple[str, int]) -> Wire:
        laid.append(Wire(target))
        return laid[-1]

    yield lay
    for one in laid:
        one.close()


@pytest.fixture(scope="module")
def desk_browser(launch: Callable[..., Browser]) -> Browser:
    """A Chromium that draws in 3-D without a graphics card."""
    return _SHARED.browser("desk", lambda: launch("--enable-unsafe-swiftshader"))


@pytest.fixture(scope="session")
def opened() -> Callable[..., AbstractContextManager[Page]]:
    """Opens a page of the console; every error in Chromium's console fails the test.

    Chromium itself notes each answer of 400 and above there: the test says how many it expects (-1: any). What contains
    ``ignored`` comes from the test's own means. Nothing shimmers while it loads: drawn sixty times a second, that took
    two thirds of a waiting page's processor time.
    """
    return _opened


@contextmanager
def _opened(
    browser: Browser, url: str, where: str = "", failures: int = 0, ignored: str = "GPU stall", **options: Any
) -> Iterator[Page]:
    context = browser.new_context(**{"viewport": {"width": 1280, "height": 850}, "reduced_motion": "reduce", **options})
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    complaints: list[str] = []
    page.on("console", lambda message: message.type in ("error", "warning") and complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(f"{url}/#/{where}")
    yield page
    context.close()
    answers = [text for text in complaints if text.startswith("Failed to load resource")]
    heard = [text for text in complaints if not any(known in text for known in ("GPU stall", ignored))]
    assert [text for text in heard if text not in answers] == []
    assert failures in (-1, len(answers)), answers


@pytest.fixture(scope="session")
def settled() -> Callable[[Page], Page]:
    """Gives the page once nothing is loading any more."""

    def settle(page: Page) -> Page:
        expect(page.locator("main h1, main h2").first).to_be_visible()
        expect(page.locator("main [aria-busy]")).to_have_count(0, timeout=120_000)  # pictures are drawn meanwhile
        return page

    return settle
