"""The median of more numbers than are held is numpy's."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mnist3d import spread
from mnist3d.spread import Spread

# Half of the largest number at most: the sum of the two in the middle has to be finite.
_FINITE = st.floats(-np.finfo(np.float64).max / 2, np.finfo(np.float64).max / 2)
NUMBERS = arrays(np.float64, st.integers(1, 40), elements=_FINITE | st.just(math.nan) | st.integers(-3, 3))


def found(numbers: np.ndarray, pieces: int) -> tuple[Spread, int]:
    measured, passes = Spread(), 0
    while not measured.is_found:
        for piece in np.array_split(numbers, pieces):
            measured.add(piece)
        measured.end_pass()
        passes += 1
    return measured, passes


@given(NUMBERS, st.integers(1, 5), st.sampled_from([0, 4, 1000]))
def test_any_numbers_in_any_pieces(numbers, pieces, held):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(spread, "_HELD", held)
        measured, passes = found(numbers, pieces)
    assert passes == (1 if len(numbers) <= held else 4)
    with np.errstate(invalid="ignore"):
        expected = (numbers.min(), np.median(numbers), numbers.max())
    for value, wanted in zip(measured.rounded(), expected, strict=True):
        assert value == round(float(wanted), 3) or (math.isnan(value) and math.isnan(wanted))


def test_of_no_numbers_there_is_nothing():
    assert found(np.array([]), 1)[0].rounded() == ()
