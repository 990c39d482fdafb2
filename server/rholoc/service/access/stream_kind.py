"""What streams carry."""

from __future__ import annotations

from enum import StrEnum


class StreamKind(StrEnum):
    """What a stream carries."""

    FRAMES = "frames"  # a WebSocket
    EVENTS = "events"  # server-sent
