"""The interface between the forms of equation (3) and the code that uses densities.

A form is a class that implements :class:`Densities`, in a module of its own, and is listed in ``FORMS`` of
:mod:`rholoc.density`. Localization, files and mapping use nothing else of it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar, Protocol, Self

from numpy.typing import NDArray

from rholoc.density.evidence import Evidence
from rholoc.geometry import FloatArray, IntArray, Similarity

Arrays = Mapping[str, NDArray[Any]]

TARGET_RADIUS = 60 / 525
"""Default radius of a density on the plane z = 1: 60 px at a focal length of 525 px."""


class DensityKind(StrEnum):
    """The form of equation (3) that a map's densities take."""

    RAY = "ray"  # in s = (bearing, position): exact, from information sums
    TENSOR = "tensor"  # in s = (u, v, position, heading): the paper's own, fitted to a bump around the landmark
    OBSERVED = "observed"  # the same, fitted by the paper's loss (5) to the observations themselves


@dataclass(frozen=True, eq=False)
class Sightings:
    """Data that densities are fitted to: F landmarks and V observations, each of one landmark from one pose.

    Attributes:
        landmarks: (F, 3) metres, map frame.
        features: (V,) row of the landmark that was seen.
        positions: (V, 3) position of the camera [m].
        bearings: (V, 3) unit vector towards the detection, map frame; None if not kept.
    """

    landmarks: FloatArray
    features: IntArray
    positions: FloatArray
    bearings: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class DensityRows:
    """The T densities of a map as a table lists them.

    Attributes:
        features: (T,) feature of each density, non-decreasing.
        domain: (T, C) float32, values of the form's ``Densities.domain_columns``.
    """

    features: IntArray
    domain: FloatArray


@dataclass(frozen=True, eq=False)
class Slopes:
    """K densities ρ = max(0, 1 − d) at one pose, and how d changes with a small motion of the camera.

    d, the distance from the density's peak, is 0 there and 1 where the tolerance ends. A motion is (position in metres,
    rotation in radians from the left), both in the map frame; the tolerances are held.

    Attributes:
        density: (K,) ρ.
        inside: (I,) the rows of the K whose ρ is above 0.
        gradient: (I, 6) ∂d by the motion, equation (4).
        roots: (I, 2, 6) L: half the curvature of d is about Lᵀ L (Gauss–Newton).
    """

    density: FloatArray
    inside: IntArray
    gradient: FloatArray
    roots: FloatArray


class LocalDensities(Protocol):
    """The densities of those of M matches that have one around a pose.

    Attributes:
        matches: (K,) their rows in the evidence.
    """

    @property
    def matches(self) -> IntArray: ...

    def at(self, T_map_camera: FloatArray, tolerance_px: float) -> Slopes:
        """ρ and its slopes at a pose (4, 4), for a tolerance in pixels."""
        ...


class Densities(Protocol):
    """The densities of all features of a map, in one form of equation (3).

    Attributes:
        kind: the form.
        degree: P, the highest power of each variable.
        has_exact_peaks: whether a density peaks exactly at its landmark, so that the last steps of an ascent may use
            the peaks alone.
        degrees: possible degrees.
        variables: names of the variables s, in the order of equation (3).
        domain_columns: names of the columns that Table 5 has of a density besides its coefficients.
    """

    kind: ClassVar[DensityKind]
    has_exact_peaks: ClassVar[bool]
    degrees: ClassVar[tuple[int, ...]]
    variables: ClassVar[tuple[str, ...]]
    domain_columns: ClassVar[tuple[str, ...]]

    @property
    def degree(self) -> int: ...

    def near(self, evidence: Evidence, T_map_camera: FloatArray, tolerance_px: float) -> LocalDensities:
        """The densities of matches near a pose (4, 4), for tolerances of up to ``tolerance_px``."""
        ...

    def problem(self, features: int) -> str:
        """Reason why these cannot be the densities of a map with ``features`` features, a clause; empty if they can."""
        ...

    def rows(self, sightings: Sightings, variances: FloatArray) -> DensityRows:
        """All densities as rows of Table 5, sorted by feature.

        ``variances`` (F,) [m²] are those of the landmarks' positions, the mean over the axes.
        """
        ...

    def coefficients_of(self, row: int, landmark: FloatArray, domain: FloatArray) -> FloatArray:
        """All (P + 1)ⁿ coefficients of equation (3) of one density, in the order of Table 5.

        Args:
            row: row of the density in :meth:`rows`.
            landmark: (3,) landmark of the row's feature [m].
            domain: (C,) domain of the row.
        """
        ...

    @classmethod
    def kept_coefficients(
        cls, coefficients: FloatArray, degree: int, landmark: FloatArray, domain: FloatArray
    ) -> FloatArray:
        """The part that a map stores of all (P + 1)ⁿ ``coefficients`` of one density, in the order of Table 5.

        Raises:
            ValueError: no density of this form has these coefficients; the message continues "row N …".
        """
        ...

    @classmethod
    def from_rows(cls, degree: int, rows: DensityRows, landmarks: FloatArray, kept: Sequence[FloatArray]) -> Self:
        """Densities from :meth:`rows`, a map's landmarks (F, 3), and the :meth:`kept_coefficients` of each row.

        Raises:
            ValueError: the rows contradict each other; says which.
        """
        ...

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays that a map's file stores beside the landmarks, by name."""
        ...

    @classmethod
    def from_arrays(cls, arrays: Arrays, landmarks: FloatArray) -> Self:
        """Densities from the result of :meth:`arrays` and a map's landmarks (F, 3).

        Raises:
            ValueError: an array is missing, or contradicts another; says which.
        """
        ...

    def moved(self, similarity: Similarity) -> Self:
        """The same features' densities in the target frame of ``similarity``."""
        ...

    @classmethod
    def fit(cls, sightings: Sightings, degree: int, progress: Callable[[float, str], None]) -> Self:
        """Fit the densities of landmarks that were seen, of degree P = ``degree``.

        ``progress`` is called with the share done and a line about it. Raises ValueError if ``observed`` ones lack
        bearings.
        """
        ...
