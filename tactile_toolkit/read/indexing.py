"""Indices of sequences."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from tactile_toolkit.array_types import Int64


def checked_index(index: int, length: int, of: str, things: str) -> int:
    """Convert an index that may be negative; IndexError out of range, named by ``of`` and ``things``."""
    if not -length <= index < length:
        raise IndexError(f"{of} {index} is out of range for {length} {things}")
    return index % length


def flattened(values: Iterable[object]) -> Iterator[Any]:
    """Yield the values of nested collections."""
    for value in values:
        if isinstance(value, Iterable) and not isinstance(value, (str, bytes)):
            yield from flattened(value)
        else:
            yield value


def picks_several(index: object) -> bool:
    """Return whether an index selects several items: a slice, list, array or tensor."""
    if isinstance(index, (slice, list, tuple)):
        return True
    return hasattr(index, "__array__") and np.ndim(index) > 0


def positions(index: object, length: int) -> Int64:
    """Convert a slice, ints or a boolean mask to positions, shape (n,), from 0 to below a length.

    Raises IndexError for a mask of another length and for ints out of range, and TypeError for other types.
    """
    if isinstance(index, slice):
        return np.arange(*index.indices(length))
    chosen = np.asarray(index)
    if chosen.ndim != 1 or (chosen.size and chosen.dtype.kind not in "iub"):
        raise TypeError(
            f"rows are chosen by a slice, ints or booleans, not {chosen.dtype} of shape {chosen.shape}"
        )
    found: Int64 = np.arange(length)[chosen if chosen.size else np.zeros(0, np.int64)]
    return found
