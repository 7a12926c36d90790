"""Sines, exponentials and small matrix products that are equal to the last bit on every processor.

The C library, numpy and BLAS choose code by the instructions of the processor, and their results differ in
the last bit. These functions use only additions and products, which all processors round alike.
"""

from __future__ import annotations

import math

import numpy as np

from tactile_toolkit.value_types import Float64

_QUARTER_TURN = math.pi / 2
# pi / 2 in two parts: multiples of the first are exact, so that large angles lose no precision.
_QUARTER_TURN_HIGH = float.fromhex("0x1.921fb544p+0")
_QUARTER_TURN_LOW = float.fromhex("0x1.0b4611a626331p-34")

# Taylor series, last terms first: exact to the last bit within an eighth of a turn.
_SINE = tuple((-1) ** term / math.factorial(2 * term + 1) for term in range(8, 0, -1))
_COSINE = tuple((-1) ** term / math.factorial(2 * term) for term in range(8, 1, -1))

# exp(-20) is 2e-9, below the error of exp_neg().
_FARTHEST = 20.0
_SQUARINGS = 6


def cosine_sine(angle_rad: float) -> tuple[float, float]:
    """Return cosine and sine of an angle of up to a million turns, with an error of at most 2^-52."""
    quarters = round(angle_rad / _QUARTER_TURN)
    remainder = (angle_rad - quarters * _QUARTER_TURN_HIGH) - quarters * _QUARTER_TURN_LOW
    squared = remainder * remainder
    sine = cosine = 0.0
    for term in _SINE:
        sine = (sine + term) * squared
    for term in _COSINE:
        cosine = (cosine + term) * squared
    sine = remainder + remainder * sine
    cosine = 1.0 - (0.5 - cosine) * squared
    return ((cosine, sine), (-sine, cosine), (-cosine, -sine), (sine, -cosine))[quarters % 4]


def exp_neg(exponents: Float64) -> Float64:
    """Return ``exp(-exponents)`` of numbers of 0 or more, with an error of 2e-8; 0 from 20 on."""
    near = exponents < _FARTHEST
    # Four terms are enough for a 64th of the exponent; squaring six times gives the power.
    small = exponents[near] * -(0.5**_SQUARINGS)
    power = 1.0 + small * (1.0 + small * (0.5 + small * (1.0 / 6.0 + small / 24.0)))
    for _ in range(_SQUARINGS):
        power *= power
    values = np.zeros_like(exponents)
    values[near] = power
    return values


def moved(points: Float64, matrix: Float64) -> Float64:
    """Return ``points @ matrix`` of shapes (n, k) and (k, m), for small k and m."""
    return np.stack([sum(points[:, k] * factor for k, factor in enumerate(column)) for column in matrix.T], 1)


def inverse_affine(forward: Float64, at: Float64, from_there: Float64) -> tuple[float, ...]:
    """Return Pillow's affine map for the inverse of a (2, 2) matrix that maps ``at`` to ``from_there``."""
    (a, b), (c, d) = forward.tolist()
    x, y = at.tolist()
    area = a * d - b * c
    rows = ((d / area, -b / area), (-c / area, a / area))
    return tuple(
        number
        for (first, second), start in zip(rows, from_there.tolist(), strict=True)
        for number in (first, second, start - (first * x + second * y))
    )
