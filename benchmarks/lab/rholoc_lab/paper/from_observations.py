"""Table 4 → map: the paper's map generator (Figure 8), the densities fitted by loss (5) to the observations."""

import hashlib
import uuid
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from rholoc.density import DensityKind, ObservedDensities, Sightings
from rholoc.density.localities import Places
from rholoc.density.tensor import DEGREES
from rholoc.errors import InvalidInput, MappingFailed
from rholoc.features import Channel, Extractor, FeatureSet, extractor_names, get_extractor
from rholoc.geometry import Camera, IntArray, Pose
from rholoc.mapping.build.assembly import assemble
from rholoc.mapping.build.density_fitting import DEFAULT_DEGREE, fit_densities, sightings_of
from rholoc.mapping.build.pipeline import reconstruct
from rholoc.mapping.build.self_report import Frame, map_report
from rholoc.mapping.build.stored_observations import with_landmarks
from rholoc.mapping.build.tracks import Views
from rholoc.maps import Map, MapInfo, ObservationTable, Source
from rholoc.progress import ProgressListener, Stage, silent
from rholoc_lab.paper.printed_loss import Loss, fit_seen, observed_loss, seen_loss

_MIN_VIEWS = 3
_HOLD_OUT_EVERY = 10
_UPRIGHT_RAD = np.deg2rad(5.0)  # of roll, in most views of a camera that is held upright
_BEYOND_PX = 5.0  # how far outside of the image a detector, or a rolling shutter undone, may put a feature
_MEASURED_DENSITIES = 300  # that the loss is computed of


@dataclass(frozen=True)
class FitOptions:
    """Options of a map that is fitted to Table 4.

    Attributes:
        density: the form of the densities; ``observed`` is fitted by loss (5) to the observations.
        degree: P, of ``observed`` and ``tensor``.
        seen_only: take (5) as it is printed, over the points where a feature was seen and no others.
        features: the extractor's name; None: the one that the descriptors' channels and length tell.
        report: whether to hold every tenth view out and localize it.
    """

    density: DensityKind = DensityKind.OBSERVED
    degree: int = DEFAULT_DEGREE
    seen_only: bool = False
    features: str | None = None
    report: bool = True


def map_from_observations(
    table: ObservationTable,
    camera: Camera,
    name: str,
    options: FitOptions | None = None,
    progress: ProgressListener = silent,
) -> Map:
    """Fit a map to a table of observations.

    Rows of one pose (and time) are a view; detections of several views that look alike and whose poses allow it are one
    feature, as while a recording is mapped.

    Raises:
        InvalidInput: no known features have such descriptors, a pixel lies outside the camera's image, the degree is
            impossible, or ``seen_only`` is asked of another form.
        MappingFailed: there are too few views, or too few features seen from enough of them.
        Cancelled: ``progress`` asked to stop.
    """
    options = options or FitOptions()
    if options.degree not in DEGREES:
        raise InvalidInput(f"A density of degree {options.degree} cannot be fitted.", "Use 1, 2 or 3.")
    if options.seen_only and options.density is not DensityKind.OBSERVED:
        raise InvalidInput(f"A '{options.density}' density is not fitted by loss (5).", "Omit --density.")
    extractor = get_extractor(options.features or features_of(table))
    _check(table, camera, extractor)
    views, held_out = _views(table, camera, hold_out=options.report)
    reconstructed, stable = reconstruct(views, extractor, progress)
    landmarks = reconstructed.keep(stable)
    progress(Stage.DENSITIES, 0.6, f"{len(landmarks)} stable features")
    rolls = np.zeros(1) if table.rolls is None else np.abs(table.rolls)
    info = MapInfo(
        id=uuid.uuid4().hex,
        version=1,
        density=DensityKind.RAY,
        features=extractor.name,
        metric=True,
        upright=bool(np.quantile(rolls, 0.8) < _UPRIGHT_RAD),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        camera=camera,
        sources=(_source(table, camera, name, len(views)),),
    )
    map_ = with_landmarks(assemble(info, views, landmarks, np.zeros(len(views), dtype=np.int64), extractor.metric))
    if options.seen_only:
        densities = fit_seen(
            sightings_of(map_), options.degree, lambda done, text: progress(Stage.DENSITIES, done, text)
        )
        map_ = replace(map_, info=replace(map_.info, density=options.density), densities=densities)
    else:
        map_ = fit_densities(map_, options.density, options.degree, progress)
    report = map_report(map_, held_out, progress)
    return replace(map_, info=replace(map_.info, report=report))


def features_of(table: ObservationTable) -> str:
    """The extractor whose features have the channels and descriptors of a table; of several, that with fewest channels.

    Raises:
        InvalidInput: there is none.
    """
    seen, length = set(np.unique(table.channels).tolist()), table.descriptors.shape[1]
    known = [get_extractor(name) for name in extractor_names()]
    fitting = [one for one in known if one.descriptor_bytes == length and seen <= {int(c) for c in one.channels}]
    if not fitting:
        names = ", ".join(sorted(Channel(channel).name for channel in seen))
        raise InvalidInput(
            f"No features that are known here have descriptors of {length} bytes on channels {names}.",
            f"Extract one of {', '.join(extractor_names())}.",
        )
    return min(fitting, key=lambda one: len(one.channels)).name


@dataclass(frozen=True)
class FitFigures:
    """Loss (5) of a map's densities; shares are medians over the densities.

    Attributes:
        densities: how many there are.
        observations: the median number that each was fitted to.
        points: N_f, the median.
        volume: w, in units of the plane z = 1 squared, cubic metres and steradians together.
        constant_share: of the loss of ρ = 0, what the best constant leaves.
        fitted_share: … what the fit leaves.
        peaked_share: of the densities, how many have a peak over (u, v) where their feature was seen.
    """

    densities: int
    observations: float
    points: float
    volume: float
    constant_share: float
    fitted_share: float
    peaked_share: float


def fit_figures(map_: Map, seen_only: bool) -> FitFigures | None:
    """Loss (5) of a map's densities, of 300 of them at most; None where they are not ``observed``.

    Raises:
        InvalidInput: the map does not remember its observations.
    """
    densities = map_.densities
    if not isinstance(densities, ObservedDensities):
        return None
    sightings = sightings_of(map_)
    places = Places.of(sightings)
    chosen = np.unique(np.linspace(0, len(densities) - 1, min(_MEASURED_DENSITIES, len(densities))).astype(np.int64))
    measure = seen_loss if seen_only else observed_loss
    losses = [_loss(densities, sightings, int(t), places.members[t], measure) for t in chosen]
    return FitFigures(
        densities=len(densities),
        observations=float(np.median(densities.counts)),
        points=float(np.median([loss.points for loss in losses])),
        volume=window_volume(),
        constant_share=float(np.median([loss.constant / loss.zero for loss in losses])),
        fitted_share=float(np.median([loss.fitted / loss.zero for loss in losses])),
        peaked_share=float(np.mean([_is_peaked(densities, sightings, int(t), places.members[t]) for t in chosen])),
    )


def window_volume() -> float:
    """w of equation (5): the volume that n(s) counts in."""
    from rholoc_lab.paper.printed_loss import WINDOW_M, WINDOW_PLANE, WINDOW_RAD

    return float((2 * WINDOW_PLANE) ** 2 * (2 * WINDOW_M) ** 3 * 2 * np.pi * (1 - np.cos(WINDOW_RAD)))


def _loss(
    densities: ObservedDensities, sightings: Sightings, t: int, members: IntArray, measure: Callable[..., Loss]
) -> Loss:
    assert sightings.bearings is not None
    return measure(densities, t, sightings.bearings[members], sightings.positions[members])


def _is_peaked(densities: ObservedDensities, sightings: Sightings, t: int, members: IntArray) -> bool:
    """Whether a density has a peak for an upright camera that looks at its feature from where it was seen."""
    assert sightings.bearings is not None
    middle = members[len(members) // 2]
    pose = Pose.from_heading(sightings.positions[middle], sightings.bearings[middle])
    return bool(densities.take(np.array([t])).at(np.zeros((1, 2)), pose.T_map_camera).peaked[0])


def _check(table: ObservationTable, camera: Camera, extractor: Extractor) -> None:
    length = table.descriptors.shape[1]
    unknown = set(np.unique(table.channels).tolist()) - {int(channel) for channel in extractor.channels}
    if length != extractor.descriptor_bytes or unknown:
        raise InvalidInput(
            f"The descriptors are not those of '{extractor.name}' features.",
            f"These have {extractor.descriptor_bytes} bytes, on channels "
            f"{', '.join(f'{int(channel):02x}' for channel in extractor.channels)}.",
        )
    edge = np.array([camera.width, camera.height]) - 0.5 + _BEYOND_PX
    outside = np.flatnonzero(((table.pixels < -0.5 - _BEYOND_PX) | (table.pixels > edge)).any(axis=1))
    if len(outside):
        u, v = table.pixels[outside[0]]
        raise InvalidInput(
            f"Row {outside[0] + 2} has the pixel ({u:g}, {v:g}), outside of {camera.width} × {camera.height}.",
            "Give the camera that took the pictures, with their size.",
        )


def _views(table: ObservationTable, camera: Camera, hold_out: bool) -> tuple[Views, list[Frame]]:
    """Group a table's rows into views; returns those of the map and those held out."""
    rolls = np.zeros(len(table)) if table.rolls is None else table.rolls
    times = np.zeros(len(table)) if table.times is None else table.times
    keys = np.column_stack([times, table.positions, table.headings, rolls])
    first, view_of = np.unique(keys, axis=0, return_index=True, return_inverse=True)[1:]
    order = np.argsort(first)  # as they come in the table
    groups = [np.flatnonzero(view_of.ravel() == group) for group in order.tolist()]
    if len(groups) < _MIN_VIEWS:
        raise MappingFailed(
            f"The observations are from {len(groups)} pose{'s' if len(groups) > 1 else ''}; a feature has to be seen "
            f"from {_MIN_VIEWS}.",
            "Give a walk's.",
        )
    held = range(_HOLD_OUT_EVERY // 2, len(groups), _HOLD_OUT_EVERY) if hold_out else range(0)
    parts = [
        (Pose.from_heading(table.positions[rows[0]], table.headings[rows[0]], rolls[rows[0]]), _features(table, rows))
        for rows in groups
    ]
    taken = [number for number in range(len(groups)) if number not in held]
    views = Views.from_features(
        [camera] * len(taken),
        np.array([parts[number][0].T_map_camera for number in taken]),
        np.array([float(number) if table.times is None else float(times[groups[number][0]]) for number in taken]),
        [parts[number][1] for number in taken],
    )
    return views, [(camera, parts[number][0].T_map_camera, parts[number][1]) for number in held]


def _features(table: ObservationTable, rows: IntArray) -> FeatureSet:
    unknown = np.zeros(len(rows), dtype=np.float32)
    return FeatureSet(
        table.pixels[rows].astype(np.float32), table.channels[rows], table.descriptors[rows], unknown, unknown + np.nan
    )


def _source(table: ObservationTable, camera: Camera, name: str, views: int) -> Source:
    digest = hashlib.blake2b(table.pixels.tobytes() + table.positions.tobytes(), digest_size=8)
    return Source(digest.hexdigest(), name, camera, frames=views, posed=views, views=views, poses="table")
