"""Arrays and numbers of users, checked before they reach compiled loops, which check nothing."""

from __future__ import annotations

import math

import numpy as np

from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import Float64

MAX_NUMBERS = 1 << 30
_MAX_SHOWN = 60


def real_array(value: object) -> Float64 | None:
    """Return real numbers as an array of float64; None for anything else, and for more than 2**30 of them."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, OverflowError):
        return None
    if array.dtype.kind not in "iuf" or array.size > MAX_NUMBERS:
        return None
    return np.asarray(array, np.float64)


def is_real_array(value: object) -> bool:
    """Return whether a value is an array of real numbers, with a dimension and at most 2**30 of them."""
    if not isinstance(value, np.ndarray) or value.ndim == 0:
        return False
    return value.dtype.kind in "iuf" and value.size <= MAX_NUMBERS


def finite_array(
    value: object, name: str, shape: tuple[int | None, ...], expected: str, *, most: float = math.inf
) -> Float64:
    """Return finite numbers as an array of float64 of a shape, in which None is any length above 0.

    InputError, which begins with ``name`` and states what was ``expected``, for anything else, and for
    numbers beyond -most to most.
    """
    array = real_array(value)
    if array is None or array.ndim != len(shape) or not _has_sides(array.shape, shape):
        raise InputError(f"is {shown(value)}; expected {expected}", field=name)
    if not (np.abs(array) <= most).all() or not np.isfinite(array).all():
        wrong = array[~(np.isfinite(array) & (np.abs(array) <= most))].flat[0]
        limit = f", at most {most:g}" if math.isfinite(most) else ""
        raise InputError(f"is or holds {wrong:g}; expected {expected}, finite{limit}", field=name)
    return array


def _has_sides(sides: tuple[int, ...], shape: tuple[int | None, ...]) -> bool:
    expected = zip(sides, shape, strict=True)
    return all(side > 0 if length is None else side == length for side, length in expected)


def shown(value: object) -> str:
    """Return a value in messages: an array by its type and shape, anything else in short."""
    if isinstance(value, np.ndarray) and value.ndim:
        return f"an array of {value.dtype} of the shape {value.shape}"
    text = repr(value)
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]} ..."
