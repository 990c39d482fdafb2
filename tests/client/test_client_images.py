"""Arrays become PNG files."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from rholoc_client._images import encoded


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
