"""ROS topics on DDS, as ROS 2 has them: topics rt/NAME, types pkg::msg::dds_::Type_."""

import os
from collections.abc import Iterator
from typing import Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from ros_messages import dds_class, from_dds, to_dds

LOOPBACK = """<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast><Interfaces>
<NetworkInterface name="lo" multicast="false"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer Address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
_RELIABLE, _HISTORY = Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(100)


def _qos(topic: str) -> Qos:
    static = topic == "tf_static"
    return Qos(_RELIABLE, _HISTORY, Policy.Durability.TransientLocal if static else Policy.Durability.Volatile)


class Peer:
    """A participant of the domain that the environment names."""

    def __init__(self) -> None:
        self.participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
        self.writers: dict[str, DataWriter] = {}
        self.readers: dict[str, tuple[str, DataReader]] = {}

    def _topic(self, kind: str, topic: str) -> Topic:
        return Topic(self.participant, f"rt/{topic}", dds_class(kind))

    def write(self, topic: str, message: Any) -> None:
        self.writer(message.kind, topic.lstrip("/")).write(to_dds(message))

    def writer(self, kind: str, topic: str) -> DataWriter:
        if topic not in self.writers:
            self.writers[topic] = DataWriter(self.participant, self._topic(kind, topic), qos=_qos(topic))
        return self.writers[topic]

    def listen(self, kind: str, topic: str) -> None:
        if topic not in self.readers:
            self.readers[topic] = kind, DataReader(self.participant, self._topic(kind, topic), qos=_qos(topic))

    def take(self) -> Iterator[tuple[str, Any]]:
        """Topic and message of what came."""
        for topic, (kind, reader) in [*self.readers.items()]:
            for sample in reader.take(100):
                if hasattr(sample, "__idl__"):  # else it only says that a writer is gone
                    yield topic, from_dds(sample, kind)
