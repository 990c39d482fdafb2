"""The loss (5) as the paper prints it, over the points where a feature was seen: fits by it, and losses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rholoc.density import ObservedDensities, Sightings
from rholoc.density.density import TARGET_RADIUS
from rholoc.density.observed import RIDGE, fitted_by_place, layout_of, sample_counts
from rholoc.density.polynomial import monomials
from rholoc.density.tensor import kept_powers, scaled_heading
from rholoc.geometry import FloatArray

WINDOW_PLANE = TARGET_RADIUS  # half the width of w in u and in v, on the plane z = 1; in each position …
WINDOW_M = 0.25
WINDOW_RAD = float(np.deg2rad(10.0))  # … and in angle of the heading
_INJECTED = 12  # of the layout's headings, for a density fitted as (5) is printed: every how many
_MINIMUM_NORM = 1e-9  # of the greatest eigenvalue
_VIEWPORT = 0.75  # half the width of the viewport on the plane z = 1


def fit_seen(
    sightings: Sightings, degree: int, progress: Callable[[float, str], None] = lambda done, text: None
) -> ObservedDensities:
    """Densities that minimize the loss (5) as printed: over the points where a feature was seen, and those that
    symmetry injects.

    Of the polynomials that minimize it, the one with the smallest coefficients. It has hardly any peaks.

    Raises:
        ValueError: the bearings at which the features were seen were not kept.
    """

    def fit(local: FloatArray, s: FloatArray, radius_m: float) -> tuple[FloatArray, FloatArray]:
        points = SeenPoints.of(local, s, degree)
        values, vectors = np.linalg.eigh(points.kernel(degree))  # N × N, whatever the degree
        inverse = np.where(values > _MINIMUM_NORM * values[-1], 1 / np.maximum(values, 1e-300), 0.0)
        weights = vectors @ (inverse * (vectors.T @ points.counts(radius_m)))
        flat = np.einsum("nu,nx,nh,n->uxh", *points.factors(degree), weights, optimize=True)
        x = len(kept_powers(degree)[1])
        phi = monomials(kept_powers(degree)[1], s)
        return flat.transpose(1, 0, 2).reshape(x, -1), phi.T @ phi + RIDGE * np.eye(x)

    return fitted_by_place(sightings, degree, fit, progress)


@dataclass(frozen=True, eq=False)
class SeenPoints:
    """The set S_f of the paper: N_f points s where a feature was seen, those injected by symmetry among them.

    Attributes:
        plane: (N, 2) u and v, on the plane z = 1.
        position: (N, 3) in units of the radius, about the place.
        heading: (N, 3) unit vectors in the density's frame.
    """

    plane: FloatArray
    position: FloatArray
    heading: FloatArray

    @classmethod
    def of(cls, bearings: FloatArray, positions: FloatArray, degree: int) -> SeenPoints:
        """From bearings (n, 3) in the density's frame and positions (n, 3) in radii, for every twelfth heading that
        shows the pixel.
        """
        axes = layout_of(degree).axes[::_INJECTED]
        x, y, z = np.einsum("ni,cki->knc", bearings, axes)
        plane = np.stack([x, y], axis=-1) / np.maximum(z, 1e-6)[..., None]
        seen, heading = np.nonzero((z > 0) & (np.abs(plane).max(axis=-1) <= _VIEWPORT))
        return cls(plane[seen, heading], positions[seen], axes[heading, 2])

    def factors(self, degree: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Monomials of ``kept_powers(degree)``: (N, U) of (u, v), (N, X) of the position, (N, H) of the heading."""
        plane, position, heading = kept_powers(degree)
        return (
            monomials(plane, self.plane),
            monomials(position, self.position),
            monomials(heading, scaled_heading(self.heading)),
        )

    def kernel(self, degree: int) -> FloatArray:
        """Sums (N, N) of products of the points' monomials: a product of three small sums (the kernel trick)."""
        plane, position, heading = self.factors(degree)
        return np.asarray((plane @ plane.T) * (position @ position.T) * (heading @ heading.T))

    def counts(self, radius_m: float) -> FloatArray:
        """n (N,): how many of the points lie in the volume w around each, itself among them; the radius in metres."""
        near = (np.abs(self.plane[:, None] - self.plane) <= WINDOW_PLANE).all(axis=2)
        near &= (radius_m * np.abs(self.position[:, None] - self.position) <= WINDOW_M).all(axis=2)
        near &= self.heading @ self.heading.T >= np.cos(WINDOW_RAD)
        return np.asarray(near.sum(axis=1), dtype=np.float64)


@dataclass(frozen=True)
class Loss:
    """Equation (5) for one density, under three explanations.

    Attributes:
        points: N_f.
        zero: the loss of ρ = 0.
        constant: of the best constant.
        fitted: of the fit.
    """

    points: int
    zero: float
    constant: float
    fitted: float

    @classmethod
    def of(cls, counts: FloatArray, values: FloatArray) -> Loss:
        """From n(s) and q(s) = N_f w ρ(s) at all points, arrays of one shape."""
        n = counts.ravel()
        return cls(n.size, float(n @ n), float(((n - n.mean()) ** 2).sum()), float(((n - values.ravel()) ** 2).sum()))


def observed_loss(densities: ObservedDensities, density: int, bearings: FloatArray, positions: FloatArray) -> Loss:
    """Loss (5) of the density in row ``density`` over all pixels of the views at bearings (N, 3) from positions (N, 3),
    map frame.
    """
    layout, degree = layout_of(densities.degree), densities.degree
    plane, _, heading = kept_powers(degree)
    phi = densities.position_monomials(density, positions)
    values = np.einsum(
        "au,nx,ch,uxh->anc",
        monomials(plane, layout.plane),
        phi,
        monomials(heading, scaled_heading(layout.axes[:, 2])),
        densities.coefficients[density].astype(np.float64),
        optimize=True,
    )
    return Loss.of(sample_counts(bearings @ densities.R_local_map[density].T, degree), values)


def seen_loss(densities: ObservedDensities, density: int, bearings: FloatArray, positions: FloatArray) -> Loss:
    """Loss (5) as printed of the density in row ``density``, over the points seen at bearings (N, 3) from positions (N,
    3).
    """
    s = (positions - densities.places[density]) / densities.radii[density]
    points = SeenPoints.of(bearings @ densities.R_local_map[density].T, s, densities.degree)
    coefficients = densities.coefficients[density].astype(np.float64)
    values = np.einsum("nu,nx,nh,uxh->n", *points.factors(densities.degree), coefficients, optimize=True)
    return Loss.of(points.counts(float(densities.radii[density])), values)
