"""Which frame of a clip shows the contact: by time, by pose, or by the picture.

Every choice here states what happens on a tie: the earlier frame wins.
"""

from __future__ import annotations

import math
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.errors import InputError

ContactMethod = Literal["contact_start", "contact_end", "peak", "median", "best"]
CONTACT_METHODS: tuple[ContactMethod, ...] = get_args(ContactMethod)
"""Names of the ways to choose one frame: see :meth:`realtouch.media.clips.TouchClip.contact_index`."""

DEFAULT_MIN_CHANGE = 12.0
"""Grey levels by which a pixel must differ from the clip's median to count as changed."""

DEFAULT_MIN_AREA = 0.005
"""Share of changed pixels from which a frame counts as contact."""

CLOCK_TOLERANCE_S = 1e-4
"""Times so close count as one, seconds: what single precision rounds off in a clock's first half hour."""

# Of the published 58 to 90 frames every fifth: most show the gel at rest, and a median sorts them all.
_MEDIAN_FRAMES = 15


def contact_window(time_s: NDArray[np.float64], start_s: float, end_s: float) -> slice:
    """Return the frames between the first and the last registered contact, both included.

    ``time_s``, shape (N,), rises. ``start`` is the first frame at or after ``start_s``, ``stop`` one more
    than the last at or before ``end_s``; times within :data:`CLOCK_TOLERANCE_S` count as equal. Where no
    frame lies between them, the one frame nearest to ``end_s`` (the earlier of two equally near) is returned,
    so that a window always holds a frame of a clip that has any.
    """
    start = int(np.searchsorted(time_s, start_s - CLOCK_TOLERANCE_S, side="left"))
    stop = int(np.searchsorted(time_s, end_s + CLOCK_TOLERANCE_S, side="right"))
    if start < stop:
        return slice(start, stop)
    nearest = int(np.argmin(np.abs(time_s - end_s))) if len(time_s) else 0
    return slice(nearest, min(nearest + 1, len(time_s)))


def contact_windows(
    time_s: NDArray[np.float64],
    lengths: NDArray[np.int64],
    start_s: NDArray[np.float64],
    end_s: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return start and stop of :func:`contact_window` of T clips at once, shapes (T,).

    ``time_s`` has the shape (T, N); what lies behind the length of a clip, at most N, is not looked at.
    """
    # Times rise, so that counting those before a bound finds it: a `searchsorted` for all clips at once.
    stored = np.arange(time_s.shape[1]) < lengths[:, None]
    starts = (stored & (time_s < start_s[:, None] - CLOCK_TOLERANCE_S)).sum(axis=1)
    stops = (stored & (time_s <= end_s[:, None] + CLOCK_TOLERANCE_S)).sum(axis=1)
    for touch in np.flatnonzero(starts >= stops).tolist():
        window = contact_window(time_s[touch, : lengths[touch]], start_s[touch], end_s[touch])
        starts[touch], stops[touch] = window.start, window.stop
    return starts, stops


def deepest_frame(z_m: NDArray[np.floating]) -> int:
    """Return the frame of the deepest press, the lowest gel; the earliest of equally low ones."""
    return int(np.argmin(z_m))


def changed_area(
    frames: NDArray[np.uint8], min_change: float = DEFAULT_MIN_CHANGE
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compare each frame of a clip, shape (N, H, W, 3), uint8, with the clip's median.

    The median of each pixel and channel is taken over up to 15 frames, evenly spaced from first to last. A
    pixel counts as changed when it differs by ``min_change`` grey levels, averaged over the channels. Returns
    the share of changed pixels, 0 to 1, and the mean difference of all pixels, grey levels, each of shape
    (N,).
    """
    chosen = np.unique(np.linspace(0, len(frames) - 1, _MEDIAN_FRAMES).round().astype(int))
    median = np.median(frames[chosen], axis=0).astype(np.int16)
    # Summed over the channels: a third of the threshold's work, and integers throughout.
    differences = [np.abs(frame - median).sum(axis=-1, dtype=np.int32) for frame in frames]
    area = np.array([np.count_nonzero(each > 3 * min_change) / each.size for each in differences])
    return area, np.array([each.mean() / 3 for each in differences])


def most_changed_frame(
    frames: NDArray[np.uint8],
    *,
    min_change: float = DEFAULT_MIN_CHANGE,
    min_area: float = DEFAULT_MIN_AREA,
) -> int | None:
    """Return the frame that differs most from the clip's median, see :func:`changed_area`.

    That is the one with the largest changed area; among equal ones that of the largest mean difference, then
    the earliest. None when no frame reaches ``min_area``, a share of 0 to 1: the clip shows no contact.
    """
    if len(frames) == 0:
        return None
    area, change = changed_area(frames, min_change)
    best = int(np.lexsort((np.arange(len(frames)), -change, -area))[0])
    return best if area[best] >= min_area else None


def contact_heights_m(
    z_m: NDArray[np.floating], recalibrate_z: bool = True, plate_z_m: float = math.nan
) -> NDArray[np.float64]:
    """Return how high above the plate the gel stopped in each touch of one round, shape (T,), metres.

    ``z_m`` is the height of the gel at the deepest press of each touch, cell frame; NaN where it is not
    known, and so is the result then. The zero of z drifts by up to 3 mm between rounds: ``recalibrate_z``
    takes the deepest touch of the round as the plate, or ``plate_z_m`` unless it is NaN: the deepest touch
    may have been taken out of the round.
    """
    heights = np.asarray(z_m, np.float64)
    if not recalibrate_z or not len(heights):
        return heights
    return heights - (np.fmin.reduce(heights) if math.isnan(plate_z_m) else plate_z_m)


def require_method(method: str) -> ContactMethod:
    """Return the method of that name; InputError when there is none."""
    for known in CONTACT_METHODS:
        if known == method:
            return known
    raise InputError(f"no way {method!r} to choose a frame; expected one of {', '.join(CONTACT_METHODS)}")
