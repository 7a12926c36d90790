"""Plain arithmetic against the C library and numpy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from tactile_toolkit.arithmetic import cosine_sine, exp_neg, inverse_affine, moved

NUMBERS = st.floats(-100, 100)


@given(st.floats(-1e6, 1e6))
def test_cosine_and_sine_are_right_to_the_last_places(angle: float) -> None:
    assert cosine_sine(angle) == (pytest.approx((math.cos(angle), math.sin(angle)), rel=0, abs=2.0**-52))


@given(st.floats(0, 100))
def test_decay_is_the_exponential(exponent: float) -> None:
    found = float(exp_neg(np.array([exponent]))[0])
    assert abs(found - math.exp(-exponent)) < 2e-8
    assert (found == 0) == (exponent >= 20)


@given(arrays(np.float64, (5, 3), elements=NUMBERS), arrays(np.float64, (3, 2), elements=NUMBERS))
def test_moved_is_the_matrix_product(points: np.ndarray, matrix: np.ndarray) -> None:
    assert np.allclose(moved(points, matrix), points @ matrix, rtol=0, atol=1e-10)


@given(
    arrays(np.float64, (2, 2), elements=NUMBERS),
    arrays(np.float64, 2, elements=NUMBERS),
    arrays(np.float64, 2, elements=NUMBERS),
)
def test_the_way_back_undoes_a_map(forward: np.ndarray, at: np.ndarray, start: np.ndarray) -> None:
    (a, b), (c, d) = forward.tolist()
    if abs(a * d - b * c) < 1:
        return
    back = np.array(inverse_affine(forward, at, start)).reshape(2, 3)
    assert np.allclose(back @ [*at, 1], start, atol=1e-6)
    assert np.allclose(back[:, :2] @ forward, np.eye(2), atol=1e-6)
