"""What the maps of benchmarks/rooms.py answer when they are asked, for each kind of features; kept in a cache.

Of a room's map is asked, as a service would: frames of the room; the same with an eighth of their features (frames that
are easy say nothing about doubt); some as if by a camera whose focal length is a tenth off; pictures of all other
rooms, which are all wrong; and windows of a frame, over a seventh of its area, in a picture of another room: a thing
that looks alike.

Every pose found is kept, however doubtful, with its confidence features; so answers are asked for again only
where the code that finds poses or its inputs has changed, not where the confidence's weights have.
"""

from __future__ import annotations

import hashlib
import inspect
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from functools import cache
from pathlib import Path

import numpy as np

import rholoc
from rholoc.errors import MappingFailed
from rholoc.features import FeatureSet, get_extractor
from rholoc.geometry import Camera, FloatArray, pose_distances
from rholoc.localization import NO_BELIEF, Belief, Localizer, Query
from rholoc.localization.belief.confidence import (
    WEIGHTS,
    ConfidenceFeatures,
    Weights,
    belief_by,
    confidence_features,
)
from rooms import ROOMS, NamedRoom, Room, map_of, strangers

FEWER = 1 / 8  # of a frame's features
WINDOW = 0.15  # of a frame's area
FOCAL_OFF = 1.1
RIGHT_M, RIGHT_RAD = 0.10, np.deg2rad(5.0)
PLACE_M, PLACE_RAD = 0.5, np.deg2rad(20.0)  # poses that are no farther off are of the right place
STRANGERS = 4  # pictures of each other recording
SELDOM = 3  # of so many frames one is asked by a wrong camera and as a window: those take long
DOUBTFUL = 0.05  # confidence from which rivals are looked for
_LEAST = 1e-9  # probability that others are divided by
_PACKAGES = ("density", "features", "localization")
_ONLY_JUDGES = "confidence.py"


class Kind(StrEnum):
    """What was asked."""

    WHOLE = "whole"
    FEWER = "fewer"  # with some of its features only
    OTHER_ROOM = "other room"
    WINDOW = "window"  # in a picture of another room
    FOCAL_OFF = "focal off"  # by a camera whose focal length is wrong


@dataclass(frozen=True)
class Case:
    """One answer.

    Attributes:
        kind: what was asked.
        features: the confidence features; None where no pose was found.
        factor: 0..1, by how much rivals, the focal length, a position that is hardly known and the map's own error
            lower ``recognized``.
        exact_factor: 0..1, likewise of the probability of being exact.
        off_m: how far off the pose is; None in another room, or where there is none.
        turned_rad: by how much it is turned, likewise.
        right: whether it is within 10 cm and 5°.
    """

    kind: Kind
    features: ConfidenceFeatures | None
    factor: float
    exact_factor: float
    off_m: float | None
    turned_rad: float | None
    right: bool

    def belief(self, weights: Weights = WEIGHTS) -> Belief:
        """How surely the pose is right by some weights; not at all where none was found."""
        if self.features is None:
            return NO_BELIEF
        alone = belief_by(self.features, weights)
        return Belief(self.factor * alone.recognized, self.exact_factor * alone.exact)

    @property
    def is_right_place(self) -> bool:
        """Whether the pose is of the right place, if not exact."""
        return self.kind is not Kind.WINDOW and self.is_within(PLACE_M, PLACE_RAD)

    def is_within(self, limit_m: float, limit_rad: float) -> bool:
        """Whether the pose is no farther off."""
        if self.off_m is None or self.turned_rad is None:
            return False
        return bool(self.off_m < limit_m and self.turned_rad < limit_rad)

    @classmethod
    def read(cls, stored: dict) -> Case:  # type: ignore[type-arg]
        """One that was kept."""
        kept = stored["features"]
        features = None if kept is None else ConfidenceFeatures(**(kept | {"place": tuple(kept["place"])}))
        return cls(**(stored | {"kind": Kind(stored["kind"]), "features": features}))


UNANSWERED = Case(Kind.WHOLE, None, 0.0, 0.0, None, None, False)


@dataclass(frozen=True)
class Answered:
    """All that was asked of one room with one kind of features."""

    features: str
    recording: str
    room: str
    cases: list[Case]


def case(kind: Kind, localizer: Localizer, query: Query, truth: FloatArray | None) -> Case:
    """Ask one query, however doubtful the answer."""
    found = localizer.candidate(query)
    if found is None:
        return replace(UNANSWERED, kind=kind)
    verified, belief = found
    features = confidence_features((verified,), verified.covariance)
    alone = belief_by(features)
    factors = belief.recognized / max(alone.recognized, _LEAST), belief.exact / max(alone.exact, _LEAST)
    if truth is None:
        return Case(kind, features, *factors, None, None, False)
    off_m, turned_rad = pose_distances(verified.optimum.T_map_camera, truth)
    right = bool(off_m < RIGHT_M and turned_rad < RIGHT_RAD and kind is not Kind.WINDOW)
    return Case(kind, features, *factors, float(off_m), float(turned_rad), right)


def frames_asked(named: NamedRoom, features: str, kept: Path) -> Iterator[Case]:
    """A room's frames, asked as they are; of a room that cannot be mapped by such features none is answered."""
    try:
        room, camera, localizer = _opened(named, features, kept)
    except MappingFailed:
        yield from (UNANSWERED for _ in named.make(kept).pictures())
        return
    for truth, image in room.pictures():
        yield case(Kind.WHOLE, localizer, Query.of_picture(image, localizer.extractor, camera), truth)


def doubts_asked(named: NamedRoom, features: str, kept: Path) -> Iterator[Case]:
    """All else that is asked of one room, where it can be mapped."""
    try:
        room, camera, localizer = _opened(named, features, kept)
    except MappingFailed:
        return
    extractor = localizer.extractor
    others = list(strangers(named.recording, STRANGERS, kept))
    rng = np.random.default_rng(0)
    for number, (truth, image) in enumerate(room.pictures()):
        found = extractor.extract(image).coloured(image)
        some = found.take(np.sort(rng.choice(len(found), int(len(found) * FEWER), replace=False)))
        yield case(Kind.FEWER, localizer, Query(some, camera), truth)
        if number % SELDOM:
            continue
        yield case(Kind.FOCAL_OFF, localizer, Query.of_picture(image, extractor, camera.zoomed(FOCAL_OFF)), truth)
        other = others[rng.integers(len(others))][0]
        strange = extractor.extract(other).coloured(other)
        yield case(Kind.WINDOW, localizer, Query(_window(found, strange, camera, rng), camera), truth)
    first = next(one for one in ROOMS if one.mapped == named.mapped)
    for image, strange_camera in others if named is first else ():
        yield case(Kind.OTHER_ROOM, localizer, Query.of_picture(image, extractor, strange_camera), None)


def _opened(named: NamedRoom, features: str, kept: Path) -> tuple[Room, Camera, Localizer]:
    room = named.make(kept)
    assert room.asked.camera is not None
    localizer = Localizer(map_of(named, room.mapped, features, kept), min_recognized=DOUBTFUL)
    return room, room.asked.camera, localizer


def _window(found: FeatureSet, strange: FeatureSet, camera: Camera, rng: np.random.Generator) -> FeatureSet:
    """A window of a picture's features, with those of a strange picture around it."""
    size = np.sqrt(WINDOW) * np.array([camera.width, camera.height])
    low = rng.uniform(0, 1, 2) * ((camera.width, camera.height) - size)
    return FeatureSet.concatenate([_within(found, low, size, True), _within(strange, low, size, False)])


def _within(features: FeatureSet, low: FloatArray, size: FloatArray, inside: bool) -> FeatureSet:
    """The features inside or outside a window."""
    is_inside = ((features.pixels >= low) & (features.pixels < low + size)).all(axis=1)
    return features.take(np.flatnonzero(is_inside == inside))


def answers_of(
    named: NamedRoom, features: str, kept: Path, is_late: Callable[[], bool], frames_alone: bool = False
) -> Answered | None:
    """What is kept of one room, or is asked now; None where it is too late for that."""
    cases = []
    for part, ask in {"frames": frames_asked, "doubts": doubts_asked}.items():
        if frames_alone and ask is not frames_asked:
            continue
        path = kept / "answers" / f"{features}-{named.name}-{part}-{code_digest(features)}.json".replace(" ", "-")
        if not path.is_file():
            if is_late():
                return None
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps([asdict(one) for one in ask(named, features, kept)]))
            print(f"asked: {features}, {named.name}, {part}", flush=True)
        cases += [Case.read(one) for one in json.loads(path.read_text())]
    return Answered(features, named.recording, named.name, cases)


@cache
def code_digest(features: str) -> str:
    """A name for the code that finds poses by one kind of features: what was found by other code is asked again."""
    digest = hashlib.sha256(inspect.getsource(confidence_features).encode())
    root = Path(rholoc.__file__).parent
    files = [file for package in _PACKAGES for file in sorted((root / package).rglob("*.py"))]
    own = Path(inspect.getfile(type(get_extractor(features))))
    for file in files:
        if file.parent.name != "extractors" and file.name != _ONLY_JUDGES:
            digest.update(file.read_bytes())
    return f"{digest.hexdigest()[:8]}{hashlib.sha256(own.read_bytes()).hexdigest()[:4]}"
