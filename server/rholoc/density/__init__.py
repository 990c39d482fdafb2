"""Equation (3): the forms that a density takes, and presence. Pure numerics.

A form is a module with a class that implements :class:`Densities`; ``FORMS`` names it.
"""

from rholoc.density.density import Densities, DensityKind, DensityRows, LocalDensities, Sightings
from rholoc.density.evidence import Evidence
from rholoc.density.observed import ObservedDensities
from rholoc.density.ray import RayDensities
from rholoc.density.tensor import TensorDensities

FORMS: dict[DensityKind, type[Densities]] = {
    form.kind: form for form in (RayDensities, TensorDensities, ObservedDensities)
}
"""The class of each form."""

__all__ = [
    "FORMS",
    "Densities",
    "DensityKind",
    "DensityRows",
    "Evidence",
    "LocalDensities",
    "ObservedDensities",
    "RayDensities",
    "Sightings",
    "TensorDensities",
]
