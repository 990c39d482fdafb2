"""Sightings of keyframes, and evidence on their relative poses: tracked corners, matches, loop closures."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from rholoc.errors import MappingFailed
from rholoc.features import FeatureSet
from rholoc.geometry import Camera, FloatArray, IntArray
from rholoc.progress import ProgressListener
from rholoc.recordings.frames.depth import DepthImages
from rholoc.trajectory.optimization.problem import Step
from rholoc.trajectory.visual.flow import Flow
from rholoc.trajectory.visual.matching import VerifiedPair, match_keyframes, match_pictures
from rholoc.trajectory.visual.parallax import only_turned
from rholoc.trajectory.visual.rolling_shutter import RollingShutter
from rholoc.trajectory.visual.tracks import MIN_SIGHTINGS, Observations, followed_corners, matched_features
from rholoc.trajectory.visual.two_view import PairRotation

_CORNERS_PER_KEYFRAME = 90
FEATURES_PER_KEYFRAME = 150
MANY_FEATURES = 800  # per keyframe, for the last adjustment of a set of pictures
_USUAL_KEYFRAMES = 1000
_FOLLOWED = 60  # corners that neighbouring keyframes share, in the median, where pictures are close enough to follow
ADVICE = "Walk slower, keep more texture in view."
DENSER = "Take more pictures in between, from places half a step apart, and let each show half of the one before."


@dataclass(frozen=True, eq=False)
class Sights:
    """Measurements of K keyframes.

    Attributes:
        flow: corners followed through all frames.
        rows: (K,) the keyframes.
        features: of each, in pixels of the full image.
        camera: None where the intrinsics are unknown.
        is_film: whether corners are followed from frame to frame; else it is a set of pictures in no certain order.
        shutter: rolling-shutter motion of the keyframes, or None. The features are corrected for it already.
        depth: depth pictures of the keyframes, or None.
        focal_px: first guess of the focal length where the intrinsics are unknown; or None.
        lengths: measured distances [m] between two keyframes each.
        steps: measured by odometry, each from a keyframe to the next, or between keyframes of one moment by a rig.
        lenses: (K,) number of the lens that took each, if their focal lengths differ by unknown factors; or None.
        zooms: (K,) focal length of each relative to the camera's, which the features are corrected for; or None.
    """

    flow: Flow
    rows: IntArray
    features: Sequence[FeatureSet]
    camera: Camera | None
    is_film: bool = True
    shutter: RollingShutter | None = None
    depth: DepthImages | None = None
    focal_px: float | None = None
    lengths: tuple[tuple[int, int, float], ...] = ()
    steps: tuple[Step, ...] = ()
    lenses: IntArray | None = None
    zooms: FloatArray | None = None

    @property
    def times(self) -> FloatArray:
        """Times (K,) of the keyframes [s]."""
        return np.asarray(self.flow.times[self.rows])

    def take(self, some: IntArray) -> Sights:
        """The sights of the keyframes in rows ``some`` (M,), renumbered; lengths and steps to others are dropped."""
        places = {k: place for place, k in enumerate(some.tolist())}
        lengths = tuple((places[a], places[b], m) for a, b, m in self.lengths if a in places and b in places)
        shutter = None if self.shutter is None else self.shutter.take(some)
        depth = None if self.depth is None else self.depth.select(some)
        features = [self.features[k] for k in some.tolist()]
        steps = tuple(
            replace(one, first=places[one.first], second=places[one.second])
            for one in self.steps
            if one.first in places and one.second in places
        )
        return replace(
            self,
            rows=self.rows[some],
            features=features,
            shutter=shutter,
            depth=depth,
            lengths=lengths,
            steps=steps,
            lenses=None if self.lenses is None else self.lenses[some],
            zooms=None if self.zooms is None else self.zooms[some],
        )


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence from the pictures alone: tracked corners, and matches of neighbours and of loop closures.

    ``turned`` are relative rotations by tracked corners. ``weak`` are pairs of a set of pictures that may show
    different places that look alike.
    """

    corners: Observations
    turned: list[PairRotation]
    sequential: list[VerifiedPair]
    loops: list[VerifiedPair]
    weak: list[VerifiedPair] = field(default_factory=list)

    @property
    def rotations(self) -> list[PairRotation]:
        """Relative rotations of all pairs of keyframes: by corners, by matches of neighbours, by loops."""
        return [*self.turned, *(pair.rotation for pair in (*self.sequential, *self.loops))]

    def observations(
        self, sights: Sights, features: int = FEATURES_PER_KEYFRAME, fewest: int = MIN_SIGHTINGS
    ) -> Observations:
        """Sightings of corners and of about ``features`` matched features per keyframe, ``fewest`` or more of a point;
        fewer of both above 1000 keyframes.

        Raises:
            MappingFailed: there are none.
        """
        share = min(1.0, np.sqrt(_USUAL_KEYFRAMES / len(sights.rows)))
        places = [features.pixels.astype(np.float64) for features in sights.features]
        matched = matched_features(places, [*self.sequential, *self.loops], fewest)
        matched = matched.thinned(round(share * features))
        found = self.corners.thinned(round(share * _CORNERS_PER_KEYFRAME)).joined(matched)
        if len(found) == 0:
            if not (sights.is_film or sights.flow.timed):
                raise MappingFailed("No two pictures overlap enough.", DENSER)
            raise MappingFailed("The pictures show nothing that could be followed from one to the next.", ADVICE)
        return found


def gather_evidence(
    sights: Sights, camera: Camera, by_gyroscope: Rotation | None, progress: ProgressListener
) -> Evidence:
    """Match features, track corners and collect relative rotations of the keyframes.

    ``by_gyroscope`` (K) are the cameras' rotations by the gyroscope, or None. Pairs that contradict it are left out.
    Without it a set of pictures gets no corners, unless it has no features: over its steps they are less exact.

    Raises:
        MappingFailed: the camera only turned.
        Cancelled: ``progress`` asked to stop.
    """
    rays = [camera.rays(features.pixels) for features in sights.features]
    corners, rotations = Observations.none(), list[PairRotation]()
    loops, weak = list[VerifiedPair](), list[VerifiedPair]()
    in_order = sights.is_film or by_gyroscope is not None
    if in_order or not any(map(len, sights.features)):
        corners, rotations = followed_corners(sights.flow, sights.rows, camera, by_gyroscope, sights.shutter)
    if in_order:
        sequential, loops = match_keyframes(
            sights.features, rays, camera.focal, sights.times, by_gyroscope, _is_followed(sights), progress
        )
    else:
        sequential, weak = match_pictures(sights.features, rays, camera.focal, progress)
    pixels = [features.pixels for features in sights.features]
    if only_turned(sequential, pixels, camera, is_given=sights.camera is not None):
        raise MappingFailed(
            "The pictures were taken from one place; turning alone does not show how far away things are.",
            "Walk through the room, sideways where you can: half a step between pictures.",
        )
    return Evidence(corners, rotations, sequential, loops, weak)


def _is_followed(sights: Sights) -> bool:
    rows = sights.rows.tolist()
    shared = [len(sights.flow.shared(a, b)[0]) for a, b in itertools.pairwise(rows)]
    return bool(np.median(shared) >= _FOLLOWED) if shared else False
