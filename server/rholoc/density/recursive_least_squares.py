"""Recursive least squares with forgetting: coefficients estimated one observation at a time.

The paper's conclusion asks for it (section 7, "feature observation-time iterative coefficient estimation"). After
observations (φ_i, y_i), i = 1 … N, the coefficients minimize

    Σ_i λ^(N−i) |y_i − cᵀ φ_i|² + λ^N ridge |c|²,

the same as fitted to all of them in one batch; but each takes one step (Plackett, 1950), whatever came before:

    k = P φ / (λ + φᵀ P φ),    c ← c + k (y − cᵀ φ)ᵀ,    P ← (P − k φᵀ P) / λ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rholoc.geometry import FloatArray


@dataclass(frozen=True, eq=False)
class RecursiveFit:
    """The state of the estimation.

    Attributes:
        coefficients: (X, K) c, of X monomials, for K values that are fitted side by side.
        covariance: (X, X) P, the inverse of Σ λ^(N−i) φ φᵀ + λ^N ridge.
    """

    coefficients: FloatArray
    covariance: FloatArray

    @classmethod
    def empty(cls, monomials: int, values: int, ridge: float) -> RecursiveFit:
        """Initial state for ``monomials`` X and ``values`` K: coefficients 0, covariance I / ``ridge``."""
        return cls(np.zeros((monomials, values)), np.eye(monomials) / ridge)

    def observe(self, phi: FloatArray, value: FloatArray, forgetting: float = 1.0) -> RecursiveFit:
        """The state after one more observation; this one stays as it is.

        Args:
            phi: (X,) monomials at the observation's position.
            value: (K,) observed values.
            forgetting: λ, 0 < λ ≤ 1: factor on the weight of all earlier observations.
        """
        seen = self.covariance @ phi
        gain = seen / (forgetting + phi @ seen)
        covariance = (self.covariance - np.outer(gain, seen)) / forgetting
        innovation = value - phi @ self.coefficients
        return RecursiveFit(self.coefficients + np.outer(gain, innovation), (covariance + covariance.T) / 2)
