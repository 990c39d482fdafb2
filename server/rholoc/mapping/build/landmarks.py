"""Tracks → landmarks: robust information sums, guided search for more observations, merging, selection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from rholoc.density.presence import Presence, group_sums
from rholoc.density.ray import landmarks_from_information, observation_information, range_information
from rholoc.features import Metric
from rholoc.features.matching import LIMITS, descriptor_distances
from rholoc.geometry import BoolArray, FloatArray, IntArray
from rholoc.geometry.graphs import components
from rholoc.mapping.build.tracks import Views

PIXEL_NOISE_PX = 1.5  # of a detection against the landmark's true projection, one sigma
_ROBUST_SCALES_PX = (16.0, 8.0, 4.0, 3.0, 3.0)
_OUTLIER_PX = 5.0
_SEARCH_RADIUS_PX = 5.0
_RANGE_SIGMA, _RANGE_SIGMA_M = 0.02, 0.02  # of a measured range: relative, and in addition
_RANGE_SIGMAS = 2.0  # deviation of a range from the triangulated distance, above which it gets little weight
_MIN_DEPTH = 1e-3  # in the map's unit: lower bound on a viewing distance that is divided by
_MIN_VIEWS = 3
_ENOUGH = 100  # landmarks of a view; where fewer are seen by three views, as in sets of photos, two views suffice
_MAX_RELATIVE_SIGMA = 0.1  # of the largest standard deviation against the distance it is seen from
_MERGE_PX = 3.0
_MERGE_CHI2 = 4.0


@dataclass(frozen=True, eq=False)
class Landmarks:
    """F landmarks and their observations.

    Attributes:
        information: (F, 3, 3) Λ [1/m²].
        eta: (F, 3) η [1/m].
        labels: (N,) landmark 0 to F-1 of each detection in the views, or -1.
        positions: (F, 3) Λ⁻¹ η [m].
        covariances: (F, 3, 3) Λ⁻¹ [m²].
    """

    information: FloatArray
    eta: FloatArray
    labels: IntArray
    positions: FloatArray
    covariances: FloatArray

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def observed_rows(self) -> IntArray:
        """Rows (O,) of the detections with a landmark."""
        return np.flatnonzero(self.labels >= 0)

    @property
    def view_counts(self) -> IntArray:
        """(F,) number of views that see each landmark."""
        return np.bincount(self.labels[self.labels >= 0], minlength=len(self))

    def presence(self, views: Views) -> Presence:
        """Presence of each landmark: the directions and distances from which ``views`` saw it."""
        rows = self.observed_rows
        return Presence.of(self.positions, views.positions[views.view_of[rows]], self.labels[rows])

    def keep(self, kept: BoolArray) -> Landmarks:
        """The landmarks where ``kept`` (F,) is true, renumbered."""
        number = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)  # of no landmark, -1, too
        labels = number[self.labels]
        return Landmarks(self.information[kept], self.eta[kept], labels, self.positions[kept], self.covariances[kept])


def triangulate(views: Views, labels: IntArray) -> Landmarks:
    """Triangulate tracks with labels (N,), -1 for none, by robust information sums.

    Observations with a residual above 5 px lose their label. Drops landmarks with a singular position, and those with
    fewer than two observations unless a range was measured. The others are renumbered.
    """
    rows = np.flatnonzero(labels >= 0)
    tracks, count = labels[rows], int(labels.max(initial=-1)) + 1
    view = views.view_of[rows]
    bearings, positions, focal_px = views.bearings[rows], views.positions[view], views.focal_px[view]
    information, eta, kept = estimate_information(tracks, count, bearings, positions, focal_px, views.ranges_m[rows])
    final = np.full(len(labels), -1, dtype=np.int64)
    final[rows] = np.where(kept, tracks, -1)
    landmarks, covariances = landmarks_from_information(information, eta)
    enough = enough_observations(final[final >= 0], views.ranges_m[final >= 0], count)
    every = Landmarks(information, eta, final, landmarks, covariances)
    return every.keep(enough & np.isfinite(landmarks).all(axis=1))


def enough_observations(tracks: IntArray, ranges_m: FloatArray, count: int) -> BoolArray:
    """Mask (count,) of tracks with two observations (O,), or with one whose range (O,) was measured (is not NaN)."""
    measured = np.bincount(tracks[np.isfinite(ranges_m)], minlength=count) > 0
    return np.asarray(measured | (np.bincount(tracks, minlength=count) >= 2))


def with_ranged(views: Views, labels: IntArray) -> IntArray:
    """Labels (N,) of tracks, and new ones of detections without a track whose range was measured.

    Only in views with fewer than 100 detections in tracks of three views: elsewhere they add nothing.
    """
    many = np.bincount(labels[labels >= 0], minlength=1) >= _MIN_VIEWS
    tracked = (labels >= 0) & many[labels]
    scarce = np.bincount(views.view_of, weights=tracked, minlength=len(views)) < _ENOUGH
    alone = np.flatnonzero((labels < 0) & np.isfinite(views.ranges_m) & scarce[views.view_of])
    ranged = labels.copy()
    ranged[alone] = np.arange(len(alone)) + labels.max(initial=-1) + 1
    return ranged


def estimate_information(
    tracks: IntArray,
    count: int,
    bearings: FloatArray,
    positions: FloatArray,
    focal_px: FloatArray,
    ranges_m: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Λ (count, 3, 3) [1/m²] and η (count, 3) [1/m] of each track, and the mask (O,) of observations within 5 px.

    Weights decrease with the residual, over narrowing tolerances. The result does not depend on the observations'
    order.

    Args:
        tracks: (O,) track 0 to count-1 of each observation.
        count: number of tracks.
        bearings: (O, 3) unit vectors in the map frame.
        positions: (O, 3) of the cameras [m].
        focal_px: (O,) their focal lengths.
        ranges_m: (O,) measured distances along the bearings, NaN where unknown; None if all are.
    """
    ranges_m = np.full(len(tracks), np.nan) if ranges_m is None else ranges_m
    observed = _Observed(tracks, count, bearings, positions, focal_px, ranges_m)
    information, eta = observed.sums(np.ones(len(tracks)), np.ones(len(tracks)))
    for scale_px in _ROBUST_SCALES_PX:
        residual_px, weights, range_weights = observed.residuals(information, eta)
        fading = 1 / (1 + np.minimum(residual_px / scale_px, 1e3) ** 2) ** 2
        information, eta = observed.sums(weights * fading, range_weights * fading)
    residual_px, weights, range_weights = observed.residuals(information, eta)
    kept = residual_px < _OUTLIER_PX
    information, eta = observed.sums(np.where(kept, weights, 0), np.where(kept, range_weights, 0))
    return information, eta, kept


def extend_and_merge(views: Views, landmarks: Landmarks, metric: Metric) -> Landmarks:
    """Search further observations within 5 px of each landmark's projections, merge duplicate landmarks, and
    triangulate again.

    Returns new landmarks, numbered anew.
    """
    if len(landmarks) == 0:
        return landmarks
    labels = landmarks.labels.copy()
    medoids = np.array(
        [rows[0] for rows in representative_rows(views, landmarks.labels, len(landmarks), metric, most=1)],
        dtype=np.int64,
    )
    presence = landmarks.presence(views)
    same: list[IntArray] = []
    for k in range(len(views)):
        here = slice(int(views.offsets[k]), int(views.offsets[k + 1]))
        seen, rows = _guided_matches(views, landmarks, medoids, presence, k, metric)
        new = ~np.isin(seen, labels[here][labels[here] >= 0])
        seen, rows = seen[new], rows[new]
        free = labels[rows] < 0
        owner, other = labels[rows[~free]], seen[~free]
        same.append(np.column_stack([owner, other])[_coincide(views, landmarks, owner, other, k)])
        labels[rows[free]] = seen[free]
    return triangulate(views, _merged(labels, np.concatenate(same), len(landmarks), views.view_of))


def are_stable(views: Views, landmarks: Landmarks, per_view: int, walks: IntArray | None = None) -> BoolArray:
    """Mask (F,) of the landmarks worth keeping: precise, and among the ``per_view`` best of at least one view.

    Precise is a largest standard deviation below a tenth of the mean viewing distance. Landmarks rank by the number of
    views that see them; with several walks, by the probability that a further walk sees them first. A landmark seen by
    only two views must be among the 100 best of a view. The map thus grows with the space it covers, not with the
    duration of the walk.

    Args:
        views: K views.
        landmarks: their landmarks.
        per_view: maximum number of landmarks that each view contributes.
        walks: (K,) number of the walk that each view belongs to; None for a single walk.
    """
    rows, counts = landmarks.observed_rows, landmarks.view_counts
    labels, view = landmarks.labels[rows], views.view_of[rows]
    stable = relative_sigmas(views, landmarks) < _MAX_RELATIVE_SIGMA
    labels, view = labels[stable[labels]], view[stable[labels]]
    persistence: FloatArray = np.zeros(len(landmarks))
    if walks is not None and walks.max(initial=0) > 0:
        persistence = expected_sightings(views, landmarks, walks)
    order = np.lexsort((labels, -counts[labels], -persistence[labels], view))
    rank = np.arange(len(order)) - np.searchsorted(view[order], view[order])
    kept = np.zeros(len(landmarks), dtype=bool)
    most = np.where(counts[labels[order]] >= _MIN_VIEWS, per_view, min(per_view, _ENOUGH))
    kept[labels[order][rank < most]] = True
    return kept


def relative_sigmas(views: Views, landmarks: Landmarks) -> FloatArray:
    """Largest standard deviation of each landmark (F,), divided by its mean viewing distance."""
    rows = landmarks.observed_rows
    labels = landmarks.labels[rows]
    depth = np.linalg.norm(landmarks.positions[labels] - views.positions[views.view_of[rows]], axis=1)
    mean_depth = np.bincount(labels, weights=depth, minlength=len(landmarks)) / np.maximum(landmarks.view_counts, 1)
    sigma = np.sqrt(np.linalg.eigvalsh(landmarks.covariances)[:, -1])
    return np.asarray(sigma / np.maximum(mean_depth, _MIN_DEPTH))


def expected_sightings(views: Views, landmarks: Landmarks, walks: IntArray) -> FloatArray:
    """Probability (F,) that a further walk past each landmark sees it again, despite other light, time or furniture.

    Rule of succession, (seen + 1) / (passed + 2), over walks. A walk passed a landmark if it saw it, or had it in the
    picture of at least three views from where it may be seen (:meth:`Landmarks.presence`).

    Args:
        views: K views.
        landmarks: their landmarks.
        walks: (K,) number 0 to W-1 of the walk that each view belongs to.
    """
    shape = (len(landmarks), int(walks.max(initial=0)) + 1)
    saw, chances = np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.int64)
    presence = landmarks.presence(views)
    for k, walk in enumerate(walks.tolist()):
        T, camera = views.T_map_camera[k], views.cameras[k]
        shown = camera.contains(camera.project((landmarks.positions - T[:3, 3]) @ T[:3, :3]))
        chances[shown & presence.allows(landmarks.positions, T[:3, 3]), walk] += 1
        here = landmarks.labels[views.offsets[k] : views.offsets[k + 1]]
        saw[here[here >= 0], walk] = True
    passed = saw | (chances >= _MIN_VIEWS)
    return np.asarray((saw.sum(axis=1) + 1) / (passed.sum(axis=1) + 2))


def representative_rows(views: Views, labels: IntArray, count: int, metric: Metric, most: int) -> list[IntArray]:
    """For each of ``count`` landmarks the rows of the detections with the most representative descriptors, at most
    ``most``.

    The first is the medoid. Further ones reduce the distances to the other descriptors most, as long as some descriptor
    is farther than half the strict limit. Empty for a landmark without detections labelled (N,) with it.
    """
    order = np.argsort(labels, kind="stable")
    bounds = np.searchsorted(labels[order], np.arange(count + 1))
    return [_representatives(order[bounds[f] : bounds[f + 1]], views, metric, most) for f in range(count)]


def _representatives(rows: IntArray, views: Views, metric: Metric, most: int) -> IntArray:
    """At most ``most`` of the rows (N,): the medoid of their descriptors, then those that stand for the others best."""
    descriptors = views.features.descriptors[rows]
    n = len(rows)
    if n == 0:
        return rows
    distances = descriptor_distances(np.repeat(descriptors, n, axis=0), np.tile(descriptors, (n, 1)), metric).reshape(
        n, n
    )
    chosen = [int(np.argmin(distances.sum(axis=1)))]
    while len(chosen) < min(most, n):
        unlike = distances[:, chosen].min(axis=1)
        if unlike.max() < LIMITS[metric].strict / 2:
            break
        gain = np.maximum(unlike[None] - distances, 0).sum(axis=1)
        chosen.append(int(np.argmax(gain)))
    return rows[chosen]


@dataclass(frozen=True, eq=False)
class _Observed:
    """O observations of tracks, as of :func:`estimate_information`."""

    tracks: IntArray
    count: int
    bearings: FloatArray
    positions: FloatArray
    focal_px: FloatArray
    ranges_m: FloatArray

    def sums(self, weights: FloatArray, range_weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sums by track of information matrices Λ (count, 3, 3) and vectors η = Λ position (count, 3), of the rays with
        weights (O,) and the ranges with weights (O,), both in 1/m².
        """
        information, eta = observation_information(self.bearings, self.positions, weights)
        known = np.flatnonzero(np.isfinite(self.ranges_m))
        if len(known):  # few recordings have depth
            along, eta_along = range_information(
                self.bearings[known], self.positions[known], self.ranges_m[known], range_weights[known]
            )
            information[known] += along
            eta[known] += eta_along
        columns = np.concatenate([information.reshape(-1, 9), eta], axis=1)
        summed = group_sums(self.tracks, columns, self.count)
        return summed[:, :9].reshape(-1, 3, 3), summed[:, 9:]

    def residuals(self, information: FloatArray, eta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Reprojection error (O,) [px], infinite behind the camera; weights (O,) of rays and (O,) of ranges [1/m²]."""
        landmarks, _ = landmarks_from_information(information, eta)
        to_landmark = landmarks[self.tracks] - self.positions
        along = np.einsum("ni,ni->n", to_landmark, self.bearings)
        aside = np.linalg.norm(to_landmark - along[:, None] * self.bearings, axis=1)
        depth = np.maximum(np.nan_to_num(along), _MIN_DEPTH)
        residual_px = np.where(along > _MIN_DEPTH, self.focal_px * aside / depth, np.inf)
        sigma_m = _RANGE_SIGMA * self.ranges_m + _RANGE_SIGMA_M
        off = (along - self.ranges_m) / sigma_m
        range_weights = np.nan_to_num(1 / (sigma_m * (1 + (off / _RANGE_SIGMAS) ** 2)) ** 2)
        return np.nan_to_num(residual_px, nan=np.inf), (self.focal_px / (PIXEL_NOISE_PX * depth)) ** 2, range_weights


def _guided_matches(
    views: Views, landmarks: Landmarks, medoids: IntArray, presence: Presence, k: int, metric: Metric
) -> tuple[IntArray, IntArray]:
    """Mutual best matches of view ``k`` as rows of landmarks (C,) and of detections (C,). Candidates are visible
    landmarks within 5 px of a detection, of its channel, and within the strict descriptor limit.
    ``medoids`` (F,) are the detections whose descriptors stand for the landmarks.
    """
    T, camera = views.T_map_camera[k], views.cameras[k]
    pixels = camera.project((landmarks.positions - T[:3, 3]) @ T[:3, :3])
    visible = np.flatnonzero(camera.contains(pixels) & presence.allows(landmarks.positions, T[:3, 3]))
    detections = views.features.pixels[views.offsets[k] : views.offsets[k + 1]]
    if len(visible) == 0 or len(detections) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    near = cKDTree(pixels[visible]).sparse_distance_matrix(
        cKDTree(detections), _SEARCH_RADIUS_PX, output_type="ndarray"
    )
    seen, rows = visible[near["i"]], views.offsets[k] + near["j"].astype(np.int64)
    templates = medoids[seen]
    distance = descriptor_distances(views.features.descriptors[rows], views.features.descriptors[templates], metric)
    alike = (distance <= LIMITS[metric].strict) & (views.features.channels[rows] == views.features.channels[templates])
    seen, rows, distance = seen[alike], rows[alike], distance[alike]
    order = np.lexsort((rows, seen, distance))
    seen, rows = seen[order], rows[order]
    is_best = np.zeros(len(seen), dtype=bool)
    first_of_landmark = np.unique(seen, return_index=True)[1]
    is_best[first_of_landmark] = True
    first_of_detection = np.zeros(len(seen), dtype=bool)
    first_of_detection[np.unique(rows, return_index=True)[1]] = True
    mutual = is_best & first_of_detection
    return seen[mutual], rows[mutual]


def _coincide(views: Views, landmarks: Landmarks, a: IntArray, b: IntArray, k: int) -> BoolArray:
    """Mask (M,) of pairs of landmarks ``a`` (M,) and ``b`` (M,) at the same place.

    Their difference has χ² < 4 under the sum of both covariances and of an isotropic sigma of 3 px in view ``k``.
    """
    apart = landmarks.positions[a] - landmarks.positions[b]
    depth = np.linalg.norm(landmarks.positions[a] - views.positions[k], axis=1)
    floor = (_MERGE_PX * depth / views.cameras[k].focal) ** 2
    variance = landmarks.covariances[a] + landmarks.covariances[b] + floor[:, None, None] * np.eye(3)
    chi2 = np.einsum("mi,mi->m", apart, np.linalg.solve(variance, apart[..., None])[..., 0])
    return np.asarray(chi2 < _MERGE_CHI2)


def _merged(labels: IntArray, same: IntArray, count: int, view_of: IntArray) -> IntArray:
    """Labels (N,), renumbered, after merging the pairs ``same`` (M, 2) of landmarks.

    A pair that one view sees both of is not merged.
    """
    rows = np.flatnonzero(labels >= 0)
    shown = coo_array(
        (np.ones(len(rows), dtype=np.int32), (labels[rows], view_of[rows])), shape=(count, int(view_of.max()) + 1)
    ).tocsr()
    same = np.unique(np.sort(same, axis=1), axis=0)
    apart = np.asarray(shown[same[:, 0]].multiply(shown[same[:, 1]]).sum(axis=1)).ravel() == 0
    same = same[apart]
    merged = np.where(labels >= 0, components(count, same)[labels], -1)
    return _without_doubles(merged, view_of)


def _without_doubles(labels: IntArray, view_of: IntArray) -> IntArray:
    """Renumbered labels (N,); -1 for labels that occur twice in a view, which confuse two landmarks."""
    keys = labels * (int(view_of.max()) + 1) + view_of
    _, key, counts = np.unique(keys, return_inverse=True, return_counts=True)
    single = np.where(counts[key] == 1, labels, -1)
    kept = single >= 0
    single[kept] = np.unique(single[kept], return_inverse=True)[1]
    return single
