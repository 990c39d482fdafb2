"""Advice for the next walk, each piece from one measured figure."""

from collections.abc import Iterator

from rholoc.reports import Advice, AdviceKind, WalkFigures

MAX_TURN_DEG_S = 50.0  # above it a phone's picture of a room blurs by more than a feature's size
MIN_BRIGHTNESS = 41.0  # of 255; below it cameras expose longer, blur, and add noise
MAX_BARE_SHARE = 0.1
MAX_RETURN = 0.15


def advise(figures: WalkFigures) -> tuple[Advice, ...]:
    """Advice for each figure beyond its limit, which a constant of this module states. Empty for a good walk."""
    return tuple(_advices(figures))


def _advices(figures: WalkFigures) -> Iterator[Advice]:
    turn, brightness, bare = figures.turn_deg_s, figures.brightness, figures.bare_share
    if turn is not None and turn > MAX_TURN_DEG_S:
        text = f"Turn slower: a tenth of the walk was above {turn:.0f}°/s; above {MAX_TURN_DEG_S:.0f} pictures blur."
        yield Advice(AdviceKind.TOO_FAST, text, turn, MAX_TURN_DEG_S)
    if brightness is not None and brightness < MIN_BRIGHTNESS:
        text = (
            f"Switch on more light: the mean grey is {brightness:.0f} of 255; at least {MIN_BRIGHTNESS:.0f} is needed."
        )
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
