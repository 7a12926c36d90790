"""Times: Arrow durations and float seconds alike."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["as_seconds", "as_timedelta"]

_NANOSECONDS = 1e9
_SECOND = np.timedelta64(1, "s")


def as_timedelta(values: NDArray[Any]) -> NDArray[np.timedelta64]:
    """Return times as ``timedelta64``.

    Parameters
    ----------
    values : ndarray, any shape
        ``timedelta64`` of any unit (returned as it is), or numbers that count seconds.

    Returns
    -------
    ndarray of timedelta64
        Same shape. Seconds become nanoseconds, rounded to the nearest.
    """
    if values.dtype.kind == "m":
        return values
    nanoseconds = np.round(np.asarray(values, np.float64) * _NANOSECONDS)
    unknown = ~np.isfinite(nanoseconds)
    times = np.where(unknown, 0, nanoseconds).astype(np.int64).astype("timedelta64[ns]")
    times[unknown] = np.timedelta64("NaT")
    return times


def as_seconds(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return times (an array, or one of its values) in seconds, float64; unknown ones are NaN."""
    if values.dtype.kind == "m":
        seconds: NDArray[np.float64] = values / _SECOND
        return seconds
    return np.asarray(values, np.float64)
