"""A map that learns from its users, after a third of the furniture was moved; and where nothing was moved.

    python benchmarks/learning_maps.py [--cache DIR] [--features sift48] [--seeds 0,1,2,3,4]

A simulated room is walked through, poses as they are, and a map made of it. Then a third of its furniture stands
elsewhere. 200 queries by ten users come from beside the ways of other walks, a minute apart, looking where they like;
the map keeps those that it is sure of and learns from them, once. It is asked by 60 further pictures of the same
kind: before the move, after it, and after it having learned; and, as a control, having learned from the same 200
places with nothing moved. Printed are the share of these 60 within 5 cm and 5°, the share that is off by more than 50
cm, the median error of what is answered, and the map's size. The last lines have the worst and the mean of the seeds.
"""

import argparse
import pickle
import tempfile
import uuid
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np

from measuring import jpeg_of
from rholoc.density import DensityKind
from rholoc.errors import RholocError
from rholoc.features import DEFAULT_FEATURES, Extractor, get_extractor
from rholoc.geometry import ByteArray, Camera, FloatArray, Pose, pose_distances
from rholoc.localization import Localizer, Query
from rholoc.mapping.build.assembly import assemble
from rholoc.mapping.build.pipeline import reconstruct
from rholoc.mapping.build.stored_observations import with_landmarks
from rholoc.mapping.build.tracks import Views
from rholoc.mapping.learn.answered_query import AnsweredQuery
from rholoc.mapping.learn.from_queries import learn_from_queries
from rholoc.maps import Map, MapInfo, Source, map_to_bytes
from rholoc.progress import silent
from rholoc.simulation import PHONE_CAMERA, make_test_site, make_walk, render_view
from rholoc.simulation.scene import Scene
from rholoc_lab.simulation.rearrangement import rearranged

SECONDS = 30.0
WALK, USERS = 1, tuple(range(2, 10))
MAP_FRAMES, QUERIES, ASKED = 220, 200, 60
MOVED_SHARE = 1 / 3
SURE, USERS_COUNT = 0.8, 10
LIMIT_M, LIMIT_RAD, WRONG_M = 0.05, np.deg2rad(5.0), 0.5
BEFORE, AFTER = "before the move", "after it"
LEARNED, CONTROL = "after it, having learned", "nothing moved, having learned"
PARTS = ("walk", "before", "after", "users", "users_before")
_ASIDE_M, _LOOKING_ASIDE_RAD = 0.25, np.deg2rad(40.0)  # of users, beside the walks
_CLEAR_M = 0.3
_JPEG_QUALITY = 95


@dataclass(frozen=True)
class Pictures:
    """JPEGs, the poses (N, 4, 4) that they were taken from, and the camera."""

    T_map_camera: FloatArray
    jpegs: list[bytes]
    camera: Camera = PHONE_CAMERA


@dataclass(frozen=True)
class Room:
    """What is seen of a room.

    Attributes:
        moved: the furniture that was moved.
        walk: what the map is made of.
        before, after: what is asked, from the same places, before the furniture was moved and after it.
        users, users_before: what users ask, after it and before it.
    """

    moved: tuple[str, ...]
    walk: Pictures
    before: Pictures
    after: Pictures
    users: Pictures
    users_before: Pictures


def room(cache: Path, seed: int) -> Room:
    """The room of a seed; kept in a cache."""
    path = cache / f"moved-{seed}.pickle"
    if path.is_file():
        kept = pickle.loads(path.read_bytes())
        return Room(kept["moved"], *(Pictures(*kept[name]) for name in PARTS))
    before = make_test_site(seed)
    times = np.linspace(0.0, SECONDS, 100)
    ways = np.concatenate([make_walk(number, SECONDS, seed).positions(times) for number in (WALK, *USERS)])
    after, moved = rearranged(before, MOVED_SHARE, seed, ways)
    rng = np.random.default_rng([seed, 17])
    walked = make_walk(WALK, SECONDS, seed).T_map_camera(np.linspace(0.2, SECONDS - 0.2, MAP_FRAMES))
    asked, users = (users_poses(rng, (before, after), count, seed) for count in (ASKED, QUERIES))
    found = Room(
        moved,
        walk=taken(before, walked),
        before=taken(before, asked),
        users_before=taken(before, users),
        after=taken(after, asked),
        users=taken(after, users),
    )
    cache.mkdir(parents=True, exist_ok=True)
    kept = {name: (getattr(found, name).T_map_camera, getattr(found, name).jpegs) for name in PARTS}
    path.write_bytes(pickle.dumps({"moved": moved, **kept}))
    return found


def users_poses(rng: np.random.Generator, scenes: tuple[Scene, ...], count: int, seed: int) -> FloatArray:
    """Where users hold their cameras (count, 4, 4): beside the ways of walks, looking where they like."""
    walks = [make_walk(number, SECONDS, seed) for number in USERS]
    found: list[FloatArray] = []
    while len(found) < count:
        pose = walks[rng.integers(len(walks))].poses(rng.uniform(0.5, SECONDS - 0.5, 1))[0]
        position = pose.position + rng.uniform(-_ASIDE_M, _ASIDE_M, 3) * (1, 1, 0.5)
        if not all(is_free(scene, position) for scene in scenes):
            continue
        turn = rng.uniform(-_LOOKING_ASIDE_RAD, _LOOKING_ASIDE_RAD)
        c, s = np.cos(turn), np.sin(turn)
        heading = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ pose.heading
        found.append(Pose.from_heading(position, heading, pose.roll).T_map_camera)
    return np.array(found)


def is_free(scene: Scene, position: FloatArray) -> bool:
    """Whether a camera at a position (3,) is clear of walls and furniture."""
    inside = np.abs((position - scene.room.centre) @ scene.room.axes.T) <= 0.5 * scene.room.size - _CLEAR_M
    outside = [np.abs((position - box.centre) @ box.axes.T) - 0.5 * box.size for box in scene.boxes]
    return bool(inside.all()) and min(float(gap.max()) for gap in outside) > _CLEAR_M


def taken(scene: Scene, T_map_camera: FloatArray) -> Pictures:
    """Pictures of a scene."""
    jpegs = []
    for number, T in enumerate(T_map_camera):
        picture = render_view(scene, PHONE_CAMERA, Pose(T), seed=number)
        jpegs.append(jpeg_of(picture, _JPEG_QUALITY))
    return Pictures(T_map_camera, jpegs)


def map_of(walk: Pictures, extractor: Extractor) -> Map:
    """The map of a walk at its true poses."""
    features = [extractor.extract(picture_of(jpeg)) for jpeg in walk.jpegs]
    times = np.linspace(0.0, SECONDS, len(features))
    views = Views.from_features([PHONE_CAMERA] * len(features), walk.T_map_camera, times, features)
    landmarks, stable = reconstruct(views, extractor, silent)
    info = MapInfo(
        id=uuid.uuid4().hex,
        version=1,
        density=DensityKind.RAY,
        features=extractor.name,
        metric=True,
        upright=True,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        camera=PHONE_CAMERA,
        sources=(Source(id="walk", name="walk", camera=PHONE_CAMERA),),
    )
    of_walk = np.zeros(len(views), dtype=np.int64)
    return with_landmarks(assemble(info, views, landmarks.keep(stable), of_walk, extractor.metric))


def picture_of(jpeg: bytes) -> ByteArray:
    return np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR))


@dataclass(frozen=True)
class Figures:
    """How a map answers: shares of what was asked, the median error of what was answered, and its size."""

    recall: float
    wrong: float
    median_cm: float
    size_mb: float

    def __str__(self) -> str:
        found = f"{self.recall:6.1%} right, {self.wrong:5.1%} wrong, {self.median_cm:4.2f} cm"
        return f"{found}, {self.size_mb:.2f} MB"


def asked(map_: Map, pictures: Pictures) -> Figures:
    """Pictures localized as a request does it: quickly, and with all features where that is not sure."""
    localizer, errors = Localizer(map_), []
    for jpeg, truth in zip(pictures.jpegs, pictures.T_map_camera, strict=True):
        query = Query.of_picture(picture_of(jpeg), localizer.extractor, pictures.camera)
        pose = localizer.localize(query).pose
        if pose is not None:
            errors.append(pose_distances(pose.T_map_camera, truth))
    off_m, off_rad = np.array(errors).T
    right = (off_m < LIMIT_M) & (off_rad < LIMIT_RAD)
    wrong = off_m > WRONG_M
    count = len(pictures.jpegs)
    return Figures(
        float(right.sum() / count),
        float(wrong.sum() / count),
        100 * float(np.median(off_m)),
        len(map_to_bytes(map_)) / 1e6,
    )


def sure_answers(map_: Map, pictures: Pictures) -> list[AnsweredQuery]:
    """What a server keeps of users' queries: those that the map is sure of, one each minute, of ten users."""
    localizer, found = Localizer(map_), []
    for number, jpeg in enumerate(pictures.jpegs):
        picture = picture_of(jpeg)
        answer = localizer.localize(Query.of_picture(picture, localizer.extractor, pictures.camera))
        if answer.pose is None or answer.confidence < SURE or answer.covariance is None:
            continue
        found.append(
            AnsweredQuery(
                features=localizer.extractor.extract(picture),
                camera=pictures.camera,
                T_map_camera=answer.pose.T_map_camera,
                covariance=answer.covariance,
                confidence=answer.confidence,
                time_s=60.0 * number,
                asker=f"{number % USERS_COUNT}",
            )
        )
    return found


def learned(map_: Map, pictures: Pictures) -> tuple[Map, str]:
    """The map after a night's job, and what that said."""
    queries = sure_answers(map_, pictures)
    try:
        after = learn_from_queries(map_, queries)
    except RholocError as error:
        return map_, f"{len(queries)} sure, nothing learned: {error.message}"
    report = after.info.report.learned[-1]
    assert report.queries is not None
    what = f"{len(queries)} sure, {report.views} views, {report.features_new} landmarks new"
    return after, f"{what}, {report.queries.features_forgotten} forgotten"


def learned_room(cache: Path, seed: int, extractor: Extractor) -> dict[str, Figures]:
    """The figures of one room, printed as they come."""
    found = room(cache, seed)
    first = map_of(found.walk, extractor)
    print(f"seed {seed}: moved {', '.join(found.moved)}", flush=True)
    figures = {}

    def tell(when: str, map_: Map, pictures: Pictures, said: str = "") -> None:
        figures[when] = asked(map_, pictures)
        print(f"  {when:28} {figures[when]}   {said}", flush=True)

    tell(BEFORE, first, found.before)
    tell(AFTER, first, found.after)
    after, said = learned(first, found.users)
    tell(LEARNED, after, found.after, said)
    unmoved, said = learned(first, found.users_before)
    tell(CONTROL, unmoved, found.before, said)
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description="A map that learns from its users after furniture was moved.")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "moved_rooms")
    parser.add_argument("--features", default=DEFAULT_FEATURES)
    parser.add_argument("--seeds", default="0,1,2,3,4")
    args = parser.parse_args()
    extractor = get_extractor(args.features)
    rooms = [learned_room(args.cache, int(seed), extractor) for seed in args.seeds.split(",")]
    for when in (BEFORE, AFTER, LEARNED, CONTROL):
        recalls = [figures[when].recall for figures in rooms]
        print(f"{when:30} worst {min(recalls):6.1%}, mean {np.mean(recalls):6.1%}")
    lost = [100 * (figures[BEFORE].recall - figures[LEARNED].recall) for figures in rooms]
    print(f"points lost, having learned    worst {max(lost):.1f}, mean {np.mean(lost):.1f}")


if __name__ == "__main__":
    main()
