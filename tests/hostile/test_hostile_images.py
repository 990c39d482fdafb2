"""Pictures that are small to send and slow to decode: refused by their headers, or left when their time is over."""

import io
import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import cv2
import httpx
import numpy as np
import pytest
from PIL import Image

from rholoc.errors import InvalidImage
from rholoc.features import get_extractor
from rholoc.recordings.frames.image_decoding import MAX_JPEG_SCANS, decode_image, jpeg_scans, visited_pixels
from rholoc.service.frames import frame_features
from rholoc.service.frames.frame_features import extract_bounded
from rholoc.service.frames.queries import effort_of_set
from rholoc.service.threads.compute import Effort


def encoded(format_: str, size=(64, 48), **options) -> bytes:
    file = io.BytesIO()
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (size[1], size[0], 3), np.uint8)).save(
        file, format_, **options
    )
    return file.getvalue()


def with_more_scans(count: int) -> bytes:
    """A progressive JPEG file whose last scan is there ``count`` more times."""
    data = encoded("JPEG", progressive=True)
    last = data[data.rfind(b"\xff\xda") : -2]
    return data[:-2] + last * count + b"\xff\xd9"


def test_scans_are_counted():
    assert jpeg_scans(encoded("JPEG")) == 1
    usual = jpeg_scans(encoded("JPEG", progressive=True))
    assert 2 < usual < 20
    assert jpeg_scans(with_more_scans(7)) == usual + 7
    assert jpeg_scans(encoded("PNG")) == 0
    thumbnail = encoded("JPEG", exif=b"Exif\x00\x00" + encoded("JPEG", (8, 8)))
    assert jpeg_scans(thumbnail) == 1


def test_a_picture_of_too_many_scans_is_refused_before_it_is_decoded(monkeypatch):
    decode_image(with_more_scans(20))
    monkeypatch.setattr("PIL.ImageFile.ImageFile.load", lambda _image: pytest.fail("decoded"))
    for data, pixels in ((with_more_scans(MAX_JPEG_SCANS), 10**7), (with_more_scans(30), 64 * 48)):
        with pytest.raises(InvalidImage, match="scans"):
            decode_image(data, pixels)


def test_a_short_file_is_decoded_in_many_pieces_too():
    asked = 0

    def still_wanted():
        nonlocal asked
        asked += 1

    decode_image(with_more_scans(30), still_wanted=still_wanted)
    assert asked > 50


def test_decoding_ends_when_the_picture_is_not_wanted_any_more():
    class TooLateError(Exception): ...

    asked = 0

    def still_wanted():
        nonlocal asked
        asked += 1
        if asked > 20:
            raise TooLateError

    with pytest.raises(TooLateError):
        decode_image(encoded("PNG", (600, 400)), still_wanted=still_wanted)
    assert asked == 21


@pytest.mark.parametrize("format_", ["BMP", "PPM", "GIF", "TIFF"])
def test_frames_come_in_formats_that_decode_quickly(service, format_):
    answer = httpx.post(
        f"{service.url}/v1/maps/room/localize", content=encoded(format_), headers={"Content-Type": "image/jpeg"}
    )
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_image")


def test_a_picture_whose_pixels_are_text_is_refused():
    with pytest.raises(InvalidImage, match="text"):
        decode_image(b"P3 2 1 255 " + b"0 0 0  " * 2)


def test_the_answer_comes_at_the_deadline_though_a_thread_is_still_busy(serve, picture_world, monkeypatch):
    running = serve(concurrency=1)
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    url, png = (
        f"{running.url}/v1/maps/room/localize?dof=6",
        {"content": picture_world.png(), "headers": {"Content-Type": "image/png"}},
    )
    assert httpx.post(url, **png).json()["localized"]
    held = threading.Event()
    really = get_extractor("gray").extract
    monkeypatch.setattr(type(get_extractor("gray")), "extract", lambda _self, image: held.wait(100) and really(image))
    try:
        for _ in range(2):  # the first is in the thread, the second waits for it
            late = httpx.post(f"{url}&deadline_ms=100", **png).json()
            assert (late["localized"], late["reason"], late["map"]) == (False, "deadline", "room")
            assert not held.is_set()
    finally:
        held.set()
    monkeypatch.undo()
    assert httpx.post(url, **png).json()["localized"]


def test_features_of_a_large_picture_are_found_in_a_smaller_one(picture_world):
    extractor = get_extractor("gray")
    image = np.repeat(np.repeat(picture_world.image, 2, axis=0), 2, axis=1)
    found = extract_bounded(extractor, image, 640 * 480)
    own = extractor.extract(picture_world.image)
    assert len(found) == len(own)
    np.testing.assert_allclose(found.pixels, 2 * own.pixels + 0.5, atol=1e-3)
    np.testing.assert_allclose(found.sizes, 2 * own.sizes, rtol=1e-4)


def test_ordinary_frames_wait_for_no_large_ones(serve, picture_world, monkeypatch):
    running = serve(concurrency=2, queue_length=1)
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    go_on, entered = threading.Event(), threading.Event()

    def slow(image, *_args):
        entered.set()
        go_on.wait(60)
        raise InvalidImage("A large picture.")

    large = cv2.imencode(".jpg", np.zeros((1500, 2000, 3), np.uint8))[1].tobytes()
    assert visited_pixels(large) == 3_000_000
    really = frame_features.decode_image
    monkeypatch.setattr(frame_features, "decode_image", lambda data, *a: (slow if data == large else really)(data, *a))
    url, jpeg = f"{running.url}/v1/maps/room/localize?deadline_ms=60000", {"Content-Type": "image/jpeg"}
    with ThreadPoolExecutor(4) as pool:
        try:
            held = [pool.submit(httpx.post, url, content=large, headers=jpeg, timeout=60) for _ in range(2)]
            assert entered.wait(60)
            compute = running.app.state.rholoc.frames.compute
            while compute.taken < 2:
                time.sleep(0.01)
            refused = httpx.post(url, content=large, headers=jpeg, timeout=60)
            assert (refused.status_code, refused.json()["code"]) == (503, "busy")
            for _ in range(5):
                assert httpx.post(f"{url}&dof=6", content=picture_world.png(), headers=jpeg, timeout=60).is_success
            assert httpx.get(f"{running.url}/readyz").json()["checks"]["compute"] == "ok"
        finally:
            go_on.set()
        assert [one.result().json()["code"] for one in held] == ["invalid_image"] * 2


def test_large_sets_are_recognised_by_their_length():
    assert effort_of_set(json.dumps({"pixels": [[1, 2]] * 2000}).encode()) is Effort.ORDINARY
    assert effort_of_set(json.dumps({"pixels": [[1, 2]] * 5000}).encode()) is Effort.LARGE


def test_the_pixels_that_a_decoder_visits_are_known_from_the_header():
    assert visited_pixels(encoded("PNG", (640, 480))) == 640 * 480
    assert visited_pixels(with_more_scans(30)) > 5 * visited_pixels(encoded("JPEG"))
    assert visited_pixels(b"") == visited_pixels(b"\xff\xd8\xff") == visited_pixels(encoded("BMP")) == 0
