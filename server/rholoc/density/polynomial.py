"""Equation (3): polynomials with powers 0..P in every variable, and their gradients, equation (4).

For n variables there are (P + 1)ⁿ monomials, in the order of Table 5: a_{0,…,0} first, the last variable's power
counting fastest, a_{P,…,P} last.
"""

from functools import reduce

import numpy as np

from rholoc.geometry import FloatArray, IntArray


def tensor_powers(variables: int, degree: int) -> IntArray:
    """The powers (C, n) of all C = (degree + 1)ⁿ monomials of n ``variables``, in the order of Table 5."""
    return np.indices((degree + 1,) * variables).reshape(variables, -1).T


def monomials(powers: IntArray, s: FloatArray) -> FloatArray:
    """Π_d s_d^{p_d} (..., C) for ``powers`` (C, n) at points ``s`` (..., n)."""
    return _product(power_factors(powers, s, 0))


def monomial_derivatives(powers: IntArray, s: FloatArray) -> FloatArray:
    """The monomials and their first derivatives (..., C, 1 + n) for ``powers`` (C, n) at points ``s`` (..., n).

    The first column holds the values, column 1 + d the derivative by s_d: the terms of equation (4), with the factor
    p that is missing in the paper's print.
    """
    factors, slopes = power_factors(powers, s, 0), power_factors(powers, s, 1)
    columns = [_product(factors)]
    for d, slope in enumerate(slopes):
        columns.append(_product([*factors[:d], slope, *factors[d + 1 :]]))
    return np.stack(columns, axis=-1)


def power_factors(powers: IntArray, s: FloatArray, order: int) -> list[FloatArray]:
    """For each variable the ``order``-th derivative of s_d^{p_d} (..., C), for ``powers`` (C, n) at ``s`` (..., n)."""
    table = [np.ones(s.shape)]
    for _ in range(int(powers.max(initial=0))):
        table.append(table[-1] * s)
    rising = np.stack(table, axis=-1)  # s_d^p (..., n, P + 1)
    falling = np.ones(powers.shape)
    for i in range(order):
        falling = falling * (powers - i)
    lowered = np.maximum(powers - order, 0)
    return [rising[..., d, lowered[:, d]] * falling[:, d] for d in range(powers.shape[1])]


def _product(factors: list[FloatArray]) -> FloatArray:
    """Elementwise product of arrays (..., C)."""
    return reduce(np.multiply, factors)
