"""The ``tensor`` density: the paper's own polynomial, equation (3) in s = (u, v, x, y, z, hx, hy, hz).

For a landmark m, seen at the pixel (u, v) of an upright camera at x with heading h, the fit's target is

    1 − |z (u − u*, v − v*)|² / (D r)²

with (u*, v*) where m projects to, z its depth and D its distance from the place that it is seen from: d is measured
in metres, in the plane through the landmark and parallel to the image. It is 1 where the feature was seen and falls,
through 0 at r = 60 px, to negative values where it was not; clipped to [0, 1] it is a bump (Epanechnikov's). The
target is a quadratic in (u, v) and in the position *exactly*, and z u − z u* is free of division, so that only the
heading's dependence is approximated. Weighing pixels by depth makes the peaks five to ten times more exact than the
bare |(u, v) − (u*, v*)|² does.

Locality: a density belongs to a place. Its headings are turned so that the landmark, seen from the place, lies in
the horizontal plane, on the diagonal between the x and the y axis: on the sphere a heading along an axis hardly
changes that component, and its powers are wasted; on the diagonal all of them tell. There the camera's roll is
undone, which for a pinhole is exactly a rotation of (u, v) about the principal point: so that one density serves
cameras of any roll and any intrinsics, (u, v) being on the plane z = 1, undistorted. The pixel of the same ray for
another heading (Figure 4, rotational symmetry) is a rotated copy: every sample is injected for every heading of the
layout.

Fit, equation (5): the samples' layout is a product, of nodes for each of u, v, x, y, z and of headings within a cap.
The pseudo-inverse of a product is the product of the pseudo-inverses, so that those of three small matrices fit
densities of 6561 coefficients, all of them by the same ones. Of the coefficients those with more than a total power
of two in (u, v), or in (x, y, z), come out zero and are not kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from rholoc.density.density import TARGET_RADIUS, Arrays, DensityKind, DensityRows, Sightings, Slopes
from rholoc.density.evidence import Evidence
from rholoc.density.localities import Places
from rholoc.density.polynomial import monomial_derivatives, monomials, power_factors, tensor_powers
from rholoc.geometry import BoolArray, FloatArray, IntArray, Similarity
from rholoc.lazy import lazy

DEGREES = (1, 2, 3)
HEADING_LIMIT_RAD = math.radians(50.0)
_VIEWPORT = 0.75  # half the width of the viewport on the plane z = 1
_HEADINGS = {1: 60, 2: 120, 3: 200}  # number in a degree's layout: several for each of (P + 1)³ monomials
_RIDGE = 1e-12
_ZERO = 1e-6  # of the greatest coefficient
_CHUNK = 2_000_000  # samples of as many densities are held at once
_FITTED_AT_ONCE = 256  # densities, between two reports of progress
_REACH = 2.0  # in tolerances: how far off a feature may be and still count, while one tolerance is used
_VERTICAL = 1e-9  # a heading this close to the vertical has no horizontal direction of its own
_DIAGONAL = np.array([math.sqrt(0.5), math.sqrt(0.5), 0.0])
_HEADING_SCALE = math.sin(HEADING_LIMIT_RAD)


@dataclass(frozen=True, eq=False)
class TensorDensities:
    """T densities, each local to a place.

    The coefficients are of the monomials whose powers are a row of each of the three arrays of :func:`kept_powers`;
    all others are zero. Their variables are u, v on the plane z = 1; the position relative to the place, in units of
    the radius; the heading in the density's own frame, relative to the diagonal (1, 1, 0) / √2, in units of sin 50°.

    Attributes:
        degree: P.
        coefficients: (T, U, X, H) float32.
        features: (T,) feature of each density, non-decreasing.
        landmarks: (T, 3) the features' landmarks [m].
        places: (T, 3) places from which the landmarks were seen [m].
        radii: (T,) distance from its place up to which each density is valid [m].
    """

    kind: ClassVar[DensityKind] = DensityKind.TENSOR
    has_exact_peaks: ClassVar[bool] = False
    variables: ClassVar[tuple[str, ...]] = ("u", "v", "x", "y", "z", "hx", "hy", "hz")
    degrees: ClassVar[tuple[int, ...]] = DEGREES
    domain_columns: ClassVar[tuple[str, ...]] = ("place_x", "place_y", "place_z", "radius")

    degree: int
    coefficients: FloatArray
    features: IntArray
    landmarks: FloatArray
    places: FloatArray
    radii: FloatArray

    def __len__(self) -> int:
        return len(self.coefficients)

    @lazy
    def distances(self) -> FloatArray:
        """Distances D (T,) [m] from place to landmark."""
        return np.asarray(np.linalg.norm(self.landmarks - self.places, axis=1))

    @lazy
    def directions(self) -> FloatArray:
        """Unit vectors (T, 3) from place to landmark: the middle of the headings that a density is valid for."""
        return np.asarray((self.landmarks - self.places) / self.distances[:, None])

    @lazy
    def R_local_map(self) -> FloatArray:
        """Rotations (T, 3, 3) that turn the direction into the diagonal (1, 1, 0) / √2, upright."""
        return local_frames(self.directions)

    def take(self, rows: IntArray) -> Self:
        """The densities at ``rows``, in that order."""
        each = [field.name for field in fields(self) if field.name != "degree"]
        taken = replace(self, **{name: getattr(self, name)[rows] for name in each})
        taken.__dict__["R_local_map"] = self.R_local_map[rows]
        return taken

    def near(self, evidence: Evidence, T_map_camera: FloatArray, tolerance_px: float) -> LocalTensorDensities:
        """Densities of the matches that have a valid one at a pose (4, 4) and whose landmark is near their ray.

        Near is a distance of at most √((2 × tolerance)² + (2 σ)²), with σ of the landmark and the tolerance [px] taken
        at the landmark's depth.
        """
        points = (evidence.landmarks - T_map_camera[:3, 3]) @ T_map_camera[:3, :3]
        along = np.einsum("mi,mi->m", points, evidence.rays)
        aside = np.einsum("mi,mi->m", points, points) - along**2
        reach = np.maximum(_REACH * tolerance_px / evidence.focal_px * along, 0) ** 2 + 4 * evidence.variances
        close = np.flatnonzero((along > 0) & (evidence.rays[:, 2] > 0) & (aside < reach))
        chosen, rows = self.choose(evidence.features[close], T_map_camera)
        matches = close[chosen]
        rays = evidence.rays[matches]
        return LocalTensorDensities(
            matches,
            self.take(rows),
            rays[:, :2] / rays[:, 2:],
            evidence.variances[matches],
            evidence.focal_px,
        )

    def choose(self, features: IntArray, T_map_camera: FloatArray) -> tuple[IntArray, IntArray]:
        """Choose a density valid at a pose (4, 4) for each of ``features`` (M,).

        Returns the indices (K,) in ``features`` with a valid density, and the densities' rows (K,). Of several valid
        ones, the one whose direction is nearest to the heading is chosen.
        """
        position, heading = T_map_camera[:3, 3], T_map_camera[:3, 2]
        starts = np.searchsorted(self.features, features)
        ends = np.searchsorted(self.features, features, side="right")
        best, row = np.full(len(features), -np.inf), np.full(len(features), -1)
        for step in range(int((ends - starts).max(initial=0))):
            has = np.flatnonzero(starts + step < ends)
            candidates = starts[has] + step
            fit = np.where(self.valid_at(position, heading, candidates), self.directions[candidates] @ heading, -np.inf)
            better = fit > best[has]
            best[has[better]], row[has[better]] = fit[better], candidates[better]
        chosen = np.flatnonzero(row >= 0)
        return chosen, row[chosen]

    def problem(self, features: int) -> str:
        """Reason why these cannot be the densities of a map with ``features`` features, a clause; empty if they can."""
        count = len(self.features)
        sizes = tuple(len(powers) for powers in kept_powers(self.degree))
        whole = (
            self.features.shape == self.radii.shape == (count,)
            and self.coefficients.shape == (count, *sizes)
            and self.landmarks.shape == self.places.shape == (count, 3)
            and all(bool(np.isfinite(array).all()) for array in (self.coefficients, self.places, self.radii))
            and bool(np.all((self.features >= 0) & (self.features < features)))
            and bool(np.all(np.diff(self.features) >= 0) and np.all(self.radii > 0))
        )
        if not whole:
            return "its densities do not fit together"
        return "" if bool(np.all(self.distances > 0)) else "a density's place is its landmark"

    def rows(self, sightings: Sightings, variances: FloatArray) -> DensityRows:
        """All densities as rows with the domain x, y, z of the place and the radius [m]; the arguments are not used."""
        return DensityRows(self.features, np.column_stack([self.places, self.radii]).astype(np.float32))

    def coefficients_of(self, row: int, landmark: FloatArray, domain: FloatArray) -> FloatArray:
        """All (P + 1)⁸ coefficients of the density at ``row``, in Table 5's order; the other arguments are not used."""
        return np.asarray(self.all_coefficients(np.array([row]))[0])

    @classmethod
    def kept_coefficients(
        cls, coefficients: FloatArray, degree: int, landmark: FloatArray, domain: FloatArray
    ) -> FloatArray:
        """Coefficients (U · X · H,) float32 of the stored monomials (:func:`kept_powers`).

        Raises:
            ValueError: another coefficient is not zero.
        """
        columns = coefficient_columns(degree)
        rest = np.delete(coefficients, columns)
        if np.abs(rest).max(initial=0) > _ZERO * np.abs(coefficients).max():
            raise ValueError("has powers beyond a square in (u, v) or in (x, y, z), which no fit gives")
        return coefficients[columns].astype(np.float32)

    @classmethod
    def from_rows(
        cls, degree: int, rows: DensityRows, landmarks: FloatArray, kept: Sequence[FloatArray]
    ) -> TensorDensities:
        """The densities at their places.

        Raises:
            ValueError: a radius is not positive, or a place is its landmark.
        """
        domain = rows.domain.astype(np.float64)
        sizes = [len(powers) for powers in kept_powers(degree)]
        of_each = landmarks[rows.features].astype(np.float64)
        if np.any(domain[:, 3] <= 0):
            raise ValueError("has a radius that is not positive")
        if not np.all(np.linalg.norm(of_each - domain[:, :3], axis=1) > 0):
            raise ValueError("has a place that is its landmark")
        coefficients = np.array(kept).reshape(-1, *sizes)
        return cls(degree, coefficients, rows.features, of_each, domain[:, :3], domain[:, 3])

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays that a map's file stores beside the landmarks, by name."""
        return {
            "degree": np.array(self.degree, dtype=np.int32),
            "coefficients": self.coefficients.astype(np.float32),
            "features": self.features.astype(np.int32),
            "places": self.places.astype(np.float32),
            "radii": self.radii.astype(np.float32),
        }

    @classmethod
    def from_arrays(cls, arrays: Arrays, landmarks: FloatArray) -> TensorDensities:
        """Densities from the result of :meth:`arrays` and a map's landmarks (F, 3).

        Raises:
            ValueError: an array is missing, or contradicts another; says which.
        """
        missing = [name for name in _ARRAYS if name not in arrays]
        if missing:
            raise ValueError(f"it has no {', '.join(f'{cls.kind}_{name}' for name in missing)}")
        for name, (kind, dimensions) in _ARRAYS.items():
            if arrays[name].dtype != np.dtype(kind) or arrays[name].ndim != dimensions:
                raise ValueError(f"{cls.kind}_{name} is not of the right type and shape")
        degree, coefficients, features, places, radii = (arrays[name] for name in _ARRAYS)
        if int(degree) not in DEGREES:
            raise ValueError("its densities have an impossible degree")
        if not np.all((features >= 0) & (features < len(landmarks))):
            raise ValueError("a density is of a feature that is not there")
        return cls(
            int(degree),
            coefficients,
            features.astype(np.int64),
            landmarks[features].astype(np.float64),
            places.astype(np.float64),
            radii.astype(np.float64),
        )

    def moved(self, similarity: Similarity) -> TensorDensities:
        """The same densities in the target frame of ``similarity``.

        Fitted anew if it rotates, because the polynomials' positions are along the map's axes.
        """
        landmarks, places = similarity.points(self.landmarks), similarity.points(self.places)
        radii, coefficients = similarity.scale * self.radii, self.coefficients
        if not np.array_equal(similarity.rotation, np.eye(3)):
            coefficients = fit_tensors(landmarks, places, radii, self.degree).coefficients
        return replace(self, landmarks=landmarks, places=places, radii=radii, coefficients=coefficients)

    @classmethod
    def fit(cls, sightings: Sightings, degree: int, progress: Callable[[float, str], None]) -> TensorDensities:
        """Fit one density for each place that a feature was seen from, to the landmark rather than the observations.

        The fit uses the places and radii as rounded for files, so that a stored map equals the fitted one.
        """
        places = Places.of(sightings)
        landmarks, count = sightings.landmarks[places.features], len(places.features)
        parts = []
        for start in range(0, max(count, 1), _FITTED_AT_ONCE):
            rows = slice(start, start + _FITTED_AT_ONCE)
            fitted = fit_tensors(landmarks[rows], places.positions[rows], places.radii[rows], degree)
            parts.append(fitted.coefficients)
            progress(min(1.0, (start + _FITTED_AT_ONCE) / max(count, 1)), f"{count} densities")
        return cls(degree, np.concatenate(parts), places.features, landmarks, places.positions, places.radii)

    def target_radii(self, distances: FloatArray) -> FloatArray:
        """Radii (T,) [m] at which the fit's target is 0: 60 px at the landmarks' distances from the places.

        ``distances`` (T,) are not used.
        """
        return np.asarray(TARGET_RADIUS * self.distances)

    def valid_at(self, position: FloatArray, heading: FloatArray, rows: IntArray) -> BoolArray:
        """Mask (N,) of the densities in ``rows`` (N,) that are valid at a position (3,), within the radius, and heading
        (3,), within 50°.
        """
        near = np.linalg.norm(position - self.places[rows], axis=1) <= self.radii[rows]
        return np.asarray(near & (self.directions[rows] @ heading >= math.cos(HEADING_LIMIT_RAD)))

    def all_coefficients(self, rows: IntArray) -> FloatArray:
        """All coefficients (N, (P + 1)⁸) float32 of the densities in ``rows`` (N,), in Table 5's order, with zeros."""
        full = np.zeros((len(rows), (self.degree + 1) ** len(self.variables)), dtype=np.float32)
        full[:, coefficient_columns(self.degree)] = self.coefficients[rows].reshape(len(rows), -1)
        return full

    def at(self, plane: FloatArray, T_map_camera: FloatArray) -> Peaks:
        """Evaluate each density at its own pixel ``plane`` (T, 2), on the plane z = 1, of a camera at a pose (4, 4)."""
        return _peaks(self, LocalVariables.of(self, plane, T_map_camera))


_ARRAYS = {  # of a file: type and number of dimensions
    "degree": (np.int32, 0),
    "coefficients": (np.float32, 4),
    "features": (np.int32, 1),
    "places": (np.float32, 2),
    "radii": (np.float32, 1),
}


@dataclass(frozen=True, eq=False)
class LocalTensorDensities:
    """The densities of the matches that have a valid one around a pose.

    A fitted polynomial has errors, in the height of its bump more than in its position: at a given pose its peak over
    (u, v) is not exactly 1. The feature is at some pixel, so ρ is relative to that peak:

        ρ_f = max(0, 1 − (max_{u,v} q_f − q_f) / t)

    where q_f is the polynomial and t the fall that the tolerance allows. Both are equation (3)'s values and the
    gradients are equation (4)'s, of first and mixed order. The landmark's position only sets how wide the tolerance is
    in metres, and saves evaluating the features whose bump is far away.

    Attributes:
        matches: (K,) rows of the matches in the evidence.
        densities: K densities.
        plane: (K, 2) pixels of the matches on the plane z = 1.
        variances: (K,) variances of the landmarks [m²].
        focal_px: focal length of the camera.
    """

    matches: IntArray
    densities: TensorDensities
    plane: FloatArray
    variances: FloatArray
    focal_px: float

    def at(self, T_map_camera: FloatArray, tolerance_px: float) -> Slopes:
        """ρ and its slopes at a pose (4, 4), d being the fall from the peak in units of t."""
        peaks = self.densities.at(self.plane, T_map_camera)
        distance = np.linalg.norm(self.densities.landmarks - T_map_camera[:3, 3], axis=1)
        allowed_m2 = (tolerance_px / self.focal_px * distance) ** 2 + self.variances
        allowed = allowed_m2 / self.densities.target_radii(distance) ** 2
        density = np.where(peaks.peaked, np.maximum(1 - peaks.drop / allowed, 0), 0)
        inside = np.flatnonzero(density > 0)
        allowed = allowed[inside]
        roots = _roots(peaks.fall[inside]) @ peaks.offset_jacobian[inside] / np.sqrt(allowed)[:, None, None]
        return Slopes(density, inside, peaks.drop_gradient[inside] / allowed[:, None], roots)


def _roots(F: FloatArray) -> FloatArray:
    """Upper triangles U (I, 2, 2) of the Cholesky factors of F (I, 2, 2): F = Uᵀ U."""
    roots = np.zeros_like(F)
    roots[:, 0, 0] = np.sqrt(F[:, 0, 0])
    roots[:, 0, 1] = F[:, 0, 1] / roots[:, 0, 0]
    roots[:, 1, 1] = np.sqrt(np.maximum(F[:, 1, 1] - roots[:, 0, 1] ** 2, 0))
    return roots


@dataclass(frozen=True, eq=False)
class Peaks:
    """T densities at one pose, each at its pixel, as functions of a small motion of the camera.

    A motion is (position in metres, rotation in radians from the left), both in the map frame.

    Attributes:
        value: (T,) the polynomial, not clipped.
        gradient: (T, 6) by the motion, equation (4).
        offset: (T, 2) of the pixel from the polynomial's peak over (u, v) at this pose, on the plane z = 1.
        offset_jacobian: (T, 2, 6) by the motion.
        fall: (T, 2, 2) F: the polynomial falls from its peak by offsetᵀ F offset.
        drop: (T,) peak − value.
        drop_gradient: (T, 6) gradient of ``drop`` by the motion.
        peaked: (T,) whether the polynomial has a peak over (u, v).
    """

    value: FloatArray
    gradient: FloatArray
    offset: FloatArray
    offset_jacobian: FloatArray
    fall: FloatArray
    drop: FloatArray
    drop_gradient: FloatArray
    peaked: BoolArray


@cache
def kept_powers(degree: int) -> tuple[IntArray, IntArray, IntArray]:
    """The powers (U, 2) of (u, v), (X, 3) of the position and (H, 3) of the heading that coefficients are kept for."""
    plane, position = tensor_powers(2, degree), tensor_powers(3, degree)
    return plane[plane.sum(axis=1) <= 2], position[position.sum(axis=1) <= 2], tensor_powers(3, degree)


@cache
def coefficient_columns(degree: int) -> IntArray:
    """Columns of the stored coefficients (U, X, H), flattened, among all (P + 1)⁸ in the order of Table 5."""
    digits = [powers @ (degree + 1) ** np.arange(powers.shape[1])[::-1] for powers in kept_powers(degree)]
    base = (degree + 1) ** 3
    return np.asarray((digits[0][:, None, None] * base + digits[1][:, None]) * base + digits[2]).ravel()


def local_frames(directions: FloatArray) -> FloatArray:
    """R_local_map (T, 3, 3) that takes each unit direction (T, 3) to (1, 1, 0) / √2 and keeps the horizontal level."""
    c = math.sqrt(0.5)
    turn = np.array([[c, -c, 0], [c, c, 0], [0, 0, 1]])
    right, down, ahead = np.moveaxis(upright_axes(directions), -2, 0)
    ahead_left_up = np.stack([ahead, -right, -down], axis=1)
    return np.asarray(turn @ ahead_left_up)


def scaled_heading(headings: FloatArray) -> FloatArray:
    """Variables (..., 3) of unit headings (..., 3) in the density's frame: offset from (1, 1, 0) / √2 over sin 50°."""
    return np.asarray((headings - _DIAGONAL) / _HEADING_SCALE)


def fit_tensors(landmarks: FloatArray, places: FloatArray, radii: FloatArray, degree: int) -> TensorDensities:
    """Least-squares fits of equation (3) to equation (5), for landmarks (T, 3) seen from places (T, 3).

    Each landmark counts as a feature of its own.

    Args:
        landmarks: (T, 3) metres.
        places: (T, 3) metres.
        radii: (T,) metres, how far around its place each is to be valid.
        degree: P, one of 1, 2 and 3. With 1 a density has no peak: it is linear in u and in v.
    """
    layout = Layout.of(degree)
    distances = np.linalg.norm(landmarks - places, axis=1)
    frames = local_frames((landmarks - places) / distances[:, None])
    step = max(1, _CHUNK // layout.samples)
    fitted = [
        layout.fit(frames[i : i + step], (landmarks - places)[i : i + step], radii[i : i + step])
        for i in range(0, len(landmarks), step)
    ]
    sizes = [len(powers) for powers in kept_powers(degree)]
    coefficients = np.concatenate(fitted) if fitted else np.zeros((0, *sizes), dtype=np.float32)
    return TensorDensities(degree, coefficients, np.arange(len(landmarks)), landmarks, places, radii)


@dataclass(frozen=True, eq=False)
class Layout:
    """The samples that all densities of a degree are fitted with, and the pseudo-inverses that fit them.

    Attributes:
        plane: (A, 2) nodes of (u, v).
        position: (B, 3) nodes of the position, in units of the radius.
        axes: (C, 3, 3) upright cameras' x, y and z axis (rows) in the density's frame.
        of_plane: (U, A), of_position (X, B), of_heading (H, C): from samples to coefficients.
    """

    plane: FloatArray
    position: FloatArray
    axes: FloatArray
    of_plane: FloatArray
    of_position: FloatArray
    of_heading: FloatArray

    @classmethod
    def of(cls, degree: int) -> Layout:
        """Layout for densities of this degree, 1 to 3."""
        nodes = max(degree + 1, 3)  # the target is a quadratic: fewer would not determine it
        line = np.cos((np.arange(nodes) + 0.5) * np.pi / nodes)
        plane = _VIEWPORT * _grid(line, 2)
        position = _grid(line, 3)
        headings = _cap(_HEADINGS[degree])
        every = [tensor_powers(2, degree), tensor_powers(3, degree), tensor_powers(3, degree)]
        samples = [plane, position, scaled_heading(headings)]
        inverses = []
        for powers, kept, points in zip(every, kept_powers(degree), samples, strict=True):
            solved = np.linalg.pinv(monomials(powers, points), rcond=math.sqrt(_RIDGE))
            rows = np.flatnonzero((powers[:, None] == kept).all(axis=2).any(axis=1))
            inverses.append(solved[rows])
        return cls(plane, position, upright_axes(headings), *inverses)

    @property
    def samples(self) -> int:
        """Number of samples that a density is fitted to."""
        return len(self.plane) * len(self.position) * len(self.axes)

    def fit(self, R_local_map: FloatArray, to_landmark: FloatArray, radii: FloatArray) -> FloatArray:
        """Coefficients (t, U, X, H) float32 of landmarks ``to_landmark`` (t, 3) from their places, with frames (t, 3,
        3) and radii (t,).
        """
        distances = np.linalg.norm(to_landmark, axis=1)
        offsets = to_landmark[:, None] - radii[:, None, None] * self.position  # (t, B, 3), map frame
        local = np.einsum("tij,tbj->tbi", R_local_map, offsets)
        along = np.einsum("tbi,cki->ktbc", local, self.axes)  # x, y, z (3, t, B, C) of the landmark in each camera
        x, y, z = along[:, :, None]  # (t, 1, B, C)
        u, v = self.plane.T[:, :, None, None]
        scale = (distances * TARGET_RADIUS)[:, None, None, None]
        target = 1 - ((z * u - x) ** 2 + (z * v - y) ** 2) / scale**2  # (t, A, B, C)
        fitted = target @ self.of_heading.T
        fitted = self.of_position @ fitted
        return np.asarray(np.einsum("ua,taxh->tuxh", self.of_plane, fitted), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class LocalVariables:
    """The variables of T densities at one pose, and how they change with a motion of the camera.

    Attributes:
        plane: (T, 2) u, v with the roll undone.
        position: (T, 3).
        heading: (T, 3).
        plane_jacobian: (T, 2, 6).
        position_jacobian: (T, 3, 6).
        heading_jacobian: (T, 3, 6).
    """

    plane: FloatArray
    position: FloatArray
    heading: FloatArray
    plane_jacobian: FloatArray
    position_jacobian: FloatArray
    heading_jacobian: FloatArray

    @classmethod
    def of(cls, densities: TensorDensities, plane: FloatArray, T_map_camera: FloatArray) -> LocalVariables:
        """At a pose (4, 4), for the observed points ``plane`` (T, 2) of the image plane z = 1."""
        frames, R, position = densities.R_local_map, T_map_camera[:3, :3], T_map_camera[:3, 3]
        camera_x, heading = frames @ R[:, 0], frames @ R[:, 2]
        axes = upright_axes(heading)
        cos_roll = np.einsum("ti,ti->t", axes[:, 0], camera_x)
        sin_roll = np.einsum("ti,ti->t", axes[:, 1], camera_x)
        u = cos_roll * plane[:, 0] - sin_roll * plane[:, 1]
        v = sin_roll * plane[:, 0] + cos_roll * plane[:, 1]
        count = len(plane)
        plane_jacobian = np.zeros((count, 2, 6))
        position_jacobian = np.zeros((count, 3, 6))
        heading_jacobian = np.zeros((count, 3, 6))
        position_jacobian[:, :, :3] = np.eye(3) / densities.radii[:, None, None]
        x, y, z = R[:, 2]
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        heading_jacobian[:, :, 3:] = -frames @ cross / _HEADING_SCALE
        # a rotation ω rolls the camera, against the upright one with the same heading, by (ωx hx + ωy hy) / (hx² + hy²)
        horizontal = np.maximum(heading[:, 0] ** 2 + heading[:, 1] ** 2, 1e-9)
        rolled = np.einsum("ti,tij->tj", heading[:, :2] / horizontal[:, None], frames[:, :2])
        plane_jacobian[:, 0, 3:] = -v[:, None] * rolled
        plane_jacobian[:, 1, 3:] = u[:, None] * rolled
        return cls(
            np.column_stack([u, v]),
            (position - densities.places) / densities.radii[:, None],
            scaled_heading(heading),
            plane_jacobian,
            position_jacobian,
            heading_jacobian,
        )


def upright_axes(headings: FloatArray) -> FloatArray:
    """The x, y and z axis (..., 3, 3), as rows, of upright cameras with unit ``headings`` (..., 3).

    As :func:`rholoc.geometry.rotation_from_heading`'s columns, for many headings at once.
    """
    x, y, z = headings[..., 0], headings[..., 1], headings[..., 2]
    n = np.hypot(x, y)
    vertical, n = n < _VERTICAL, np.maximum(n, _VERTICAL)
    right_x, right_y = np.where(vertical, 1.0, y / n), np.where(vertical, 0.0, -x / n)
    right = np.stack([right_x, right_y, np.zeros_like(z)], axis=-1)
    down = np.stack([-z * right_y, z * right_x, x * right_y - y * right_x], axis=-1)
    return np.stack([right, down, headings], axis=-2)


def _peaks(densities: TensorDensities, local: LocalVariables) -> Peaks:
    """The peaks of T densities over the image plane, and their derivatives by the motion."""
    plane_powers, position_powers, heading_powers = kept_powers(densities.degree)
    count, (u_, x_, h_) = len(densities), densities.coefficients.shape[1:]
    precision = densities.coefficients.dtype
    by_heading = monomial_derivatives(heading_powers, local.heading).astype(precision)  # (T, H, 4)
    by_position = monomial_derivatives(position_powers, local.position).astype(precision)  # (T, X, 4)
    by_plane = _plane_derivatives(plane_powers, local.plane)  # (T, 6, U)
    # the GEMM: every coefficient once, for the values and the derivatives by the heading
    turned = (densities.coefficients.reshape(count, u_ * x_, h_) @ by_heading).reshape(count, u_, x_, 4)
    moved = turned[..., 0] @ by_position  # (T, U, 4): value and derivatives by the position
    turned = np.einsum("tuxk,tx->tuk", turned[..., 1:], by_position[..., 0])
    both = by_plane @ np.concatenate([moved, turned], axis=2)  # (T, 6, 7): 1, u, v, uu, uv, vv by 1, position, heading
    motion = np.concatenate([local.position_jacobian, local.heading_jacobian], axis=1)  # (T, 6, 6)
    by_motion = both[:, :, 1:] @ motion  # (T, 6, 6), (u, v) held
    slope, slope_by_motion = both[:, 1:3, 0], by_motion[:, 1:3]
    hessian = both[:, [3, 4, 4, 5], 0].reshape(-1, 2, 2)
    hessian_by_motion = by_motion[:, [3, 4, 4, 5]].reshape(-1, 2, 2, 6)
    determinant = hessian[:, 0, 0] * hessian[:, 1, 1] - hessian[:, 0, 1] ** 2
    peaked = (hessian[:, 0, 0] < 0) & (determinant > 0)
    safe = np.where(peaked[:, None, None], hessian, -np.eye(2))
    adjugate = safe[:, ::-1, ::-1] * np.array([[1, -1], [-1, 1]])
    inverse = adjugate / np.where(peaked, determinant, 1.0)[:, None, None]
    slope_by_motion = slope_by_motion + hessian @ local.plane_jacobian
    offset = (inverse @ slope[..., None])[..., 0]
    curved = np.einsum("tijp,tj->tip", hessian_by_motion, offset)
    return Peaks(
        value=both[:, 0, 0],
        gradient=by_motion[:, 0] + np.einsum("ti,tip->tp", slope, local.plane_jacobian),
        offset=offset,
        offset_jacobian=inverse @ (slope_by_motion - curved),
        fall=-safe / 2,
        drop=-np.einsum("ti,ti->t", offset, slope) / 2,
        drop_gradient=-np.einsum("ti,tip->tp", offset, slope_by_motion) + np.einsum("ti,tip->tp", offset, curved) / 2,
        peaked=peaked,
    )


def _plane_derivatives(powers: IntArray, plane: FloatArray) -> FloatArray:
    """(T, 6, U): monomials of (u, v) and their derivatives by u, v, uu, uv and vv at ``plane`` (T, 2)."""
    u, v = zip(*(power_factors(powers, plane, order) for order in range(3)), strict=True)
    orders = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
    return np.stack([u[i] * v[j] for i, j in orders], axis=1)


def _grid(line: FloatArray, dimensions: int) -> FloatArray:
    """Grid points (L^d, d) with d = ``dimensions`` coordinates from ``line`` (L,), the last one varying fastest."""
    return np.stack(np.meshgrid(*[line] * dimensions, indexing="ij"), axis=-1).reshape(-1, dimensions)


def _cap(count: int) -> FloatArray:
    """Headings (count, 3) spread evenly over the cap of 50° about the diagonal, on a sunflower's spiral."""
    i = np.arange(count)
    ahead = 1 - (1 - math.cos(HEADING_LIMIT_RAD)) * (i + 0.5) / count
    turn = np.pi * (3 - math.sqrt(5)) * i
    side = np.sqrt(1 - ahead**2)
    across = np.stack([[-_DIAGONAL[1], _DIAGONAL[0], 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(ahead[:, None] * _DIAGONAL + (side * np.array([np.cos(turn), np.sin(turn)])).T @ across)
