"""Images from bytes: what is read, and what is refused without taking memory for it."""

import io
import resource
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from rholoc.errors import InvalidImage
from rholoc.recordings import decode_image, read_recording
from rholoc.recordings.frames.image_decoding import exif_focal_px, image_size, read_image
from rholoc.recordings.frames.image_folder import ImageFolderFrames
from rholoc.recordings.frames.unified_pictures import UnifiedPictures


def gradient(width: int = 40, height: int = 30) -> np.ndarray:
    """(H, W, 3) BGR, different in each channel."""
    x, y = np.meshgrid(np.linspace(0, 255, width), np.linspace(0, 255, height))
    return np.dstack([x, y, (x + y) / 2]).astype(np.uint8)


def encoded(suffix: str, image: np.ndarray) -> bytes:
    done, data = cv2.imencode(suffix, image)
    assert done
    return data.tobytes()


def png_that_claims(width: int, height: int) -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 64)) + chunk(b"IEND", b"")
    )


def jpeg_that_claims(width: int, height: int) -> bytes:
    data = bytearray(encoded(".jpg", gradient()))
    frame = data.index(b"\xff\xc0")
    data[frame + 5 : frame + 9] = struct.pack(">HH", height, width)
    return bytes(data)


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".ppm"])
def test_lossless_formats_are_read_exactly(suffix: str) -> None:
    image = decode_image(encoded(suffix, gradient()))
    np.testing.assert_array_equal(image, gradient())
    assert image.flags.c_contiguous


@pytest.mark.parametrize("suffix", [".jpg", ".webp"])
def test_lossy_formats_are_read_as_opencv_does(suffix: str) -> None:
    data = encoded(suffix, gradient())
    expected = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert np.abs(decode_image(data).astype(int) - expected).max() <= 2


def test_grey_alpha_palette_and_sixteen_bits_become_bgr_of_eight() -> None:
    grey = gradient()[:, :, 0]
    as_bgr = np.repeat(grey[:, :, None], 3, axis=2)
    np.testing.assert_array_equal(decode_image(encoded(".png", grey)), as_bgr)
    np.testing.assert_array_equal(decode_image(encoded(".png", grey.astype(np.uint16) * 256 + 77)), as_bgr)
    with_alpha = np.dstack([gradient(), np.full(grey.shape, 128, np.uint8)])
    np.testing.assert_array_equal(decode_image(encoded(".png", with_alpha)), gradient())
    deep = gradient().astype(np.uint16) * 256 + 77
    np.testing.assert_array_equal(decode_image(encoded(".png", deep)), gradient())
    file = io.BytesIO()
    Image.new("P", (4, 3), 0).save(file, "PNG")
    assert decode_image(file.getvalue()).shape == (3, 4, 3)
    file = io.BytesIO()
    Image.new("1", (4, 3), 1).save(file, "PNG")
    assert decode_image(file.getvalue()).mean() == 255
    file = io.BytesIO()
    Image.new("CMYK", (4, 3)).save(file, "JPEG")
    assert decode_image(file.getvalue()).shape == (3, 4, 3)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_exif_orientation_is_applied(tmp_path: Path, orientation: int) -> None:
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / "turned.jpg"
    Image.fromarray(gradient()).save(path, exif=exif, quality=95)
    expected = cv2.imread(str(path), cv2.IMREAD_COLOR)
    image = read_image(path)
    assert image.shape == expected.shape
    assert np.abs(image.astype(int) - expected).max() <= 2
    assert image_size(path) == (image.shape[1], image.shape[0])


def test_a_jpeg_with_something_after_its_end_is_read() -> None:
    data = encoded(".jpg", gradient())
    np.testing.assert_array_equal(decode_image(data + b"motion photo" * 100), decode_image(data))


@pytest.mark.parametrize("data", [b"", b"\0" * 100, b"GIF89a", b"<html>", b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n", b"BM"])
def test_what_is_no_image_is_refused(data: bytes) -> None:
    with pytest.raises(InvalidImage) as caught:
        decode_image(data)
    assert "\n" not in str(caught.value)


@given(suffix=st.sampled_from([".jpg", ".png", ".webp", ".bmp"]), fraction=st.floats(0, 0.97))
def test_a_truncated_image_is_refused(suffix: str, fraction: float) -> None:
    data = encoded(suffix, gradient(160, 120))
    with pytest.raises(InvalidImage):
        decode_image(data[: int(fraction * len(data))])


@given(data=st.data())
def test_flipped_bytes_give_an_image_or_our_error(data: st.DataObject) -> None:
    content = bytearray(encoded(data.draw(st.sampled_from([".jpg", ".png", ".webp", ".bmp"])), gradient()))
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    try:
        image = decode_image(bytes(content), max_pixels=10_000)
    except InvalidImage:
        return
    assert image.ndim == 3
    assert image.shape[0] * image.shape[1] <= 10_000


@pytest.mark.parametrize("claim", [png_that_claims, jpeg_that_claims])
@pytest.mark.parametrize("size", [(60000, 60000), (20000, 3000)])
def test_a_header_that_claims_too_much_takes_no_memory(claim, size: tuple[int, int]) -> None:
    data = claim(*size)
    before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InvalidImage, match="pixels"):
        decode_image(data)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kib < 20_000


def test_the_limit_is_the_callers() -> None:
    data = encoded(".png", gradient(40, 30))
    assert decode_image(data, max_pixels=1200).shape == (30, 40, 3)
    with pytest.raises(InvalidImage, match="40×30"):
        decode_image(data, max_pixels=1199)


_26_MM_PX = 26 * 80 / np.hypot(36, 24)  # of 64 × 48 pixels


def _photo(path: Path, equivalent_mm: int | None, size: tuple[int, int] = (64, 48)) -> Path:
    """A picture whose EXIF data state a focal length, as the equivalent for a film of 36 × 24 mm."""
    exif = Image.Exif()
    if equivalent_mm is not None:
        exif.get_ifd(0x8769)[0xA405] = equivalent_mm
    Image.new("RGB", size).save(path, exif=exif)
    return path


@pytest.mark.parametrize("size", [(64, 48), (48, 64)])
def test_the_equivalent_keeps_the_angle_across_the_diagonal(tmp_path: Path, size: tuple[int, int]) -> None:
    assert exif_focal_px(_photo(tmp_path / "photo.jpg", 26, size)) == pytest.approx(_26_MM_PX)


@pytest.mark.parametrize("equivalent_mm", [None, 0, 2, 65535])
def test_an_impossible_focal_length_is_none(tmp_path: Path, equivalent_mm: int | None) -> None:
    assert exif_focal_px(_photo(tmp_path / "photo.jpg", equivalent_mm)) is None


def test_pictures_of_one_lens_have_its_focal_length(tmp_path: Path) -> None:
    for number in range(3):
        _photo(tmp_path / f"{number}.jpg", 26)
    recording = read_recording(tmp_path)
    assert isinstance(recording.frames, ImageFolderFrames)
    assert recording.camera is None  # the estimation starts from it, and is not held to it
    assert recording.focal_px == pytest.approx(_26_MM_PX)


def test_pictures_of_two_lenses_of_one_phone_become_those_of_one_camera(tmp_path: Path) -> None:
    for number, equivalent_mm in enumerate((13, 26, 26)):
        _photo(tmp_path / f"{number}.jpg", equivalent_mm)
    recording = read_recording(tmp_path)
    assert isinstance(recording.frames, UnifiedPictures)
    focals = [camera.focal for camera in recording.frames.cameras]
    assert focals[1] == pytest.approx(2 * focals[0])
    assert recording.focal_px == pytest.approx(focals[1])


def test_a_focal_length_that_few_pictures_state_is_no_guess(tmp_path: Path) -> None:
    for number, equivalent_mm in enumerate((26, None, None)):
        _photo(tmp_path / f"{number}.jpg", equivalent_mm, (64, 48 if number else 40))
    assert read_recording(tmp_path).focal_px is None
