"""Integers that other libraries store as floats."""

from __future__ import annotations

from typing import Any

import numpy as np

from tactile_toolkit.array_types import AnyArray, Bool

_EXACT = 1 << 53
_INT_LIMIT = 1 << 63


def whole_number(value: object) -> int | None:
    """Convert a stored value to an integer, such as 3.0 to 3; None if it is not an integer.

    Other libraries store integers as floats if some are missing. Floats from 2**53 on are refused, because
    they may represent several integers.
    """
    number: Any = value
    try:
        whole = int(number)
    except (TypeError, ValueError, OverflowError):
        return None
    limit = _EXACT if isinstance(value, float) else _INT_LIMIT
    return whole if whole == number and -limit <= whole < limit else None


def whole_numbers(values: AnyArray) -> Bool:
    """Return the mask of values that are integers, as in :func:`whole_number`."""
    if values.dtype.kind in "bi":
        return np.ones(values.shape, bool)
    if values.dtype.kind == "u":
        return np.asarray(values < np.uint64(_INT_LIMIT))
    if values.dtype.kind == "f":
        return np.asarray((values >= -_EXACT) & (values < _EXACT) & (values == np.trunc(values)))
    return np.array([whole_number(value) is not None for value in values.tolist()], bool)
