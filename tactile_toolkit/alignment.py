"""Samples of a stream at other times: nearest, or interpolated between numbers, angles or rotations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tactile_toolkit import spatial
from tactile_toolkit.array_types import Bool, Float64, Floating, Int64

TIME_TOLERANCE_S = 1e-6
"""Gaps longer than the limit by at most this much are not too long, seconds: rounding of decimal times."""

_NO_TURN = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
    """The samples around each of n times.

    Attributes
    ----------
    nearest : ndarray of int64, shape (n,)
        Number of the nearest sample, the earlier of two equally near.
    before, after : ndarray of int64, shape (n,)
        The last sample at or before a time and the first at or after it; before the first sample and after
        the last one, both are that sample. If samples have the same time, it is the first of them.
    share : ndarray of float64, shape (n,)
        Where a time lies from ``before`` (0) to ``after`` (1).
    missing : ndarray of bool, shape (n,)
        Whether the nearest sample is too far away, or both are too far apart.
    """

    nearest: Int64
    before: Int64
    after: Int64
    share: Float64
    missing: Bool

    @classmethod
    def of(cls, time_s: Float64, sample_s: Float64, max_gap_s: float) -> Neighbours:
        """Find the samples around times.

        Parameters
        ----------
        time_s : ndarray of float64, shape (n,)
            Times, seconds.
        sample_s : ndarray of float64, shape (m,), m >= 1
            Times of the samples, seconds of the same clock, not decreasing.
        max_gap_s : float
            A time has no value if its nearest sample is farther away than this, or if it lies between two
            samples that are farther apart, seconds.
        """
        after = np.searchsorted(sample_s, time_s).clip(max=len(sample_s) - 1)
        last = (np.searchsorted(sample_s, time_s, side="right") - 1).clip(min=0)
        before = np.searchsorted(sample_s, sample_s[last])
        since, until = np.abs(time_s - sample_s[before]), np.abs(sample_s[after] - time_s)
        gap = sample_s[after] - sample_s[before]
        share = np.divide(since, gap, out=np.zeros(len(gap)), where=gap > 0)
        longest = max_gap_s + TIME_TOLERANCE_S
        missing = (np.minimum(since, until) > longest) | (gap > longest)
        return cls(np.where(since <= until, before, after), before, after, share, missing)

    def interpolated(self, values: Floating) -> Float64:
        """Return values, shape (m, ...), on a straight line between two samples, shape (n, ...)."""
        first, second = (values[each].astype(np.float64, copy=False) for each in (self.before, self.after))
        share = self.share.reshape(-1, *[1] * (values.ndim - 1))
        with np.errstate(invalid="ignore", over="ignore"):  # the source checks its samples
            return np.where(share == 0, first, first + (second - first) * share)

    def on_circle(self, angles: Floating, turn: float) -> Float64:
        """Return angles, shape (m, ...), on the shorter way around the circle, shape (n, ...).

        ``turn`` is a full turn in their unit. Samples within one turn from 0, or from half a turn before it,
        as most devices state angles, give values within that turn; others may count turns.
        """
        first, second = (angles[each].astype(np.float64, copy=False) for each in (self.before, self.after))
        share = self.share.reshape(-1, *[1] * (angles.ndim - 1))
        with np.errstate(invalid="ignore"):
            found = first + ((second - first + turn / 2) % turn - turn / 2) * share
            for start in (0.0, -turn / 2):
                inside = np.nan_to_num(angles, nan=start)
                if inside.min() >= start and inside.max() <= start + turn:
                    found = (found - start) % turn + start
                    break
            return np.where(share == 0, first, found)

    def turned(self, quaternions: Floating) -> Float64:
        """Return quaternions, shape (m, 4), on the shorter turn from one to the next, shape (n, 4).

        The angular velocity is constant (slerp); the real part may come first or last. Lengths other than one
        are interpolated, so that a check of lengths still fails.
        """
        lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
        lengths[lengths == 0] = np.nan  # no rotation
        turns = spatial.Rotation.from_quat(np.where(np.isfinite(lengths), quaternions, _NO_TURN))
        way = (turns[self.before].inv() * turns[self.after]).as_rotvec() * self.share[:, np.newaxis]
        found: Float64 = (turns[self.before] * spatial.Rotation.from_rotvec(way)).as_quat()
        return found * self.interpolated(lengths)
