"""The clients against a running service; arrays become PNG files."""

import asyncio
import inspect
import threading
import zipfile
from contextlib import contextmanager
from dataclasses import replace

import cv2
import numpy as np
import pytest

import rholoc_client
from rholoc.features import get_extractor
from rholoc.library.recordings import RecordingStore
from rholoc.maps import map_to_bytes
from rholoc.reports import MapReport, report_from_json
from rholoc_client import (
    AsyncClient,
    Camera,
    Client,
    ConnectionFailed,
    Features,
    Frame,
    JobFailed,
    Prior,
    UnknownMap,
    WaitTimedOut,
)
from rholoc_client._images import encoded

_PATIENCE_S = 120.0  # the clients' own ten seconds are for machines at rest


class Blocking:
    """An AsyncClient that is waited for, so that one test serves both clients."""

    def __init__(self, url):
        self._loop = asyncio.new_event_loop()
        self._client = AsyncClient(url, timeout_s=_PATIENCE_S)

    def __getattr__(self, name):
        method = getattr(self._client, name)
        assert inspect.iscoroutinefunction(method)
        return lambda *args, **options: self._loop.run_until_complete(method(*args, **options))

    def end(self):
        self._loop.run_until_complete(self._client.close())
        self._loop.close()


@contextmanager
def connected(kind, url):
    if kind == "sync":
        with Client(url, timeout_s=_PATIENCE_S) as client:
            yield client
    else:
        client = Blocking(url)
        yield client
        client.end()


BOTH = pytest.mark.parametrize("client", ["sync", "async"], indirect=True)


@pytest.fixture
def client(request, service):
    """The blocking client, which is written from the asynchronous one; each of the two where a test is marked so."""
    with connected(getattr(request, "param", "sync"), service.url) as client:
        yield client


def feature_lists(world) -> Features:
    found = get_extractor("gray").extract(world.image)
    return Features(
        width=640,
        height=480,
        pixels=found.pixels,
        descriptors=[row.tobytes() for row in found.descriptors],
        channels=found.channels,
        sizes_px=found.sizes,
        angles_deg=np.degrees(found.angles),
    )


@BOTH
def test_a_robots_loop(client, picture_world):
    camera, prior = Camera(520.0, 520.0, 319.5, 239.5), None
    for _ in range(2):
        answer = client.localize("room", picture_world.image, camera=camera, prior=prior, dof=6)
        assert answer.localized
        prior = answer.pose.as_prior(radius_m=0.5)
    np.testing.assert_allclose(answer.pose.position, picture_world.pose.position, atol=0.02)
    assert (answer.map, answer.map_version, answer.scale) == ("room", 3, "metric")
    assert isinstance(prior, Prior)


def test_pictures_and_descriptor_sets_give_the_same_pose(client, picture_world, tmp_path):
    (tmp_path / "frame.png").write_bytes(picture_world.png())
    answers = [
        client.localize("room", tmp_path / "frame.png", dof=6),
        client.localize("room", picture_world.png(), dof=6),
        client.localize("room", picture_world.image, dof=6),
        client.localize_descriptors("room", feature_lists(picture_world), dof=6),
    ]
    for answer in answers[1:]:
        np.testing.assert_allclose(answer.pose.T_map_camera, answers[0].pose.T_map_camera, atol=1e-9)


def test_several_frames(client, picture_world):
    still = {"position": (0, 0, 0), "quaternion_xyzw": (0, 0, 0, 1)}
    camera = Camera(520.0, 520.0, 319.5, 239.5)
    pictures = [Frame(picture_world.png(), **still), Frame(picture_world.image, **still, camera=camera)]
    features = [Frame(feature_lists(picture_world), **still)] * 2
    for frames in (pictures, features, [pictures[0], features[0]]):
        answer = client.localize_together("room", frames, camera=camera, sigma_m=0.01, sigma_deg=0.5)
        assert answer.localized
        assert [frame.pose is not None for frame in answer.frames] == [True, True]
        assert answer.frames[0].pose == answer.pose
        np.testing.assert_allclose(answer.pose.position, picture_world.pose.position, atol=0.02)
    assert client.localize("room", picture_world.png()).frames == ()
    with pytest.raises(rholoc_client.InvalidInput, match="1 frames"):
        client.localize_together("room", pictures[:1])


def test_places(client, picture_world):
    found = client.places(None, picture_world.png(), limit=100)
    assert {place.map for place in found} == {"room", "loose"}
    assert [place.score for place in found] == sorted((place.score for place in found), reverse=True)
    assert len(client.places("room", picture_world.image, limit=1)) == 1
    np.testing.assert_allclose(
        client.places(["room"], picture_world.png())[0].pose.position, picture_world.pose.position, atol=0.5
    )
    with pytest.raises(rholoc_client.UnknownMap):
        client.places("attic", picture_world.png())


def test_several_maps(client, picture_world):
    assert client.localize(None, picture_world.png()).map in ("room", "loose")
    assert client.localize(["loose"], picture_world.png()).scale == "arbitrary"
    with pytest.raises(rholoc_client.UnknownMap):
        client.localize(["loose", "attic"], picture_world.png())


def test_maps(client, picture_world, looking):
    assert [one.name for one in client.maps()] == ["loose", "room"]
    room = client.map("room")
    assert room.camera == Camera(520.0, 520.0, 319.5, 239.5, (), 640, 480)
    content = client.download_map("room")
    assert client.upload_map("copy", content).landmarks == room.landmarks
    assert client.rename_map("copy", "other").name == "other"
    client.delete_map("other")
    assert report_from_json(MapReport, client.map_report("room")) == picture_world.map_.info.report
    assert client.map_preview("room").startswith(b"\x89PNG")
    assert client.map_report_picture("room").startswith(b"\x89PNG")
    assert client.download_map("room", "ply").startswith(b"ply\n")
    assert client.download_map("room", "surfaces", features=[0, 2]).count(b"<Piece") == 2
    small = client.upload_map("small", map_to_bytes(looking(1)))
    assert client.upload_map("copy", client.download_map("small", "csv")).landmarks == small.landmarks
    client.delete_map("small")
    client.delete_map("copy")
    assert client.readiness()["maps"] == "ok"


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda client: client.localize("attic", b""), "UnknownMap"),
        (lambda client: client.localize("room", b"hello"), "InvalidImage"),
        (lambda client: client.localize("room", b"hello", dof=4), "InvalidRequest"),
        (
            lambda client: client.localize_descriptors("room", Features(640, 480, [(1, 2)], [b"x"])),
            "InvalidDescriptors",
        ),
        (lambda client: client.map(".."), "InvalidName"),
        (lambda client: client.upload_map("room", b"rubbish"), "InvalidMap"),
        (lambda client: client.rename_map("room", "loose"), "Conflict"),
        (lambda client: client.job("nonsense"), "UnknownJob"),
        (lambda client: client.update_map("room", "0" * 32, poses="guessed"), "InvalidRequest"),
        (lambda client: client.merge_maps("room", "attic", "both"), "UnknownMap"),
        (lambda client: client.forget_recording("room", "walk"), "InvalidInput"),
    ],
)
def test_errors_are_the_services(client, call, error):
    with pytest.raises(getattr(rholoc_client, error)) as caught:
        call(client)
    assert caught.value.message
    assert caught.value.request_id


def test_a_camera_that_is_absurd(client, picture_world):
    with pytest.raises(rholoc_client.InvalidCamera):
        client.localize("room", picture_world.png(), camera=Camera(-1.0, 1.0, 0.0, 0.0))


@BOTH
def test_a_folder_is_uploaded_as_a_zip_file(client, service, tmp_path):
    folder = tmp_path / "walk"
    (folder / "frames").mkdir(parents=True)
    (folder / "frames" / "0001.jpg").write_bytes(b"\xff\xd8\xff" * 200_000)
    (folder / "imu.csv").write_text("timestamp,ax\n" + "0,1\n" * 1000)
    (folder / ".hidden").write_text("no")
    heard = []
    job = client.upload_recording(
        folder, "hall", poses="visual", camera=Camera(500.0, 500.0, 320.0, 240.0), progress=lambda *at: heard.append(at)
    )
    assert (job.map, job.state) == ("hall", "queued")
    stored = RecordingStore(service.settings.data_dir).path(job.recording)
    assert stored.name == "walk.zip"
    with zipfile.ZipFile(stored) as archive:
        assert archive.namelist() == ["frames/0001.jpg", "imu.csv"]
    assert heard == sorted(heard)
    assert heard[-1] == (stored.stat().st_size, stored.stat().st_size)
    client.cancel_job(job.id)


@BOTH
def test_a_video_with_waypoints(client, service, tmp_path):
    (tmp_path / "walk.mp4").write_bytes(b"\0\0\0\x18ftypmp42" + b"\0" * 1000)
    (tmp_path / "measured.csv").write_text("name,time,x,y,z\n")
    job = client.upload_recording(tmp_path / "walk.mp4", "hall", waypoints=tmp_path / "measured.csv")
    with zipfile.ZipFile(RecordingStore(service.settings.data_dir).path(job.recording)) as archive:
        assert archive.namelist() == ["walk.mp4", "waypoints.csv"]
    with pytest.raises(rholoc_client.InvalidRecording, match="into the ZIP"):
        client.upload_recording(tmp_path / "walk.zip", "hall", waypoints=tmp_path / "measured.csv")
    assert job.id in [one.id for one in client.jobs()]
    with pytest.raises(WaitTimedOut):
        client.wait_for_job(job.id, timeout_s=0.05, poll_s=0.01)
    client.cancel_job(job.id)
    heard = []
    with pytest.raises(JobFailed):
        client.wait_for_job(job.id, progress=heard.append)
    assert [one.state for one in heard] == ["cancelled"]
    assert client.retry_job(job.id).state == "queued"
    client.cancel_job(job.id)


def test_a_service_that_is_not_there():
    with pytest.raises(ConnectionFailed, match=r"127\.0\.0\.1:9"), Client("http://127.0.0.1:9", retries=0) as nobody:
        nobody.maps()


def test_a_pose_is_frozen(picture_world, service):
    with Client(service.url) as client:
        pose = client.localize("room", picture_world.png()).pose
    assert replace(pose, roll_deg=1.0) != pose
    with pytest.raises(AttributeError):
        pose.roll_deg = 2.0


def test_streams_are_read_as_they_come(serve, picture_world):
    running = serve(live=True)
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    with connected("sync", running.url) as client:
        stream = client.live("room")
        answered = threading.Timer(1.0, lambda: client.localize("room", picture_world.png()))
        answered.start()
        (pose,) = next(stream)
        np.testing.assert_allclose(pose["position"], picture_world.pose.position, atol=0.02)
        assert [one["kind"] for one in client.streams()] == ["events"]
        stream.close()
        answered.join()
        with pytest.raises(UnknownMap):
            next(client.live("attic"))


def test_a_stream_is_read_by_asyncio(serve, tmp_path):
    (tmp_path / "walk.mp4").write_bytes(b"\0\0\0\x18ftypisom" + b"x" * 100)

    async def last_of(url):
        async with AsyncClient(url, timeout_s=_PATIENCE_S) as client:
            job = await client.upload_recording(tmp_path / "walk.mp4", "hall")
            events = client.job_events(job.id)
            assert (await anext(events)).state == "queued"
            await client.cancel_job(job.id)
            return [event async for event in events][-1]

    ended = asyncio.run(last_of(serve().url))
    assert (ended.has_ended, ended.state) == (True, "cancelled")


def test_what_the_rarer_methods_answer(client, picture_world):
    client.localize("room", picture_world.png())
    assert client.map_versions("room") == []
    assert client.map_coverage("room")["sufficient"] > 0
    landmarks = len(picture_world.map_)
    assert int.from_bytes(client.map_scene("room")[:4], "little") == landmarks
    assert int.from_bytes(client.map_scene("room", landmarks=3)[:4], "little") <= 3
    assert client.map_feature("room", 0)["feature"] == 0
    assert client.map_names("room") == {"type": "FeatureCollection", "frame": "map", "features": []}
    assert client.landscape("room", picture_world.png())["map"] == "room"
    assert client.health()["version"]
    assert "rholoc_" in client.metrics()
    assert client.upload_rules()["tus-version"] == "1.0.0"
    assert all(isinstance(client.recording(one["id"])["files"], list) for one in client.recordings())
    assert client.uploads() == client.streams() == client.keys() == []
    assert len(client.audit(limit=1)) <= 1
    assert client.draw_qr("https://rholoc.example").rstrip().endswith("</svg>")
    assert client.geopose_status() == {"status": "running"}


@pytest.mark.parametrize("shape", [(7, 11, 3), (7, 11), (1, 1), (480, 640, 3)])
def test_an_array_comes_back_from_its_png(shape):
    image = np.random.default_rng(1).integers(0, 256, shape, dtype=np.uint8)
    content, kind = encoded(image)
    assert kind == "image/png"
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED), image)


def test_a_slice_of_an_array_is_an_array():
    image = np.random.default_rng(1).integers(0, 256, (20, 30, 3), dtype=np.uint8)[::2, 3:9]
    content, _ = encoded(image)
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED), image)


def test_files_are_sent_as_they_are(tmp_path):
    (tmp_path / "a.jpg").write_bytes(b"\xff\xd8\xff123")
    assert encoded(tmp_path / "a.jpg") == (b"\xff\xd8\xff123", "image/jpeg")
    assert encoded(str(tmp_path / "a.jpg")) == (b"\xff\xd8\xff123", "image/jpeg")
    assert encoded(b"\x89PNG\r\n\x1a\n123") == (b"\x89PNG\r\n\x1a\n123", "image/png")


@pytest.mark.parametrize("image", [np.zeros((4, 4), np.float32), np.zeros((4, 4, 4), np.uint8), np.zeros(4, np.uint8)])
def test_other_arrays_are_no_pictures(image):
    with pytest.raises(ValueError, match="uint8"):
        encoded(image)


def test_what_is_no_picture_at_all_is_named():
    with pytest.raises(ValueError, match="not NoneType"):
        encoded(None)
