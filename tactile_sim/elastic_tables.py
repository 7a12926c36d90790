"""Kernels in numba that make the tables of a layer: products of matrices, integrals with Bessel functions."""

from __future__ import annotations

import math

import numpy as np

from tactile_toolkit.array_types import Float64
from tactile_toolkit.kernels import compiled


@compiled
def product(left: Float64, right: Float64) -> Float64:
    """Return a matrix product, added up in the order of the numbers."""
    out = np.zeros((left.shape[0], right.shape[1]))
    for row in range(left.shape[0]):
        for inner in range(left.shape[1]):
            factor = left[row, inner]
            for column in range(right.shape[1]):
                out[row, column] += factor * right[inner, column]
    return out


@compiled
def bessel_integrals(radii: Float64, waves: Float64, integrands: Float64) -> Float64:
    """Return sums over waves of four integrands, with J0, J0, J1 and J2 of wave times radius.

    Bessel functions follow from their recurrence downwards (Miller; Abramowitz and Stegun, 9.12).
    """
    out = np.zeros((4, len(radii)))
    for number in range(len(radii)):
        for wave in range(len(waves)):
            phase = radii[number] * waves[wave]
            values = (1.0, 0.5 * phase, 0.125 * phase * phase)
            if phase > 1e-6:
                values = _bessel(phase)
            out[0, number] += integrands[0, wave] * values[0]
            out[1, number] += integrands[1, wave] * values[0]
            out[2, number] += integrands[2, wave] * values[1]
            out[3, number] += integrands[3, wave] * values[2]
    return out


@compiled
def _bessel(phase: float) -> tuple[float, float, float]:
    order = 2 * int((phase + 4.0 * math.sqrt(phase) + 24.0) / 2.0)
    above, here, second, total, inverse = 0.0, 1e-280, 0.0, 0.0, 2.0 / phase
    while order > 0:
        if order == 2:
            second = here
        if order % 2 == 0:
            total += 2.0 * here
        above, here = here, order * inverse * here - above
        order -= 1
        if abs(here) > 1e200:
            above, here, second, total = above * 1e-200, here * 1e-200, second * 1e-200, total * 1e-200
    total += here
    return here / total, above / total, second / total
