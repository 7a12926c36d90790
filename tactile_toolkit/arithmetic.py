"""Sines, exponentials and small matrices by additions and products alone, which every processor rounds alike.

Those of the C library, of numpy and of BLAS choose code by the instructions that a processor has, and differ
in the last bit; what is stored must not.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from tactile_toolkit.array_types import Float64

if TYPE_CHECKING:
    pass


_QUARTER_TURN = math.pi / 2
# pi / 2 in two parts: multiples of the first are exact, so that nothing of a turned angle is lost.
_QUARTER_TURN_HIGH = float.fromhex("0x1.921fb544p+0")
_QUARTER_TURN_LOW = float.fromhex("0x1.0b4611a626331p-34")

# Taylor's sums, last terms first: within an eighth of a turn these are exact to the last place.
_SINE = tuple((-1) ** term / math.factorial(2 * term + 1) for term in range(8, 0, -1))
_COSINE = tuple((-1) ** term / math.factorial(2 * term) for term in range(8, 1, -1))

# exp(-20) is 2e-9, less than what exp_neg() may be off.
_FARTHEST = 20.0
_SQUARINGS = 6


def cosine_sine(angle_rad: float) -> tuple[float, float]:
    """Return cosine and sine of an angle up to a million turns, within 2^-52 of the true ones."""
    quarters = round(angle_rad / _QUARTER_TURN)
    rest = (angle_rad - quarters * _QUARTER_TURN_HIGH) - quarters * _QUARTER_TURN_LOW
    squared = rest * rest
    sine = cosine = 0.0
    for term in _SINE:
        sine = (sine + term) * squared
    for term in _COSINE:
        cosine = (cosine + term) * squared
    sine, cosine = rest + rest * sine, 1.0 - (0.5 - cosine) * squared
    return ((cosine, sine), (-sine, cosine), (-cosine, -sine), (sine, -cosine))[quarters % 4]


def exp_neg(exponents: Float64) -> Float64:
    """Return ``exp(-exponents)`` of numbers of 0 or more, right to 2e-8 and 0 from 20 on."""
    near = exponents < _FARTHEST
    # Of a 64th of it four terms are enough; squaring six times gives the whole.
    small = exponents[near] * -(0.5**_SQUARINGS)
    power = 1.0 + small * (1.0 + small * (0.5 + small * (1.0 / 6.0 + small / 24.0)))
    for _ in range(_SQUARINGS):
        power *= power
    found = np.zeros_like(exponents)
    found[near] = power
    return found


def moved(points: Float64, matrix: Float64) -> Float64:
    """Return ``points @ matrix``, shapes (n, k) and (k, m) of small k and m."""
    return np.stack([sum(points[:, k] * factor for k, factor in enumerate(column)) for column in matrix.T], 1)


def inverse_affine(forward: Float64, at: Float64, from_there: Float64) -> tuple[float, ...]:
    """Return the map that undoes a matrix, shape (2, 2), and takes a point to another, as Pillow takes it."""
    (a, b), (c, d) = forward.tolist()
    x, y = at.tolist()
    area = a * d - b * c
    rows = ((d / area, -b / area), (-c / area, a / area))
    return tuple(
        number
        for (first, second), start in zip(rows, from_there.tolist(), strict=True)
        for number in (first, second, start - (first * x + second * y))
    )
