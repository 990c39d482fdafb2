"""Messages of a bag of ROS 2, read by Foxglove's library."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory


def bag_messages(path: Path) -> Iterator[tuple[str, int, Any]]:
    """Topic, log time [ns] and message, in the order of their times."""
    with path.open("rb") as file:
        for _, channel, message, decoded in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            yield channel.topic, message.log_time, decoded
