"""Contact by time, and by the height of the gel; arrays only.

Which frames of a clip show contact follows from the registered times (:func:`contact_window`), as in the
paper. Whether a touch met an object follows from the height at which the gel stopped
(:func:`contact_heights_m`), the rule of the paper's authors. If frames are equal, the earlier one is chosen.
The results are exact, the same on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Container
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from tactile_toolkit.array_types import Float64, Floating
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch import RENDERED_CONTACT_M, height_text

ContactMethod = Literal["contact_start", "contact_end", "peak", "best"]

CONTACT_METHODS: tuple[ContactMethod, ...] = get_args(ContactMethod)
"""Names of the ways to choose one frame: see :meth:`realtouch.TouchClip.contact_index`."""

CLOCK_TOLERANCE_S = 1e-4
"""Times within this tolerance are equal, seconds: rounding of single precision in the first half hour."""

MIN_CONTACT_HEIGHT_M = 0.006
"""Height of the gel above the plate from which a touch is a contact, metres: the publisher's threshold."""

PLATE_COLUMN = "plate_z_m"
"""Height of the gel on the bare plate, metres, cell frame, of a round from which `select` took touches, and
of rendered ones whose gel is not that of a GelSight Mini."""

# Only touches of `tactile-sim generate` have this column; their plate is at z = 0.
_MADE_BY_US = "info.touched_object_pose.position"
_PLATES = {
    "known": "the height of the plate is known",
    "stored": "the height of the plate is stored with each round",
    "estimated": "the deepest touch of each round is taken as the plate",
}


def require_method(method: str) -> ContactMethod:
    """Return a method by name; InputError if there is no such method."""
    for known in CONTACT_METHODS:
        if known == method:
            return known
    raise InputError(f"unknown frame method {method!r}; expected one of {', '.join(CONTACT_METHODS)}")


def contact_window(time_s: Float64, start_s: float, end_s: float) -> slice:
    """Return the frames between the first and the last registered contact, both included.

    ``time_s``, shape (N,), does not decrease. ``start`` is the first frame at or after ``start_s``, ``stop``
    one more than the last at or before ``end_s``; times within :data:`CLOCK_TOLERANCE_S` count as equal. If
    no frame lies between them, the frame nearest to ``end_s`` (the earlier of two equally near) is returned,
    so that a window is empty only for a clip without frames.
    """
    start = int(time_s.searchsorted(start_s - CLOCK_TOLERANCE_S, side="left"))
    stop = int(time_s.searchsorted(end_s + CLOCK_TOLERANCE_S, side="right"))
    if start < stop or not len(time_s):
        return slice(start, stop)
    nearest = int(np.argmin(np.abs(time_s - end_s)))
    return slice(nearest, nearest + 1)


def contact_heights_m(z_m: Floating, recalibrate_z: bool = True, plate_z_m: float = math.nan) -> Float64:
    """Return the height above the plate at which the gel stopped, for each touch of a round, (T,), metres.

    ``z_m`` is the height of the gel at the deepest press of each touch, cell frame; NaN where it is not
    known, and so is the result then. The zero of z drifts by up to 3 mm between rounds: ``recalibrate_z``
    takes the deepest touch of the round as the plate, or ``plate_z_m`` unless it is NaN: the deepest touch
    may have been taken out of the round.
    """
    heights = np.asarray(z_m, np.float64)
    if not recalibrate_z or not len(heights):
        return heights
    if math.isnan(plate_z_m):
        plate_z_m = np.fmin.reduce(heights)
    return heights - plate_z_m


@dataclass(frozen=True, slots=True)
class ContactHeight:
    """The rule of a data set; its text is part of a sentence.

    Attributes
    ----------
    min_height_m : float
        Height above the plate from which a touch counts, metres.
    plate : "known", "stored" or "estimated"
        Where the height of the plate is from: that of all touches of `tactile-sim generate`, the column
        ``plate_z_m``, or the deepest touch of each round.
    """

    min_height_m: float
    plate: Literal["known", "stored", "estimated"]

    @classmethod
    def of(cls, columns: Container[str]) -> ContactHeight:
        """Return the rule for rounds with these columns, by dotted name."""
        if _MADE_BY_US in columns:
            return cls(RENDERED_CONTACT_M, "known")
        if PLATE_COLUMN in columns:
            return cls(MIN_CONTACT_HEIGHT_M, "stored")
        return cls(MIN_CONTACT_HEIGHT_M, "estimated")

    def __str__(self) -> str:
        return f"{height_text(self.min_height_m)}; {_PLATES[self.plate]}"
