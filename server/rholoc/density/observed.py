"""The ``observed`` density: equation (3) fitted by the loss (5) to the observations themselves, without landmarks.

    L_f = Σ_i |N_f ρ_f(s_i) w − n(s_i)|²                                                             (5)

over N_f points s_i = (u, v, x, h), n(s) being how many observations lie in the small volume w around s. What is fitted
is q = N_f w ρ, a polynomial of the form (3) with values n; N_f and w only scale it.

As printed, with points where the feature *was* seen, the loss hardly constrains the density: if the observations lie
further apart than w is wide, n is 1 at all of them, and a constant has zero loss. No term of the sum states where the
feature was *not* seen, so the fit has no peak.

But an observation implies that, too: the feature was seen at this pixel, hence at no other. :func:`fit_observed`
therefore sums over all pixels of the view, counting an observation fully at its pixel and less with distance,

    n(u, v) = 1 − |z (u − u_i, v − v_i)|² / r²,    z = b · h,    r = 60 px,

which falls through 0 at r, to negative values where the feature was not, and is a quadratic itself: (3) with P = 2 fits
it without bias. The factor z, the component of the bearing b along the heading, avoids a division. Every observation is
injected for every heading of the layout (rotational symmetry, Figure 4).

Pixels and headings are the same for all observations; only the positions are those of the walk. The samples are a
product, and so is their pseudo-inverse. An observation is a rank-one update of a matrix as small as the position has
monomials (:mod:`rholoc.density.recursive_least_squares`): coefficients can be estimated as observations
arrive.

Such a fit determines the dependence on the position only along the walk: there the peaks lie within a pixel of the
feature. A step aside, no observation constrains how the feature's pixel changes, and the polynomial keeps it in place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rholoc.density.density import TARGET_RADIUS, Arrays, DensityKind, DensityRows, Sightings
from rholoc.density.localities import Places
from rholoc.density.polynomial import monomials
from rholoc.density.recursive_least_squares import RecursiveFit
from rholoc.density.tensor import (
    Layout,
    TensorDensities,
    kept_powers,
    local_frames,
    scaled_heading,
    upright_axes,
)
from rholoc.geometry import FloatArray, IntArray, Similarity
from rholoc.lazy import lazy

RIDGE = 1e-4  # of the coefficients, against observations that count 1 each
_CHUNK = 256  # densities, between two reports of progress


@dataclass(frozen=True, eq=False)
class ObservedDensities(TensorDensities):
    """T densities, each local to a place, of the form that :class:`TensorDensities` describes.

    Attributes:
        middles: (T, 3) unit vectors: mean bearing of the feature from the place, map frame.
        moments: (T, X, X) Σ φ φᵀ over the observations + ridge, with φ the position's monomials.
        counts: (T,) number of observations that each density was fitted to.
    """

    kind: ClassVar[DensityKind] = DensityKind.OBSERVED
    domain_columns: ClassVar[tuple[str, ...]] = (
        *TensorDensities.domain_columns,
        *("direction_x", "direction_y", "direction_z", "observations"),
    )

    middles: FloatArray
    moments: FloatArray
    counts: IntArray

    @lazy
    def directions(self) -> FloatArray:
        """Unit vectors (T, 3), the same as ``middles``: an ``observed`` density does not know its landmark."""
        return self.middles

    def target_radii(self, distances: FloatArray) -> FloatArray:
        """Radii (T,) [m] at which the fit's target is 0, for cameras at ``distances`` (T,): a fixed angle."""
        return np.asarray(TARGET_RADIUS * distances)

    def problem(self, features: int) -> str:
        """Reason why these cannot be the densities of a map with ``features`` features, a clause; empty if they can."""
        count, size = len(self.features), len(kept_powers(self.degree)[1])
        whole = (
            self.middles.shape == (count, 3)
            and self.moments.shape == (count, size, size)
            and self.counts.shape == (count,)
            and bool(np.isfinite(self.middles).all() and np.isfinite(self.moments).all() and np.all(self.counts >= 0))
            and bool(np.all(np.abs(np.linalg.norm(self.middles, axis=1) - 1) < 1e-3))
        )
        return super().problem(features) if whole else "its densities do not fit together"

    def rows(self, sightings: Sightings, variances: FloatArray) -> DensityRows:
        """All densities as rows; the domain is place, radius [m], mean bearing and number of observations.

        The arguments are not used.
        """
        domain = np.column_stack([self.places, self.radii, self.middles, self.counts])
        return DensityRows(self.features, domain.astype(np.float32))

    @classmethod
    def from_rows(
        cls, degree: int, rows: DensityRows, landmarks: FloatArray, kept: Sequence[FloatArray]
    ) -> ObservedDensities:
        """The densities at their places. Table 5 keeps no moments: such densities learn as if they were new.

        Raises:
            ValueError: a radius is not positive, a place is its landmark, or a direction not a unit vector.
        """
        whole = TensorDensities.from_rows(degree, rows, landmarks, kept)
        domain = rows.domain.astype(np.float64)
        if not np.all(np.abs(np.linalg.norm(domain[:, 4:7], axis=1) - 1) < 1e-3):
            raise ValueError("has a direction that is not a unit vector")
        size = len(kept_powers(degree)[1])
        moments = np.tile(RIDGE * np.eye(size), (len(domain), 1, 1))
        counts = np.round(domain[:, 7]).astype(np.int64)
        return cls(**vars(whole), middles=_unit(domain[:, 4:7]), moments=moments, counts=counts)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays that a map's file stores beside the landmarks, by name."""
        upper = np.triu_indices(self.moments.shape[1])
        return super().arrays() | {
            "directions": self.middles.astype(np.float32),
            "moments": self.moments[:, upper[0], upper[1]].astype(np.float64),
            "counts": self.counts.astype(np.int32),
        }

    @classmethod
    def from_arrays(cls, arrays: Arrays, landmarks: FloatArray) -> ObservedDensities:
        """Densities from the result of :meth:`arrays` and a map's landmarks (F, 3).

        Raises:
            ValueError: an array is missing, or contradicts another; says which.
        """
        whole = TensorDensities.from_arrays(arrays, landmarks)
        missing = [name for name in _ARRAYS if name not in arrays]
        if missing:
            raise ValueError(f"it has no {', '.join(f'observed_{name}' for name in missing)}")
        size = len(kept_powers(whole.degree)[1])
        upper = np.triu_indices(size)
        count = len(whole)
        for name, (kind, length) in (_ARRAYS | {"moments": (np.float64, len(upper[0]))}).items():
            shape = (count, length) if length else (count,)
            if arrays[name].dtype != np.dtype(kind) or arrays[name].shape != shape:
                raise ValueError(f"observed_{name} is not of the right type and shape")
        moments = np.zeros((count, size, size))
        moments[:, upper[0], upper[1]] = arrays["moments"]
        moments[:, upper[1], upper[0]] = arrays["moments"]
        middles, counts = arrays["directions"].astype(np.float64), arrays["counts"].astype(np.int64)
        return cls(**vars(whole), middles=middles, moments=moments, counts=counts)

    def moved(self, similarity: Similarity) -> ObservedDensities:
        """The same densities in the target frame of ``similarity``, fitted to their own values if it rotates.

        Exact for a rotation about z. A tilt changes the roll of upright cameras; the fit is then an approximation.
        """
        moved = replace(
            self,
            landmarks=similarity.points(self.landmarks),
            places=similarity.points(self.places),
            radii=similarity.scale * self.radii,
            middles=self.middles @ similarity.rotation.T,
        )
        if np.array_equal(similarity.rotation, np.eye(3)):
            return moved
        layout, R = layout_of(self.degree), similarity.rotation
        powers = kept_powers(self.degree)[1]
        before = monomials(powers, layout.position @ R)  # of the same positions, along the axes before
        turn = np.linalg.lstsq(monomials(powers, layout.position), before, rcond=None)[0]  # φ_before = φ turn
        back = np.linalg.inv(turn) if np.linalg.matrix_rank(turn) == len(powers) else np.linalg.pinv(turn)
        coefficients = np.empty_like(self.coefficients)
        for t in range(len(self)):
            values = self._samples(t, R.T @ moved.R_local_map[t].T, before)
            by_heading = np.einsum("abc,hc->abh", values, layout.of_heading)
            coefficients[t] = np.einsum("ua,xb,abh->uxh", layout.of_plane, layout.of_position, by_heading)
        return replace(moved, coefficients=coefficients, moments=np.swapaxes(back, 0, 1) @ self.moments @ back)

    def _samples(self, density: int, R_map_other: FloatArray, of_position: FloatArray) -> FloatArray:
        """Values (A, B, C) of density ``density`` at the layout's samples of another local frame.

        ``R_map_other`` (3, 3) takes that frame to the map frame; ``of_position`` (B, X) are the positions' monomials.
        """
        layout = layout_of(self.degree)
        plane_powers, _, heading_powers = kept_powers(self.degree)
        axes = layout.axes @ R_map_other.T @ self.R_local_map[density].T  # rows: the cameras' axes in this frame
        upright = upright_axes(axes[:, 2])
        cos_roll = np.einsum("ci,ci->c", upright[:, 0], axes[:, 0])
        sin_roll = np.einsum("ci,ci->c", upright[:, 1], axes[:, 0])
        u, v = layout.plane.T[:, :, None]
        plane = np.stack([cos_roll * u - sin_roll * v, sin_roll * u + cos_roll * v], axis=-1)  # (A, C, 2)
        of_heading = monomials(heading_powers, scaled_heading(axes[:, 2]))
        turned = np.einsum("uxh,ch->uxc", self.coefficients[density].astype(np.float64), of_heading)
        placed = np.einsum("bx,uxc->ubc", of_position, turned)
        return np.asarray(np.einsum("acu,ubc->abc", monomials(plane_powers, plane), placed))

    @classmethod
    def fit(cls, sightings: Sightings, degree: int, progress: Callable[[float, str], None]) -> ObservedDensities:
        """Fit one density for each place that a feature was seen from.

        Raises:
            ValueError: the bearings at which the features were seen were not kept.
        """
        return fit_observed(sightings, degree, progress)

    def learned(self, density: int, bearings: FloatArray, positions: FloatArray, forgetting: float) -> RecursiveFit:
        """One density's fit after further observations, one at a time.

        Args:
            density: its row.
            bearings: (N, 3) unit vectors in the map frame, in the order of time.
            positions: (N, 3) positions of the cameras [m].
            forgetting: factor 0 to 1 on the weight of all earlier observations at each new one; 1 forgets nothing.
        """
        size = self.coefficients.shape[2]
        of_position = self.coefficients[density].transpose(1, 0, 2).reshape(size, -1)
        fit = RecursiveFit(of_position.astype(np.float64), np.linalg.inv(self.moments[density]))
        values = observation_coefficients(bearings @ self.R_local_map[density].T, self.degree)
        factors = self.position_monomials(density, positions)
        for phi, value in zip(factors, values, strict=True):
            fit = fit.observe(phi, value, forgetting)
        return fit

    def position_monomials(self, density: int, positions: FloatArray) -> FloatArray:
        """Monomials φ (N, X) of map positions (N, 3) [m], relative to a density's place in units of its radius."""
        return monomials(kept_powers(self.degree)[1], (positions - self.places[density]) / self.radii[density])

    def with_fit(self, density: int, fit: RecursiveFit, observations: int) -> tuple[FloatArray, FloatArray, int]:
        """The coefficients (U, X, H), moments (X, X) and count of a density after a fit of further ``observations``."""
        u, x, h = self.coefficients.shape[1:]
        return (
            fit.coefficients.reshape(x, u, h).transpose(1, 0, 2),
            np.linalg.inv(fit.covariance),
            int(self.counts[density]) + observations,
        )


_ARRAYS: dict[str, tuple[type, int]] = {  # of a file, beside those of a tensor: type, and how many a density
    "directions": (np.float32, 3),
    "moments": (np.float64, 0),
    "counts": (np.int32, 0),
}


def fit_observed(
    sightings: Sightings, degree: int, progress: Callable[[float, str], None] = lambda done, text: None
) -> ObservedDensities:
    """Densities that minimize the loss (5) over all pixels of the views that saw a feature, one per feature and place.

    Raises:
        ValueError: the bearings at which the features were seen were not kept.
    """

    def fit(local: FloatArray, s: FloatArray, radius_m: float) -> tuple[FloatArray, FloatArray]:
        phi = monomials(kept_powers(degree)[1], s)
        moments = phi.T @ phi + RIDGE * np.eye(phi.shape[1])
        return np.linalg.solve(moments, phi.T @ observation_coefficients(local, degree)), moments

    return fitted_by_place(sightings, degree, fit, progress)


def fitted_by_place(
    sightings: Sightings,
    degree: int,
    fit: Callable[[FloatArray, FloatArray, float], tuple[FloatArray, FloatArray]],
    progress: Callable[[float, str], None],
) -> ObservedDensities:
    """Fit a density for each place with ``fit``, to places and radii as rounded for files.

    ``fit`` takes bearings (n, 3) in the density's frame, positions (n, 3) relative to the place in radii, and the
    radius [m], and returns coefficients (X, U H) and moments (X, X). Raises ValueError without bearings.
    """
    if sightings.bearings is None:
        raise ValueError("the bearings at which the features were seen were not kept")
    places = Places.of(sightings)
    count, sizes = len(places.features), [len(powers) for powers in kept_powers(degree)]
    u, x, h = sizes
    coefficients = np.zeros((count, *sizes), dtype=np.float32)
    moments = np.zeros((count, x, x))
    middles = np.array([sightings.bearings[rows].mean(axis=0) for rows in places.members]).reshape(-1, 3)
    middles = _unit(middles).astype(np.float32).astype(np.float64)
    frames = local_frames(middles)
    for t, rows in enumerate(places.members):
        s = (sightings.positions[rows] - places.positions[t]) / places.radii[t]
        fitted, moments[t] = fit(sightings.bearings[rows] @ frames[t].T, s, float(places.radii[t]))
        coefficients[t] = fitted.reshape(x, u, h).transpose(1, 0, 2)
        if t % _CHUNK == 0:
            progress(t / count, f"{count} densities")
    progress(1.0, f"{count} densities")
    return ObservedDensities(
        degree,
        coefficients,
        places.features,
        sightings.landmarks[places.features],
        places.positions,
        places.radii,
        middles,
        moments,
        np.array([len(rows) for rows in places.members], dtype=np.int64),
    )


def observation_coefficients(bearings: FloatArray, degree: int) -> FloatArray:
    """Contribution of each observation in (u, v) and the heading: coefficients (N, U H) of n(u, v, h).

    Args:
        bearings: (N, 3) unit vectors in the density's frame.
        degree: P.
    """
    layout = layout_of(degree)
    target = sample_counts(bearings, degree)
    return np.asarray(np.einsum("ua,anc,hc->nuh", layout.of_plane, target, layout.of_heading, optimize=True)).reshape(
        len(bearings), -1
    )


def sample_counts(bearings: FloatArray, degree: int) -> FloatArray:
    """n (A, N, C) at the A pixels and C headings of the layout, for observations at bearings (N, 3), local frame."""
    layout = layout_of(degree)
    x, y, z = np.einsum("ni,cki->knc", bearings, layout.axes)[:, None]
    u, v = layout.plane.T[:, :, None, None]
    return np.asarray(1 - ((z * u - x) ** 2 + (z * v - y) ** 2) / TARGET_RADIUS**2)


@cache
def layout_of(degree: int) -> Layout:
    """Samples that densities of a degree are fitted with."""
    return Layout.of(degree)


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
