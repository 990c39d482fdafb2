"""Films of pictures as files: GIF or MP4."""

import tempfile
from collections.abc import Iterable
from pathlib import Path

import cv2
from PIL import Image

from rholoc.errors import InvalidInput
from rholoc.geometry import ByteArray

FILM_ENDINGS = (".gif", ".mp4")


def film(frames: Iterable[ByteArray], ending: str, fps: float) -> bytes:
    """The content of a film of pictures (H, W, 3), RGB, all of one size, in the format of one of ``FILM_ENDINGS``.

    Raises:
        InvalidInput: this OpenCV cannot write such films.
    """
    pictures = list(frames)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"film{ending}"
        if ending == ".gif":
            first, *others = (Image.fromarray(picture).quantize(128) for picture in pictures)
            first.save(path, save_all=True, append_images=others, duration=1000 / fps, loop=0)
        else:
            height, width = pictures[0].shape[:2]
            code = cv2.VideoWriter.fourcc(*"mp4v")
            writer = cv2.VideoWriter(str(path), code, fps, (width // 2 * 2, height // 2 * 2))
            if not writer.isOpened():
                raise InvalidInput(f"{ending} films cannot be written here.", "Write a .gif.")
            for picture in pictures:
                writer.write(picture[: height // 2 * 2, : width // 2 * 2, ::-1].copy())
            writer.release()
        return path.read_bytes()
