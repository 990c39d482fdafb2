"""What all tests share."""

from __future__ import annotations

import fcntl
import functools
import gc
import os
import pickle
import socket
import ssl
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import cv2
import httpx
import numpy as np
import pytest
import uvicorn
from hypothesis import settings as hypothesis_settings
from typer.main import get_command as _get_command

from rholoc.features import FeatureSet, Metric, get_extractor
from rholoc.geometry import (
    UP,
    ByteArray,
    Camera,
    FloatArray,
    Pose,
    angles_between,
    cross,
    patch_appearance,
    poses_from_rows,
)
from rholoc.mapping.build.assembly import assemble
from rholoc.mapping.build.landmarks import are_stable, triangulate
from rholoc.mapping.build.stored_observations import with_landmarks
from rholoc.mapping.build.tracks import Views, link_observations
from rholoc.maps import (
    DensityKind,
    Map,
    MapDescriptors,
    MapInfo,
    MapLandmarks,
    MapObservations,
    MapViews,
    MapWaypoint,
    Source,
    map_to_bytes,
)
from rholoc.processes import program
from rholoc.reports import HeldOutReport, MapReport
from rholoc.simulation import Scene, make_test_site

if TYPE_CHECKING:
    from fastapi import FastAPI

    from postgres_server import PostgresServer
    from rholoc.service import Settings

# The tests wait for events, not for seconds: the service's default deadline and httpx's are for machines at rest.
_PATIENCE_S = 60.0
for _part in ("connect", "read", "write", "pool"):
    setattr(httpx._config.DEFAULT_TIMEOUT_CONFIG, _part, _PATIENCE_S)  # bound in the signatures of httpx's functions

# What is not urgent runs with a low priority: beside other tests it would hardly advance, and its own test would wait.
program.BACKGROUND_NICENESS = 0  # before a module copies it

# httpx reads the certificates of all authorities for every request that has no client: 20 ms of each of thousands.
_create_ssl_context = httpx._transports.default.create_ssl_context


@functools.cache
def _ssl_context_of(*trusted: str | None) -> ssl.SSLContext:
    return _create_ssl_context()


def _quick_ssl_context(verify: ssl.SSLContext | str | bool = True, **options: Any) -> ssl.SSLContext:
    if verify is True:
        return _ssl_context_of(os.environ.get("SSL_CERT_FILE"), os.environ.get("SSL_CERT_DIR"))
    return _create_ssl_context(verify, **options)


httpx._transports.default.create_ssl_context = _quick_ssl_context

# While five thousand tests are collected nothing is garbage, and afterwards the collector need not look at them again;
# nor, every 700 objects, at the applications of services that run.
gc.disable()
gc.set_threshold(50_000, 20, 50)

# As many examples as find what is easily wrong; each run draws others.
hypothesis_settings.register_profile("rholoc", max_examples=40, deadline=None)
hypothesis_settings.load_profile("rholoc")

sys.path.insert(0, str(Path(__file__).parent))  # of what tests of several packages share

_REAL_DATA = Path(__file__).parents[2] / "shared" / "data"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Hook of pytest: folders whose tests take minutes begin first, so that no process ends alone with one of them."""
    items.sort(key=lambda item: item.path.parent.name not in ("real", "worker"))


def pytest_collection_finish() -> None:
    """Hook of pytest."""
    gc.enable()
    gc.freeze()


def pytest_sessionfinish() -> None:
    """Hook of pytest, which then collects garbage five times: a second of each process, of all that the tests left."""
    gc.freeze()


@functools.cache
def _tree_of_commands(app: Any) -> Any:
    """What Typer makes of a command's functions, 0.1 s each time; once for all runs in this process, for nothing
    changes them.
    """
    return _get_command(app)


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Runs ``rholoc``: arguments → (exit status, standard output, standard error)."""

    from rholoc.cli import main

    monkeypatch.setattr("typer.main.get_command", _tree_of_commands)

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["rholoc", *map(str, arguments)])
        try:
            main()
            status: Any = 0
        except SystemExit as ended:
            status = ended.code or 0
        printed = capsys.readouterr()
        return int(status), printed.out, printed.err

    return run


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real recordings beside the project; skips where it is absent, unless they are required."""
    if not _REAL_DATA.is_dir():
        if os.environ.get("RHOLOC_REQUIRE_REAL_DATA") == "1":
            pytest.fail("RHOLOC_REQUIRE_REAL_DATA=1, but the real recordings are absent.")
        pytest.skip("the real recordings are absent")
    return _REAL_DATA


MadeOnce = Callable[[str, Callable[[], Any]], Any]


@pytest.fixture(scope="session")
def made_once(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> MadeOnce:
    """Makes a costly product once for all processes of a run: (its name, a function that makes it) → the product."""
    folder = tmp_path_factory.getbasetemp()
    if hasattr(request.config, "workerinput"):
        folder = folder.parent  # of a process of xdist; the parent is the run's

    def get(name: str, make: Callable[[], Any]) -> Any:
        kept = folder / f"{name}.pickle"
        with (folder / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not kept.exists():
                kept.write_bytes(pickle.dumps(make()))
        return pickle.loads(kept.read_bytes())

    return get


@pytest.fixture(scope="session")
def postgres() -> Iterator[PostgresServer]:
    """A PostgreSQL server of our own."""
    from postgres_server import PostgresServer

    server = PostgresServer()
    yield server
    server.close()


@pytest.fixture
def postgres_url(postgres: PostgresServer) -> str:
    """An empty database."""
    return postgres.create_database(f"test_{uuid.uuid4().hex}")


@dataclass(frozen=True, eq=False)
class PictureWorld:
    """A picture, the camera and pose it was taken with, and a map whose landmarks are what it shows."""

    image: ByteArray
    camera: Camera
    pose: Pose
    map_: Map

    @cached_property
    def _png(self) -> bytes:
        return cv2.imencode(".png", self.image)[1].tobytes()

    def png(self) -> bytes:
        """The picture as a PNG file."""
        return self._png

    def rho(self, **changes: Any) -> bytes:
        """The map as a file; ``changes`` are of its description."""
        return map_to_bytes(replace(self.map_, info=replace(self.map_.info, **changes)))


@pytest.fixture(scope="session")
def picture_world() -> PictureWorld:
    """A picture with a speckled disk of points 2–5 m away, and its map; small enough to localize in at once."""
    rng = np.random.default_rng(7)
    speckles = [cv2.resize(rng.random((48 * k, 64 * k)), (640, 480)) for k in (1, 2, 5)]
    image = np.uint8(255 * np.mean(speckles, axis=0))
    image = cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX)
    image = np.where(cv2.circle(np.zeros_like(image), (320, 240), 75, 1, -1), image, 128).astype(np.uint8)
    image = np.ascontiguousarray(np.repeat(image[:, :, None], 3, axis=2))
    camera = Camera(640, 480, 520.0, 520.0, 319.5, 239.5)
    pose = Pose.from_heading(np.array([1.0, 2.0, 1.5]), np.array([0.8, 0.6, 0.0]))
    features = get_extractor("gray").extract(image)
    n, views = len(features), 4
    landmarks = pose.position + rng.uniform(2, 5, (n, 1)) * (camera.rays(features.pixels) @ pose.R_map_camera.T)
    covariances = np.tile(np.float32(0.002**2) * np.eye(3, dtype=np.float32), (n, 1, 1))
    sideways = np.linspace(-0.1, 0.1, views)[:, None] * pose.R_map_camera[:, 0]
    positions = pose.position + sideways
    info = MapInfo(
        id="00112233445566778899aabbccddeeff",
        version=3,
        density=DensityKind.RAY,
        features="gray",
        metric=True,
        upright=True,
        created="2026-01-02T03:04:05Z",
        camera=camera,
        sources=(Source("walk", frames=4),),
        waypoints=(MapWaypoint("W1", (1.0, 2.0, 1.5), 0.01),),
        report=MapReport(features=n, views=views, held_out=HeldOutReport(4, 4, median_m=0.015, p90_m=0.02)),
    )
    map_ = Map(
        info=info,
        landmarks=MapLandmarks(
            channels=features.channels, positions=landmarks.astype(np.float32), covariances=covariances
        ),
        descriptors=MapDescriptors(values=features.descriptors, features=np.arange(n, dtype=np.int32)),
        views=MapViews(
            times=np.arange(views, dtype=np.float64),
            T_map_camera=poses_from_rows(
                np.column_stack([positions, np.tile(pose.quaternion_xyzw, (views, 1))]).astype(np.float32)
            ),
        ),
        observations=MapObservations(
            views=np.repeat(np.arange(views, dtype=np.int32), n), features=np.tile(np.arange(n, dtype=np.int32), views)
        ),
    )
    return PictureWorld(image, camera, pose, map_)


@pytest.fixture(scope="session")
def looking(picture_world: PictureWorld) -> Callable[[int], Map]:
    """Small maps of rooms that look different, by number."""
    whole, some = picture_world.map_, 200
    views = np.arange(len(whole.views), dtype=np.int32)
    small = replace(
        whole,
        landmarks=replace(
            whole.landmarks,
            channels=whole.landmarks.channels[:some],
            positions=whole.landmarks.positions[:some],
            covariances=whole.landmarks.covariances[:some],
        ),
        descriptors=replace(whole.descriptors, features=whole.descriptors.features[:some]),
        observations=replace(
            whole.observations,
            views=np.repeat(views, some),
            features=np.tile(np.arange(some, dtype=np.int32), len(views)),
        ),
    )

    def room(number: int) -> Map:
        shape = (some, whole.descriptors.values.shape[1])
        return replace(
            small,
            descriptors=replace(
                small.descriptors, values=np.random.default_rng(number).integers(0, 256, shape, np.uint8)
            ),
        )

    return room


@dataclass(frozen=True, eq=False)
class PointRoom:
    """Points on the walls of a room, each with a descriptor, and a camera that sees them with noise.

    The patch that a descriptor describes faces the middle of the room; its orientation and size follow from it.
    """

    points: FloatArray
    descriptors: ByteArray
    camera: Camera
    noise_px: float = 0.5
    flipped_bits: int = 12
    _maps: dict[tuple[bytes, str], Map] = field(default_factory=dict, init=False)

    @cached_property
    def patches(self) -> FloatArray:
        """(N, 3) metres, see :class:`Map`."""
        across = cross(np.broadcast_to(UP, self.points.shape), self.points)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        turn, size = self.descriptors[:, :2].T / 256
        along = np.cos(2 * np.pi * turn)[:, None] * across + np.sin(2 * np.pi * turn)[:, None] * UP
        return np.asarray(along * (0.05 + 0.15 * size)[:, None])

    def see(self, pose: Pose, seed: int, share: float = 0.7) -> FeatureSet:
        """What a camera at ``pose`` detects: the points in view, some missed, pixels and descriptors disturbed."""
        rng = np.random.default_rng(seed)
        pixels = self.camera.project((self.points - pose.position) @ pose.R_map_camera)
        seen = np.flatnonzero(self.camera.contains(pixels) & (rng.random(len(pixels)) < share))
        bits = np.unpackbits(self.descriptors[seen], axis=1)
        flips = rng.random(bits.shape) < self.flipped_bits / bits.shape[1]
        n = len(seen)
        angles, sizes = patch_appearance(self.camera, pose.T_map_camera, self.points[seen], self.patches[seen])
        return FeatureSet(
            (pixels[seen] + rng.normal(size=(n, 2)) * self.noise_px).astype(np.float32),
            np.zeros(n, np.uint8),
            np.packbits(bits ^ flips, axis=1),
            (sizes * np.exp2(0.1 * rng.normal(size=n))).astype(np.float32),
            (angles + 0.05 * rng.normal(size=n)).astype(np.float32),
        )

    def patch_errors(self, map_: Map) -> tuple[FloatArray, FloatArray]:
        """How far each patch that a map of this room knows is from the nearest point's: degrees and octaves (F,)."""
        apart = np.linalg.norm(map_.landmarks.positions[:, None].astype(float) - self.points, axis=2)
        found, true = map_.landmarks.known_patches.astype(float), self.patches[apart.argmin(axis=1)]
        length, true_length = np.linalg.norm(found, axis=1), np.linalg.norm(true, axis=1)
        turned = np.rad2deg(angles_between(found / length[:, None], true / true_length[:, None]))
        return turned, np.abs(np.log2(length / true_length))

    def walk(self, count: int, sideways_m: float = 0.0) -> list[Pose]:
        """Upright poses along a curve through the room, turning as they go."""
        turns = np.linspace(0, 1.5 * np.pi, count)
        return [
            Pose.from_heading(
                np.array([np.cos(t) + sideways_m, np.sin(t), 1.4 + 0.05 * np.sin(5 * t)]),
                np.array([np.cos(t), np.sin(t), -0.05]),
            )
            for t in turns
        ]

    def into_corners(self) -> list[Pose]:
        """Nine views of near and far things, which show the focal length; a wall straight ahead leaves it open."""
        walk = self.walk(37, sideways_m=0.1)
        return [walk[corner + beside] for corner in (6, 18, 30) for beside in (-1, 0, 1)]

    def map_of(self, poses: Sequence[Pose], name: str) -> Map:
        """The map of a recording called ``name``, of cameras at known poses; made once, so nobody may change it."""
        T = np.array([pose.T_map_camera for pose in poses])
        known = T.tobytes(), name
        if known not in self._maps:
            self._maps[known] = self._made_map(poses, T, name)
        return self._maps[known]

    def _made_map(self, poses: Sequence[Pose], T: FloatArray, name: str) -> Map:
        seen = [self.see(pose, seed) for seed, pose in enumerate(poses)]
        views = Views.from_features([self.camera] * len(T), T, np.arange(len(T)) / 10, seen)
        landmarks = triangulate(views, link_observations(views, Metric.HAMMING))
        landmarks = landmarks.keep(are_stable(views, landmarks, 300))
        source = Source(name, f"{name}-id", self.camera)
        kind = DensityKind.RAY
        info = MapInfo("0" * 32, 1, kind, "gray", True, True, "2026-01-01T00:00:00Z", self.camera, (source,))
        return with_landmarks(assemble(info, views, landmarks, np.zeros(len(T), dtype=np.int64), Metric.HAMMING))


@pytest.fixture(scope="session")
def point_room() -> PointRoom:
    """A room of 6 × 5 × 3 m with 1200 points on its four walls."""
    rng = np.random.default_rng(11)
    n = 1200
    along, height, wall = rng.uniform(-1, 1, n), rng.uniform(0.2, 2.8, n), rng.integers(0, 4, n)
    x = np.choose(wall, [3.0 * along, np.full(n, 3.0), 3.0 * along, np.full(n, -3.0)])
    y = np.choose(wall, [np.full(n, 2.5), 2.5 * along, np.full(n, -2.5), 2.5 * along])
    descriptors = rng.integers(0, 256, (n, 32), dtype=np.uint8)
    return PointRoom(np.column_stack([x, y, height]), descriptors, Camera(640, 480, 520.0, 520.0, 319.5, 239.5))


@pytest.fixture(scope="session")
def site(made_once: MadeOnce) -> Scene:
    """The demo's room by seed 0."""
    return made_once("site", lambda: make_test_site(0))


@dataclass(frozen=True, eq=False)
class RunningService:
    """The service on a real socket of this machine."""

    url: str
    app: FastAPI
    settings: Settings

    @property
    def address(self) -> tuple[str, int]:
        """Host and port."""
        parts = urlsplit(self.url)
        assert parts.hostname is not None
        assert parts.port is not None
        return parts.hostname, parts.port


@pytest.fixture(scope="session")
def openapi() -> dict[str, Any]:
    """The service's description."""
    from rholoc.service import Settings, create_app

    return create_app(Settings()).openapi()


ServeFunction = Callable[..., RunningService]


@pytest.fixture(scope="module")
def serve(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServeFunction]:
    """Starts services with chosen settings, in folders of their own and without a worker; stops them at the end.

    They refuse at once: thousands of refusals of 20 ms each are a minute.
    """
    from rholoc.service import Settings, create_app
    from rholoc.service.http.connections import websocket_options

    started: list[tuple[uvicorn.Server, threading.Thread]] = []

    def start(**settings: Any) -> RunningService:
        folder = tmp_path_factory.mktemp("service")
        defaults = {"maps_dir": folder / "maps", "data_dir": folder / "data", "worker": False, "concurrency": 2}
        defaults["default_deadline_ms"] = 1000 * _PATIENCE_S
        chosen = Settings(**{**defaults, **settings})
        app = create_app(chosen)
        listener = socket.create_server(("127.0.0.1", 0))
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # as `rholoc serve` does: 40 ms of each request
        websockets = websocket_options(chosen.max_request_bytes)
        server = uvicorn.Server(uvicorn.Config(app, log_level="error", timeout_graceful_shutdown=2, **websockets))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
        thread.start()
        while not server.started:
            assert thread.is_alive(), "the service did not start"
            time.sleep(0.01)
        started.append((server, thread))
        return RunningService(f"http://127.0.0.1:{listener.getsockname()[1]}", app, chosen)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rholoc.service.http.boundary._REFUSAL_TAKES_S", 0.0)
        for module in ("maps.map_watch", "threads.compute"):  # they would hold the interpreter and wait for a core
            patch.setattr(f"rholoc.service.{module}._NICENESS", 0)
        yield start
    for server, _ in started:  # all at once: one by one they wait for each other
        server.should_exit = True
    for _, thread in started:
        thread.join(10)


@pytest.fixture(scope="module")
def service(serve: ServeFunction, picture_world: PictureWorld) -> RunningService:
    """A service with the map ``room``, metric, and the map ``loose``, of arbitrary scale."""
    running = serve()
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    (running.settings.maps_dir / "loose.rho").write_bytes(picture_world.rho(metric=False, version=1))
    return running
