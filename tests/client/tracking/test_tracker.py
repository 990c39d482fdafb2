"""The trackers against a running service, and the motion of pictures."""

import asyncio
from dataclasses import replace

import cv2
import httpx
import numpy as np
import pytest

from rholoc_client import (
    AsyncClient,
    AsyncTracker,
    Camera,
    Client,
    ConnectionFailed,
    InvalidTrack,
    Prior,
    Tracker,
    TrackStatus,
    UnknownMap,
)
from rholoc_client.tracking.following import FollowedTrack, fitted
from rholoc_client.tracking.pictures import PictureMotion
from rholoc_client.tracking.rigid import inverse, motion_between, moved, pose

CAMERA = Camera(520.0, 520.0, 319.5, 239.5, width=640, height=480)


@pytest.fixture
def client(service):
    with Client(service.url, timeout_s=30) as client:
        yield client


def settled(tracker, world, *, first_s=0.0, odometry=None):
    """Feed a picture until the track is settled; the last frame's time."""
    time_s = first_s
    for _ in range(6):
        time_s += 1.0
        tracker.track(time_s, world.image, odometry)
        if tracker.wait(30).status is TrackStatus.TRACKING:
            return time_s
    raise AssertionError("it never settled")


def test_odometry_is_placed_in_the_map(client, picture_world):
    with Tracker(client, "room", CAMERA) as tracker:
        time_s = settled(tracker, picture_world, odometry=np.eye(4))
        step = pose(np.eye(3), np.array([0.0, 0.0, 0.2]))
        tracked = tracker.track(time_s + 0.1, None, step)
        expected = picture_world.pose.T_map_camera @ step
        np.testing.assert_allclose(tracked.pose.position, expected[:3, 3], atol=0.02)
        np.testing.assert_allclose(tracked.T_map_odom, picture_world.pose.T_map_camera, atol=0.02)
        assert tracked.reset_counter == 0


def test_pictures_alone_are_followed(client, picture_world):
    """The camera turns: the picture of it is the first one, warped."""
    with Tracker(client, "room", CAMERA) as tracker:
        time_s = settled(tracker, picture_world)
        K = np.array([[520.0, 0, 319.5], [0, 520.0, 239.5], [0, 0, 1]])
        for turned_deg in np.arange(0.5, 5, 0.5):
            turn = cv2.Rodrigues(np.array([0.0, np.radians(turned_deg), 0.0]))[0]
            picture = cv2.warpPerspective(picture_world.image, K @ turn.T @ np.linalg.inv(K), (640, 480))
            time_s += 1 / 30
            tracked = tracker.track(time_s, picture)
        expected = picture_world.pose.T_map_camera @ pose(turn, np.zeros(3))
        apart = motion_between(np.array(tracked.pose.T_map_camera), expected)
        assert np.linalg.norm(apart[:3]) < 0.05
        assert np.degrees(np.linalg.norm(apart[3:])) < 1.0


def test_the_asynchronous_tracker_does_the_same(service, picture_world):
    async def run():
        client = AsyncClient(service.url, timeout_s=30)
        async with client, AsyncTracker(client, "room", CAMERA) as tracker:
            for time_s in (1.0, 2.0, 3.0):
                await tracker.track(time_s, picture_world.png(), np.eye(4))
                tracked = await tracker.wait(30)
            return tracked

    tracked = asyncio.run(run())
    assert tracked.status is TrackStatus.TRACKING
    np.testing.assert_allclose(tracked.pose.position, picture_world.pose.position, atol=0.02)


def test_an_unknown_map_is_an_error_of_the_caller(client, picture_world):
    with Tracker(client, "attic", CAMERA) as tracker:
        tracker.track(0.0, picture_world.image, np.eye(4))
        with pytest.raises(UnknownMap):
            tracker.wait(30)


def test_a_service_that_is_away_is_noted_and_survived(picture_world):
    """Its odometry goes on; the error is there to be read."""

    def away(request):
        raise httpx.ConnectError("nobody", request=request)

    client = Client("http://rholoc.test", retries=0, transport=httpx.MockTransport(away))
    with client, Tracker(client, "room", CAMERA) as tracker:
        tracker.track(0.0, picture_world.image, np.eye(4))
        assert tracker.wait(30).status is TrackStatus.SEARCHING
        assert isinstance(tracker.last_error, ConnectionFailed)
        tracker.track(1.0, picture_world.image, np.eye(4))


def test_an_expectation_is_sent_while_the_track_has_none(client, picture_world, monkeypatch):
    asked, localize = [], client.localize
    monkeypatch.setattr(client, "localize", lambda *of, **how: (asked.append(how["prior"]), localize(*of, **how))[1])
    expected = Prior((1.0, 2.0, 1.5), (0.8, 0.6, 0.0), radius_m=2.0)
    with Tracker(client, "room", CAMERA) as tracker:
        tracker.expect(expected)
        time_s = settled(tracker, picture_world, odometry=np.eye(4))
        assert asked[0] == expected
        tracker.track(time_s + 6, picture_world.image, np.eye(4))  # after a gap it begins anew
        tracker.wait(30)
        assert asked[-1] == expected
        tracker.expect(None)
        tracker.track(time_s + 12, picture_world.image, np.eye(4))
        tracker.wait(30)
        assert asked[-1] is None


def test_a_picture_that_is_none_is_refused(client):
    with Tracker(client, "room", CAMERA) as tracker, pytest.raises(InvalidTrack, match="image"):
        tracker.track(0.0, b"not a picture")


def test_odometry_cannot_begin_midway(picture_world):
    track = FollowedTrack(camera=CAMERA)
    track.frame(0.0, None, picture_world.image)
    with pytest.raises(InvalidTrack, match="without odometry"):
        track.frame(0.1, np.eye(4), picture_world.image)


def test_a_camera_is_scaled_to_its_pictures_or_refused():
    half = fitted(CAMERA, 320, 240)
    assert (half.fx, half.cx, half.cy) == (260.0, 159.5, 119.5)
    with pytest.raises(InvalidTrack, match="640×480"):
        fitted(CAMERA, 480, 640)


@pytest.mark.parametrize("step_deg", [1, 7], ids=["slowly", "64 px a frame"])
def test_points_that_an_answer_named_give_the_motion_since(picture_world, step_deg: int):
    """The answer is of three frames ago, and 20 cm off as a whole: motion is that of the camera all the same."""
    rng = np.random.default_rng(0)
    pixels = rng.uniform((250, 170), (390, 310), (80, 2))
    rays = np.column_stack([(pixels - (319.5, 239.5)) / 520.0, np.ones(80)])
    landmarks = rays * rng.uniform(2, 4, (80, 1))
    shift = moved(np.eye(4), np.array([0.2, 0, 0, 0, 0, 0.0]))
    motion = PictureMotion()
    motion.follow(0.0, picture_world.image, CAMERA)
    motion.keep()
    K = np.array([[520.0, 0, 319.5], [0, 520.0, 239.5], [0, 0, 1]])
    for number in (1, 2, 3):
        turn = cv2.Rodrigues(np.array([0.0, np.radians(step_deg * number), 0.0]))[0]
        turned = cv2.warpPerspective(picture_world.image, K @ turn.T @ np.linalg.inv(K), (640, 480))
        motion.follow(number / 30, turned, CAMERA)
    way = motion.answered(shift, pixels, landmarks @ shift[:3, :3].T + shift[:3, 3])
    assert [time_s for time_s, _ in way] == [0.0, *(np.arange(1, 4) / 30)]
    apart = motion_between(inverse(way[0][1]) @ way[-1][1], pose(turn, np.zeros(3)))
    assert np.linalg.norm(apart[:3]) < 0.02
    assert np.degrees(np.linalg.norm(apart[3:])) < 0.5


def test_pictures_that_autofocus_zooms_are_followed_by_their_own_intrinsics(picture_world):
    """The camera rests while its focal length grows: with the intrinsics of each picture it does not move."""
    rng = np.random.default_rng(0)
    pixels = rng.uniform((200, 150), (440, 330), (80, 2))
    rays = np.column_stack([(pixels - (CAMERA.cx, CAMERA.cy)) / CAMERA.fx, np.ones(80)])
    landmarks = rays * rng.uniform(2, 4, (80, 1))
    motion = PictureMotion()
    motion.follow(0.0, picture_world.image, CAMERA)
    motion.keep()
    for number in (1, 2, 3):
        zoom = 1 + 0.01 * number
        places = np.array([[zoom, 0, (1 - zoom) * CAMERA.cx], [0, zoom, (1 - zoom) * CAMERA.cy]])
        picture = cv2.warpAffine(picture_world.image, places, (640, 480))
        motion.follow(number / 30, picture, replace(CAMERA, fx=zoom * CAMERA.fx, fy=zoom * CAMERA.fy))
    way = motion.answered(np.eye(4), pixels, landmarks)
    assert np.linalg.norm(motion_between(way[0][1], way[-1][1])[:3]) < 0.01
