"""What to do better next time, each advice from one measured figure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

MAX_TURN_DEG_S = 50.0  # above it a phone's picture of a room blurs by more than a feature's size
MIN_BRIGHTNESS = 41.0  # of 255; below it cameras expose longer, blur, and add noise
MAX_BARE_SHARE = 0.1
MAX_RETURN = 0.15


class AdviceKind(StrEnum):
    """What a walk lacked."""

    TOO_FAST = "too_fast"
    TOO_DARK = "too_dark"
    TOO_LITTLE_TEXTURE = "too_little_texture"
    PAUSES_MISSING = "pauses_missing"
    NO_LOOP = "no_loop"


@dataclass(frozen=True)
class Advice:
    """One thing to do better.

    Attributes:
        kind: what was lacking.
        text: one line that says what to do, with the figure.
        figure: what was measured.
        limit: what it was measured against.
    """

    kind: AdviceKind
    text: str
    figure: float
    limit: float

    def to_json(self) -> dict[str, Any]:
        """As JSON."""
        return asdict(self)


@dataclass(frozen=True)
class WalkFigures:
    """What was measured of a walk; None where nothing could be.

    Attributes:
        turn_deg_s: the speed of turning, degrees a second, that is exceeded in a tenth of the walk.
        brightness: the median over frames of their mean grey level, 0 to 255.
        bare_share: the share of frames that show too few corners.
        pauses: how many of the waypoints were rested at, where there are waypoints and an IMU.
        waypoints: how many waypoints there are.
        nearest_return: how near the second half of the walk comes to the first, as a share of the way between; small
            where the walk closes a loop, 1 where it is straight.
    """

    turn_deg_s: float | None = None
    brightness: float | None = None
    bare_share: float | None = None
    pauses: int | None = None
    waypoints: int = 0
    nearest_return: float | None = None

    def to_json(self) -> dict[str, Any]:
        """As JSON."""
        return asdict(self)


def advise(figures: WalkFigures) -> tuple[Advice, ...]:
    """The advices that the figures give cause for; none for a good walk."""
    return tuple(_advices(figures))


def _advices(figures: WalkFigures) -> Iterator[Advice]:
    turn, brightness, bare = figures.turn_deg_s, figures.brightness, figures.bare_share
    if turn is not None and turn > MAX_TURN_DEG_S:
        text = f"Turn slower: a tenth of the walk was above {turn:.0f}°/s; above {MAX_TURN_DEG_S:.0f} pictures blur."
        yield Advice(AdviceKind.TOO_FAST, text, turn, MAX_TURN_DEG_S)
    if brightness is not None and brightness < MIN_BRIGHTNESS:
        text = f"Switch on more light: the mean grey is {brightness:.0f} of 255; {MIN_BRIGHTNESS:.0f} is the least."
        yield Advice(AdviceKind.TOO_DARK, text, brightness, MIN_BRIGHTNESS)
    if bare is not None and bare > MAX_BARE_SHARE:
        text = f"Keep more texture in view: {bare:.0%} of the frames show hardly any corners (bare walls, or blur)."
        yield Advice(AdviceKind.TOO_LITTLE_TEXTURE, text, bare, MAX_BARE_SHARE)
    if figures.pauses is not None and figures.pauses < figures.waypoints:
        text = (
            f"Stand still for a second at each waypoint: {figures.pauses} of {figures.waypoints} have a pause, and a "
            "place measured in passing is centimetres off."
        )
        yield Advice(AdviceKind.PAUSES_MISSING, text, figures.pauses, figures.waypoints)
    if figures.nearest_return is not None and figures.nearest_return > MAX_RETURN:
        text = (
            "Come back to where you have been, looking the same way: the end of the walk stays "
            f"{figures.nearest_return:.0%} of its length off its beginning, and errors grow along an open path."
        )
        yield Advice(AdviceKind.NO_LOOP, text, figures.nearest_return, MAX_RETURN)
