"""Localize several frames together, with one density over all of them: the cameras of a rig, or one moving camera.

Matches are pooled, seeds come from the generalized three-point problem (rays through different centres; poselib's
solver), and the ascent maximizes the sum of all frames' log densities with their relative poses as soft constraints.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from rholoc.density import Evidence
from rholoc.errors import InvalidInput
from rholoc.geometry import FloatArray, Pose, is_rotation, pose_distances
from rholoc.geometry.resection import resected
from rholoc.lazy import lazy
from rholoc.localization.belief.acceptance import gated
from rholoc.localization.belief.confidence import MIN_RECOGNIZED, belief_of, joint_belief
from rholoc.localization.belief.map_uncertainty import with_map_error
from rholoc.localization.diagnosis import wrong_motion
from rholoc.localization.index.map_error import RIGHT_M, RIGHT_RAD
from rholoc.localization.index.map_index import MapIndex
from rholoc.localization.index.matches import Matches, NearestLandmarks
from rholoc.localization.large_map import AnyLocalizer, in_whole_map
from rholoc.localization.localizer import Localizer, check_kind, true_to_gravity
from rholoc.localization.pose.ascent import optimum_at
from rholoc.localization.pose.joint_ascent import Link, ascend_together, joint_covariances, refined_together
from rholoc.localization.pose.pose_evidence import Support, support_of
from rholoc.localization.pose.ransac import credible_pose
from rholoc.localization.pose.rematching import (
    FINAL_TOLERANCE_PX,
    SEARCH_RADII_PX,
    Verified,
    evidence_of,
    settling,
    verify,
)
from rholoc.localization.pose.rivals import RIVAL_PLACES, are_rivals, fewest_agreeing, shares, unexplained_by_place
from rholoc.localization.pose.seeds import vote_for_places
from rholoc.localization.types import Belief, Dof, Intrinsics, Localization, Query, Reason

MIN_FRAMES, MAX_FRAMES = 2, 10
_PLACES = 6
_VIEWS_EACH = 10
_SAMPLES = (1000, 30)
_TOLERANCE_PX = 12.0
_MIN_MATCHES = 6
_ALONE_SAMPLES = (300, 30)
_TIMES_AS_MUCH = 2.0  # minimum ratio of a frame's evidence for its own pose to that for its joint pose, to be a stray
_FAR_SIGMAS = 3.0


def check_frame_count(count: int) -> None:
    """Raise InvalidInput unless ``count`` is 2 to 10 frames."""
    if not MIN_FRAMES <= count <= MAX_FRAMES:
        raise InvalidInput(
            f"{count} frames; {MIN_FRAMES} to {MAX_FRAMES} can be localized together.",
            "Send a single frame by itself, and long sequences in parts.",
        )


@dataclass(frozen=True, eq=False)
class SeveralFrames:
    """Frames with known relative poses.

    Attributes:
        frames: 2 to 10 queries. Of each, features, camera, gravity and picture are used; ``dof``, ``deadline_s`` and
            ``max_sigma_…`` come from the first one.
        T_rig_cameras: (N, 4, 4) each camera's pose in an arbitrary common frame, such as a rig's or odometry's.
        sigma_m: standard deviation of a frame's position relative to its predecessor, along each axis.
        sigma_rad: standard deviation of its rotation, about each axis.

    Raises:
        InvalidInput: fewer than 2 or more than 10 frames, invalid poses, or no positive standard deviation.
    """

    frames: tuple[Query, ...]
    T_rig_cameras: FloatArray
    sigma_m: float = 0.005
    sigma_rad: float = 0.003

    def __post_init__(self) -> None:
        count = len(self.frames)
        check_frame_count(count)
        if self.T_rig_cameras.shape != (count, 4, 4) or not all(is_rigid(T) for T in self.T_rig_cameras):
            raise InvalidInput(
                "A frame's relative pose is not a rigid motion.",
                "Send a rotation (orthonormal, determinant +1) and a finite position for every frame.",
            )
        if not (0 < self.sigma_m < np.inf and 0 < self.sigma_rad < np.inf):
            raise InvalidInput("The uncertainty of the relative poses is not positive.", "Send sigmas above 0.")

    def within(self, spent_s: float) -> SeveralFrames:
        """A copy with the deadline reduced by ``spent_s``, at least to 0; the same without a deadline."""
        first, *others = self.frames
        if first.deadline_s is None:
            return self
        return replace(self, frames=(replace(first, deadline_s=max(first.deadline_s - spent_s, 0.0)), *others))

    @property
    def links(self) -> list[Link]:
        """Relative pose from each frame to the next."""
        T = self.T_rig_cameras
        return [Link(i, i + 1, np.linalg.inv(T[i]) @ T[i + 1], self.sigma_m, self.sigma_rad) for i in range(len(T) - 1)]


@dataclass(frozen=True, eq=False)
class JointLocalization:
    """Answer for several frames.

    Attributes:
        first: answer for the first frame; its counts of matches and inliers cover all frames.
        poses: pose of every frame, in order; empty if there is no answer.
        inliers: number of inliers in each frame.
    """

    first: Localization
    poses: tuple[Pose, ...]
    inliers: tuple[int, ...]


def is_rigid(T: FloatArray) -> bool:
    """Whether a matrix (4, 4) is a finite rigid transform."""
    return bool(np.isfinite(T).all() and np.allclose(T[3], (0, 0, 0, 1)) and is_rotation(T[:3, :3]))


def localize_together(localizer: AnyLocalizer, asked: SeveralFrames) -> JointLocalization:
    """Localize several frames. A refusal is an answer, as for one frame. In a large map only the part that they vote
    for is searched.

    Raises:
        InvalidDescriptors: a frame's features are not of the map's kind.
        InvalidInput: a frame's intrinsics are unknown; only single frames can estimate them.
    """
    for frame in asked.frames:
        check_kind(frame.features, localizer.extractor)
        if frame.intrinsics is Intrinsics.UNKNOWN:
            raise InvalidInput("Frames that are localized together need their intrinsics.", "Send fx, fy, cx, cy.")
    if isinstance(localizer, Localizer):
        return _Joint(localizer, asked).localize()
    started = time.perf_counter()
    part, around = localizer.around([frame.features for frame in asked.frames])
    place_s = time.perf_counter() - started
    joint = _Joint(around, asked.within(place_s)).localize()
    return replace(joint, first=in_whole_map(joint.first, part, 1e3 * place_s))


@dataclass(frozen=True, eq=False)
class _Candidate:
    """Candidate poses (N, 4, 4), their evidence in each frame, and the belief in them."""

    verified: tuple[Verified, ...]
    covariances: FloatArray
    belief: Belief

    @property
    def support(self) -> Support:
        """Mean evidence over the frames."""
        return Support.mean([one.support for one in self.verified])

    def is_rival_of(self, other: _Candidate) -> bool:
        """Whether two candidates exclude each other: some frame's poses are of different places."""
        return any(are_rivals(a, b) for a, b in zip(self.verified, other.verified, strict=True))


@dataclass(frozen=True)
class _Stray:
    """A frame that alone has another pose than together with the others.

    Attributes:
        number: of the frame, from 0.
        apart_m: distance of the two poses.
        turned_rad: angle between them.
        recognized: probability 0 to 1 that its own pose is of the right place.
    """

    number: int
    apart_m: float
    turned_rad: float
    recognized: float


class _Joint:
    """One joint localization."""

    def __init__(self, localizer: Localizer, asked: SeveralFrames) -> None:
        self.localizer, self.index, self.asked = localizer, localizer.index, asked
        self.frames = [localizer.adapted(frame) for frame in asked.frames]
        self.dof: Dof = self.frames[0].dof
        self.rays = [frame.camera.rays(frame.features.pixels) for frame in self.frames]
        self.started = time.perf_counter()

    def localize(self) -> JointLocalization:
        """Try one set of matches after the other until a candidate is conclusive or the deadline has passed; answer
        with the best. Without a candidate, a refusal with its reason.
        """
        best: _Candidate | None = None
        found: list[_Candidate] = []
        reason, matched = Reason.NO_AGREEMENT, 0
        for matches in self._pools():
            matched = matched or sum(len(one) for one in matches)
            if best is not None and self._late():
                break
            candidate = self._candidate(matches)
            if candidate is not None:
                found.append(candidate)
                best = candidate if best is None or candidate.belief.recognized > best.belief.recognized else best
            if best is not None and best.belief.confidence >= self.localizer.options.conclusive:
                break
            if self._late():
                reason = Reason.DEADLINE
                break
        if matched < _MIN_MATCHES:
            reason = Reason.NO_MATCHES
        if best is None:
            return self._answer(best, reason, matched)
        best = self._contested(best, found)
        if best.belief.recognized < self.localizer.min_recognized:
            return self._answer(best, reason, matched)
        strays = [*self._strays(best)]
        likeliest = max(strays, key=lambda stray: stray.recognized, default=None)
        if likeliest is not None:
            left = 1 - likeliest.recognized
            best = replace(best, belief=replace(best.belief, recognized=best.belief.recognized * left))
        return self._answer(best, reason, matched, likeliest)

    def _strays(self, best: _Candidate) -> Iterator[_Stray]:
        """Iterate over frames that alone have another pose, by which they explain twice as much as by the joint one.

        That pose is more than 10 cm or 5° from the joint one, and more than three standard deviations that the relative
        poses accumulate. Ends at the deadline.
        """
        steps = math.sqrt(len(self.frames) - 1)
        far_m = max(RIGHT_M, _FAR_SIGMAS * steps * self.asked.sigma_m)
        far_rad = max(RIGHT_RAD, _FAR_SIGMAS * steps * self.asked.sigma_rad)
        for number, (frame, rays, joint) in enumerate(zip(self.frames, self.rays, best.verified, strict=True)):
            if self._late():
                return
            seed = credible_pose(self.index, frame, self._nearest[number].matches(), _TOLERANCE_PX, _ALONE_SAMPLES)
            apart_m, turned_rad = (0.0, 0.0) if seed is None else pose_distances(seed[0], joint.optimum.T_map_camera)
            if seed is None or (apart_m < far_m and turned_rad < far_rad):
                continue
            alone = verify(self.index, frame, rays, seed[0])
            if alone is None or not true_to_gravity(alone.optimum.T_map_camera, frame.gravity):
                continue
            if alone.optimum.value < _TIMES_AS_MUCH * joint.optimum.value:
                continue
            if alone.is_apart(joint, far_m, far_rad):
                apart_m, turned_rad = pose_distances(alone.optimum.T_map_camera, joint.optimum.T_map_camera)
                yield _Stray(number, float(apart_m), float(turned_rad), belief_of(alone).recognized)

    def _contested(self, best: _Candidate, found: list[_Candidate]) -> _Candidate:
        """A candidate whose probability is shared with its best rival, if there is one. Rivals are those among
        ``found``, and, for a candidate with at least ``MIN_RECOGNIZED``, those of a further search.
        """
        rivals = [*found]
        if best.belief.recognized >= MIN_RECOGNIZED:
            rivals += self._looked_for(best)
        others = [one for one in rivals if one is not best and one.is_rival_of(best)]
        rival = max(others, key=lambda one: one.support.net, default=None)
        if rival is None:
            return best
        places = np.array([best.belief.recognized, rival.belief.recognized])
        share = float(shares(places, np.array([best.support.net, rival.support.net]))[0])
        return replace(best, belief=replace(best.belief, recognized=best.belief.recognized * share))

    def _looked_for(self, best: _Candidate) -> Iterator[_Candidate]:
        """Iterate over candidates from matches that ``best`` does not explain, with a minimum number of inliers, until
        the deadline.
        """
        fewest = fewest_agreeing(sum(one.inliers for one in best.verified))
        by_frame = [
            list(unexplained_by_place(self.index, one, frame, verified))
            for one, frame, verified in zip(self._nearest, self.frames, best.verified, strict=True)
        ]
        for rank in range(RIVAL_PLACES):
            if self._late():
                return
            matches = [places[rank] if len(places) > rank else Matches.none() for places in by_frame]
            candidate = self._candidate(matches, fewest)
            if candidate is not None:
                yield candidate

    def _late(self) -> bool:
        """Whether the first frame's deadline has passed; False without one."""
        deadline_s = self.frames[0].deadline_s
        return deadline_s is not None and time.perf_counter() - self.started > deadline_s

    @lazy
    def _nearest(self) -> list[NearestLandmarks]:
        """Nearest landmarks of each frame's features in the whole map."""
        return [self.index.nearest_everywhere(frame.features) for frame in self.frames]

    def _pools(self) -> Iterator[list[Matches]]:
        """Iterate over sets of matches, with a list entry for each frame.

        The first set is with the whole map. Set k of up to six others is with each frame's own k-th likeliest place.
        """
        everywhere = [one.matches() for one in self._nearest]
        yield everywhere
        places = [vote_for_places(self.index, one, _PLACES, _VIEWS_EACH, None) for one in everywhere]
        for rank in range(_PLACES):
            if not any(len(own) > rank for own in places):
                return
            yield [
                self.index.match_within(frame.features, own[rank].landmarks) if len(own) > rank else Matches.none()
                for frame, own in zip(self.frames, places, strict=True)
            ]

    def _candidate(self, matches: list[Matches], fewest: float = _MIN_MATCHES) -> _Candidate | None:
        """Verified candidate from a LO-RANSAC seed of at least ``fewest`` inliers in all frames; None without one."""
        T_map_rig = self._seed(matches, fewest)
        if T_map_rig is None:
            return None
        return self._verified(T_map_rig @ self.asked.T_rig_cameras)

    def _seed(self, matches: list[Matches], fewest: float = _MIN_MATCHES) -> FloatArray | None:
        """Pose T_map_rig (4, 4) by LO-RANSAC over all frames' matches. None if fewer than ``fewest`` agree (12 px)."""
        ordered = [one.likeliest_first() for one in matches]
        if sum(len(one) for one in ordered) < fewest:
            return None
        focal_px = float(np.mean([frame.camera.focal for frame in self.frames]))
        seen = [rays[one.detections] for rays, one in zip(self.rays, ordered, strict=True)]
        points = [self.index.landmarks[one.landmarks] for one in ordered]
        settings = {
            "max_iterations": _SAMPLES[0],
            "min_iterations": _SAMPLES[1],
            "max_reproj_error": _TOLERANCE_PX,
            "success_prob": 0.9999,
        }
        T_map_rig, agreeing = resected(seen, points, self.asked.T_rig_cameras, focal_px, settings)
        return T_map_rig if agreeing >= fewest and np.isfinite(T_map_rig).all() else None

    def _verified(self, T_map_cameras: FloatArray) -> _Candidate | None:
        """Match again around the poses (N, 4, 4) and ascend, within 14 px and then 5 px. Returns None if either radius
        has fewer than six matches over all frames, or a pose contradicts its frame's gravity.
        """
        T, links, densities = T_map_cameras, self.asked.links, self.index.map.densities
        wide: list[Matches] = []
        for radius in SEARCH_RADII_PX:
            near = [
                self.index.match_near(frame.features, frame.camera, pose, radius)
                for frame, pose in zip(self.frames, T, strict=True)
            ]
            if sum(len(matches) for matches, _ in near) < _MIN_MATCHES:
                return None
            wide = wide or [matches for matches, _ in near]
            evidences = [
                evidence_of(self.index, matches, rays, frame.camera)
                for (matches, _), rays, frame in zip(near, self.rays, self.frames, strict=True)
            ]
            tolerances_px = (*(px for px in (radius, radius / 2) if px > FINAL_TOLERANCE_PX), FINAL_TOLERANCE_PX)
            T = ascend_together(densities, evidences, T, links, tolerances_px, self.dof)
        some = [
            one.take(settling(self.index, matches, optimum_at(densities, one, pose, FINAL_TOLERANCE_PX)))
            for one, (matches, _), pose in zip(evidences, near, T, strict=True)
        ]
        T = refined_together(some, T, links, self.dof)
        if not all(true_to_gravity(pose, frame.gravity) for pose, frame in zip(T, self.frames, strict=True)):
            return None
        verified = tuple(
            _verified(self.index, frame, pose, matches, evidence, by_chance, around)
            for frame, pose, (matches, by_chance), evidence, around in zip(
                self.frames, T, near, evidences, wide, strict=True
            )
        )
        covariances = joint_covariances([one.evidence for one in verified], [one.optimum for one in verified], links)
        return _Candidate(verified, covariances, joint_belief(verified, covariances[0]))

    def _answer(
        self, best: _Candidate | None, reason: Reason, matched: int, stray: _Stray | None = None
    ) -> JointLocalization:
        """The answer with a candidate, if probable and exact enough, else a refusal; a stray becomes its diagnosis."""
        timings_ms = {"match": 1e3 * (time.perf_counter() - self.started)}
        if best is None:
            refusal = Localization.refused(reason, matched, timings_ms)
            return JointLocalization(refusal, (), ())
        poses = tuple(Pose(one.optimum.T_map_camera) for one in best.verified)
        inliers = tuple(one.inliers for one in best.verified)
        first = Localization(
            localized=True,
            reason=None,
            pose=poses[0],
            covariance=best.covariances[0],
            belief=best.belief,
            matches=max(matched, sum(len(one.matches) for one in best.verified)),
            inliers=sum(inliers),
            inlier_pixels=best.verified[0].inlier_pixels,
            inlier_features=np.concatenate([one.inlier_landmarks for one in best.verified]),
            timings_ms=timings_ms,
        )
        first = gated(with_map_error(self.index, first), self.localizer.min_recognized, self.asked.frames[0])
        if stray is not None and first.reason is Reason.NOT_RECOGNIZED:
            first = replace(first, diagnosis=wrong_motion(stray.number, stray.apart_m, stray.turned_rad))
        return JointLocalization(first, poses if first.localized else (), inliers)


def _verified(
    index: MapIndex,
    frame: Query,
    T_map_camera: FloatArray,
    matches: Matches,
    evidence: Evidence,
    by_chance: FloatArray,
    wide: Matches,
) -> Verified:
    """A frame's pose rated by its matches; ``by_chance`` (N,) and ``wide`` as of :func:`support_of`."""
    optimum = optimum_at(index.map.densities, evidence, T_map_camera, FINAL_TOLERANCE_PX)
    support = support_of(index, frame, matches, evidence, optimum, by_chance, wide)
    return Verified(optimum, matches, evidence, frame.features.pixels[matches.detections], wide, support)
