"""Pictures in a ROS bag."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import cv2
import numpy as np

from rholoc.errors import InvalidImage, InvalidRecording, RholocError
from rholoc.geometry import ByteArray, FloatArray, IntArray
from rholoc.recordings.frames.image_decoding import decode_image
from rholoc.recordings.frames.video import check_frame_size

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

BAG_SUFFIXES = frozenset({".bag", ".mcap", ".db3"})
IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"

# Channels, bytes per channel, and OpenCV's conversion to BGR; None if none is needed.
_ENCODINGS: dict[str, tuple[int, int, int | None]] = {
    **dict.fromkeys(("mono8", "8UC1"), (1, 1, cv2.COLOR_GRAY2BGR)),
    **dict.fromkeys(("mono16", "16UC1"), (1, 2, cv2.COLOR_GRAY2BGR)),
    **dict.fromkeys(("bgr8", "8UC3"), (3, 1, None)),
    "rgb8": (3, 1, cv2.COLOR_RGB2BGR),
    **dict.fromkeys(("bgra8", "8UC4"), (4, 1, cv2.COLOR_BGRA2BGR)),
    "rgba8": (4, 1, cv2.COLOR_RGBA2BGR),
    **dict.fromkeys(("yuv422", "uyvy"), (2, 1, cv2.COLOR_YUV2BGR_UYVY)),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), (2, 1, cv2.COLOR_YUV2BGR_YUYV)),
    # ROS names a pattern from its first pixel, OpenCV from the second pixel of the second row.
    "bayer_rggb8": (1, 1, cv2.COLOR_BayerBG2BGR),
    "bayer_bggr8": (1, 1, cv2.COLOR_BayerRG2BGR),
    "bayer_gbrg8": (1, 1, cv2.COLOR_BayerGR2BGR),
    "bayer_grbg8": (1, 1, cv2.COLOR_BayerGB2BGR),
}


@contextmanager
def opened_bag(path: Path) -> Iterator[AnyReader]:
    """Open a ROS 1 bag or a ROS 2 bag for the block: a file, or the folder that ``ros2 bag record`` makes.

    Raises:
        InvalidRecording: the bag cannot be opened, or the block raised an exception other than a RholocError, which
            counts as damage.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        # db3 bags before Iron do not contain their message definitions.
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except RholocError:
        raise
    except OSError as error:
        raise InvalidRecording(f"{path.name} cannot be read: {error.strerror or error}.", "Check the path.") from error
    except Exception as error:  # the libraries underneath raise many kinds for a damaged file
        raise InvalidRecording(
            f"{path.name} is damaged, or is not a bag: {type(error).__name__}.",
            "Run `ros2 bag reindex`, or `rosbag reindex`, or record again.",
        ) from error


@dataclass(frozen=True, eq=False)
class BagFrames:
    """The pictures of one topic of a bag, see :class:`rholoc.recordings.FrameSource`.

    Attributes:
        path: of the bag.
        topic: its name.
        logged_ns: (M,) log times of the topic's M pictures [ns], non-decreasing.
        numbers: (N,) int64, numbers of the pictures used as frames.
        times: (N,) the pictures' own stamps [s].
        size: width and height in pixels.
    """

    timed: ClassVar[bool] = True  # every picture has a stamp

    path: Path
    topic: str
    logged_ns: IntArray
    numbers: IntArray
    times: FloatArray
    size: tuple[int, int]

    def images(self, rows: Sequence[int]) -> Iterator[ByteArray]:
        """The images (H, W, 3) BGR of the rows, which must increase.

        Raises:
            InvalidRecording: a picture is damaged, of an unknown encoding or another size, or the bag is damaged.
        """
        if len(rows) == 0:
            return
        wanted = [int(self.numbers[row]) for row in rows]
        start, stop = int(self.logged_ns[wanted[0]]), int(self.logged_ns[wanted[-1]]) + 1
        number = int(np.searchsorted(self.logged_ns, start))
        with opened_bag(self.path) as reader:
            connections = [one for one in reader.connections if one.topic == self.topic]
            remaining = iter(wanted)
            next_wanted = next(remaining)
            for connection, _, raw in reader.messages(connections, start, stop):
                if number == next_wanted:
                    image = decoded(reader.deserialize(raw, connection.msgtype), self.topic)
                    if image.shape[1::-1] != self.size:
                        raise InvalidRecording(f"A picture of {self.topic} is of another size than the others.")
                    yield image
                    following = next(remaining, None)
                    if following is None:
                        return
                    next_wanted = following
                number += 1
        raise InvalidRecording(f"{self.path.name} has fewer pictures than before.", "Leave the bag as it is meanwhile.")


def decoded(message: Any, topic: str) -> ByteArray:
    """A message's picture (H, W, 3) BGR: raw, or compressed as JPEG or PNG.

    Raises:
        InvalidRecording: it is damaged or of an unknown encoding.
    """
    if hasattr(message, "format"):
        try:
            return decode_image(np.asarray(message.data).tobytes())
        except InvalidImage as error:
            raise InvalidRecording(f"{topic}: {error.message}", "Leave that topic out.") from error
    height, width = int(message.height), int(message.width)
    check_frame_size(topic, width, height)
    if message.encoding not in _ENCODINGS:
        raise InvalidRecording(
            f"{topic} has pictures encoded as {str(message.encoding)[:40]!r}, which is not supported.",
            "Republish them as bgr8, mono8 or compressed.",
        )
    channels, size, conversion = _ENCODINGS[message.encoding]
    row, step = width * channels * size, int(message.step)
    data = np.asarray(message.data, dtype=np.uint8)
    if step < row or len(data) < step * (height - 1) + row:
        raise InvalidRecording(f"A picture of {topic} is cut off.", "Record again.")
    data = np.pad(data[: step * height], (0, max(0, step * height - len(data))))
    pixels = data.reshape(height, step)[:, :row]
    if size == 2:
        pixels = pixels.reshape(height, width, 2)[:, :, 0 if message.is_bigendian else 1]
    shaped = np.ascontiguousarray(pixels.reshape((height, width, channels) if channels > 1 else (height, width)))
    return np.asarray(shaped if conversion is None else cv2.cvtColor(shaped, conversion), dtype=np.uint8)


def picture_size(message: Any, topic: str) -> tuple[int, int]:
    """Width and height of a message's picture. Raises InvalidRecording if it is damaged or of an unknown encoding."""
    image = decoded(message, topic)
    return image.shape[1], image.shape[0]
