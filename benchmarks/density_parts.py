"""What each part of the density adds to geometry, from the same features in the same place of a map."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from rholoc.evaluation.errors import PoseErrors, trajectory_errors
from rholoc.geometry import Camera, FloatArray
from rholoc.localization import Dof, Localizer, Query
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.index.matches import Matches
from rholoc.localization.pose.ransac import lo_ransac
from rholoc.localization.pose.rematching import FINAL_TOLERANCE_PX, evidence_of, verify
from rholoc.localization.pose.seeds import minimal_samples, vote_for_places
from rholoc_lab.evaluation.pnp_baselines import refine_by_density
from rooms import Room

VIEWS_EACH = 10  # of a place
RANSAC_PX, RANSAC_SAMPLES = 8.0, 1_000
DENSITY_SAMPLES, SEEDS = 150, 8
WAYS = ("ransac", "samples", "climbed", "rematched", "whole")


@dataclass(frozen=True, eq=False)
class Frame:
    """A query in the place that most of its matches speak for.

    Attributes:
        query: the picture's features and camera.
        rays: (N, 3) of its features, camera frame.
        matches: mutual ones with the place, the likeliest first.
    """

    query: Query
    rays: FloatArray
    matches: Matches

    @classmethod
    def of(cls, localizer: Localizer, image: np.ndarray, camera: Camera) -> Frame | None:
        """None where nothing in the picture (H, W, 3) is like the map."""
        index, query = localizer.index, Query(localizer.extractor.extract(image), camera, Dof.FREE)
        places = vote_for_places(index, index.match_everywhere(query.features), 1, VIEWS_EACH, None)
        if not places:
            return None
        nearest = index.nearest_within(query.features, places[0].landmarks)
        return cls(query, camera.rays(query.features.pixels), nearest.matches(mutual=True).likeliest_first())


def poses(localizer: Localizer, frame: Frame) -> dict[str, FloatArray | None]:
    """The pose (4, 4) by each way, None where it finds none.

    - ransac: poselib's LO-RANSAC.
    - samples: of the density's optima near samples of three matches, the densest; no RANSAC.
    - climbed: the density's optimum near LO-RANSAC's pose.
    - rematched: the same, from matches that are looked for again about LO-RANSAC's pose.
    - whole: the localizer's, which looks in further places.
    """
    index = localizer.index
    seed, found = _ransac(index, frame), localizer.candidate(frame.query)
    verified = None if seed is None else verify(index, frame.query, frame.rays, seed)
    return {
        "ransac": seed,
        "samples": _densest(index, frame),
        "climbed": None if seed is None else refine_by_density(index, frame.query, frame.rays, frame.matches, seed),
        "rematched": None if verified is None else verified.optimum.T_map_camera,
        "whole": None if found is None else found[0].optimum.T_map_camera,
    }


def _ransac(index: MapIndex, frame: Frame) -> FloatArray | None:
    seen, landmarks = frame.rays[frame.matches.detections], index.landmarks[frame.matches.landmarks]
    found = lo_ransac(seen, landmarks, frame.query.camera.focal, RANSAC_PX, RANSAC_SAMPLES, RANSAC_SAMPLES)
    return None if found is None else found[0]


def _densest(index: MapIndex, frame: Frame) -> FloatArray | None:
    matches = frame.matches
    evidence = evidence_of(index, matches, frame.rays, frame.query.camera)
    seeds = minimal_samples(evidence, matches.chances, matches.detections, DENSITY_SAMPLES, SEEDS)
    optima = [refine_by_density(index, frame.query, frame.rays, matches, T) for T in seeds]

    def density(T: FloatArray) -> float:
        slopes = index.map.densities.near(evidence, T, FINAL_TOLERANCE_PX).at(T, FINAL_TOLERANCE_PX)
        return float(np.log1p(slopes.density / evidence.epsilon).sum())

    return max(optima, key=density, default=None)


def errors(localizer: Localizer, room: Room) -> dict[str, PoseErrors]:
    """How far each way's poses of a room's frames are off; infinitely where nothing in a frame is like the map."""
    camera = room.asked.camera
    assert camera is not None
    truth, found = [], []
    for T_map_camera, image in room.pictures():
        frame = Frame.of(localizer, image, camera)
        truth.append(T_map_camera)
        found.append(dict.fromkeys(WAYS) if frame is None else poses(localizer, frame))
    return {way: trajectory_errors(_stacked(one[way] for one in found), np.array(truth)) for way in WAYS}


def _stacked(found: Iterable[FloatArray | None]) -> FloatArray:
    return np.array([np.full((4, 4), np.nan) if T is None else T for T in found])
