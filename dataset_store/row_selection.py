"""Choosing rows: the places that an index, a mask or a range stands for."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["as_slice", "positions"]


def positions(index: Any, length: int) -> NDArray[Any]:
    """Turn ints or a boolean mask into positions, shape (n,), of a sequence of that length.

    Raises
    ------
    IndexError
        A mask of another length.
    TypeError
        Anything else.
    """
    chosen = np.asarray(index)
    if chosen.dtype == bool:
        if chosen.shape != (length,):
            message = f"a boolean mask of shape {chosen.shape} for {length} rows"
            raise IndexError(message)
        return np.flatnonzero(chosen)
    if chosen.size == 0:
        return chosen.astype(np.int64)
    if chosen.dtype.kind not in "iu" or chosen.ndim != 1:
        message = f"rows are chosen by ints or booleans in one dimension, not {chosen.dtype} {chosen.shape}"
        raise TypeError(message)
    return chosen


def as_slice(rows: range) -> slice:
    """Return a range of positions as a slice."""
    stop = rows.stop if rows.stop >= 0 else None
    return slice(rows.start, stop, rows.step)
