"""Indices of sequences: what they stand for, and whether they are in range."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from tactile_toolkit.array_types import Int64


def checked_index(index: int, length: int, of: str, things: str) -> int:
    """Turn an index that may count from the end into one from 0; IndexError, in these words, out of range."""
    if not -length <= index < length:
        raise IndexError(f"{of} {index} is out of range for {length} {things}")
    return index + length if index < 0 else index


def flattened(values: Iterable[Any]) -> Iterator[Any]:
    """Yield values, and those of collections among them, at any depth."""
    for value in values:
        if isinstance(value, Iterable) and not isinstance(value, (str, bytes)):
            yield from flattened(value)
        else:
            yield value


def picks_several(index: Any) -> bool:
    """Return whether an index stands for several items: a slice, or a list, array or tensor of them."""
    if isinstance(index, (slice, list, tuple)):
        return True
    return hasattr(index, "__array__") and np.ndim(index) > 0


def positions(index: Any, length: int) -> Int64:
    """Turn a slice, ints or a boolean mask into positions, shape (n,), 0 to below that length.

    Raises IndexError for a mask of another length and for ints out of range, TypeError for anything else.
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
