"""Live askers and failed requests, in memory only, if the settings enable it."""

import asyncio
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from rholoc.errors import Conflict
from rholoc.service.caller import ASKER
from rholoc.service.frames.answer_models import LocalizationOut

UNSURE_BELOW = 0.8  # a confidence
LIVE_S = 10.0  # time for which a client is shown after its last request
DAY_S = 24 * 3600.0
_MAX_ASKERS = 1000
_MAX_FAILURES = 20_000


@dataclass(frozen=True, eq=False)
class Sighting:
    """One answer.

    Attributes:
        number: increases with every answer of this server.
        asker: name of a key, or an address.
        map: name of the map.
        time: seconds since the epoch.
        position, heading: of the pose; None if there is none.
        T_map_camera: 4 × 4, likewise.
        localized: whether this answer has a pose.
        reason: why it has no pose.
        confidence: 0 to 1.
        sigma_m: the largest standard deviation of the position along a map axis [m]; None without a pose.
    """

    number: int
    asker: str
    map: str
    time: float
    position: list[float] | None
    heading: list[float] | None
    T_map_camera: list[list[float]] | None
    localized: bool
    reason: str | None
    confidence: float
    sigma_m: float | None


@dataclass(frozen=True)
class Failure:
    """A request without a confident pose. The asker is not stored.

    Attributes:
        map: name of the map.
        time: seconds since the epoch.
        position: of the unsure pose, else of the request's prior; None where there is neither.
        heading: of the unsure pose; None where there is none.
        confidence: 0 to 1.
        reason: why there is no pose; None for an unsure one.
    """

    map: str
    time: float
    position: list[float] | None
    heading: list[float] | None
    confidence: float
    reason: str | None


class Live:
    """The last answer for each asker, and the failures of a day. Use it from the event loop's thread only.

    Args:
        shown: whether askers are shown.
        keeps_failures: whether failures are kept.
    """

    def __init__(self, shown: bool, keeps_failures: bool) -> None:
        self._shown, self._keeps_failures = shown, keeps_failures
        self._latest: dict[tuple[str, str], Sighting] = {}
        self._failures: deque[Failure] = deque(maxlen=_MAX_FAILURES)
        self.number = 0
        self.changed = asyncio.Event()
        """Set by the next answer, and then replaced by a new event."""

    def note(self, answer: LocalizationOut, expected: Sequence[float] | None = None) -> None:
        """Record an answer to the request's asker, and wake those who wait for ``changed``; ``expected`` is the prior's
        position.

        It is also a failure if it has no pose or a confidence below 0.8. Nothing happens if neither is enabled.
        """
        if not (self._shown or self._keeps_failures):
            return
        now, asker = time.time(), ASKER.get()
        self._latest.pop((answer.map, asker), None)
        self.number += 1
        pose = answer.pose
        sighting = Sighting(
            number=self.number,
            asker=asker,
            map=answer.map,
            time=now,
            position=pose.position if pose else None,
            heading=pose.heading if pose else None,
            T_map_camera=pose.T_map_camera if pose else None,
            localized=pose is not None,
            reason=answer.reason,
            confidence=answer.confidence,
            sigma_m=max(answer.covariance[i][i] for i in range(3)) ** 0.5 if answer.covariance else None,
        )
        self._latest[answer.map, asker] = sighting  # in the order of the answers
        self.changed.set()
        self.changed = asyncio.Event()
        if len(self._latest) > _MAX_ASKERS:
            del self._latest[next(iter(self._latest))]
        if self._keeps_failures:
            self._keep(sighting, expected)

    def _keep(self, sighting: Sighting, expected: Sequence[float] | None) -> None:
        """Keep the sighting as a failure unless its confidence is high, at the expected position if it has none."""
        if sighting.localized and sighting.confidence >= UNSURE_BELOW:
            return
        position = sighting.position
        if not sighting.localized and expected is not None:
            position = list(expected)
        failure = Failure(sighting.map, sighting.time, position, sighting.heading, sighting.confidence, sighting.reason)
        self._failures.append(failure)

    def after(self, map_name: str, number: int) -> list[Sighting]:
        """The last answer in a map to each asker of the last 10 s, if its number is above ``number``; the oldest first.

        Raises:
            Conflict: this server does not show askers.
        """
        if not self._shown:
            raise Conflict("This server does not show who asks for poses.", "Set RHOLOC_LIVE=true to enable it.")
        since = time.time() - LIVE_S
        found = self._latest.values()
        return [one for one in found if one.map == map_name and one.number > number and one.time >= since]

    def failures(self, map_name: str) -> list[Failure]:
        """The failures of the last day in a map, the oldest first.

        Raises:
            Conflict: this server does not keep failures.
        """
        if not self._keeps_failures:
            raise Conflict(
                "This server does not record where requests fail.", "Set RHOLOC_KEEP_FAILURES=true to enable it."
            )
        since = time.time() - DAY_S
        return [one for one in self._failures if one.map == map_name and one.time >= since]
