"""Numbers and arrays of other libraries as Python's own numbers and tuples."""

from __future__ import annotations

import numbers
from collections.abc import Iterable, Mapping
from typing import Any


def to_builtin(value: object, kind: type[int] | type[float] = int) -> Any:
    """Return a value with tuples for all iterables and Python's numbers for all numbers.

    With ``kind`` ``float``, integers become floats; with ``int`` numbers keep their kind. A value that is
    neither a number nor an iterable is returned unchanged, for the checks that follow.
    """
    if isinstance(value, (str, bytes, Mapping)):
        return value
    # An array without dimensions is a number, although its type is iterable.
    if isinstance(value, Iterable) and getattr(value, "ndim", None) != 0:
        return tuple(to_builtin(entry, kind) for entry in value)
    return to_builtin_number(value, kind)


def to_builtin_number(value: Any, kind: type[int] | type[float] = int) -> Any:
    """Return a number as Python's own; see :func:`to_builtin`."""
    if getattr(value, "ndim", None) == 0:
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return value
    if kind is not float and isinstance(value, numbers.Integral):
        return int(value)
    try:
        return float(value)
    except OverflowError:
        return value


def to_builtin_pairs(values: object) -> Any:
    """Return pairs of a name and a number, or a mapping, as a tuple of tuples."""
    return to_builtin(values.items() if isinstance(values, Mapping) else values)


def is_integer(*values: object) -> bool:
    """Return whether all values are integers; True and False are not."""
    return all(isinstance(value, int) and not isinstance(value, bool) for value in values)
