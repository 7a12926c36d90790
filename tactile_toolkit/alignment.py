"""Samples of a stream at other times: the nearest, between two, or on the turn from one to the next.

Only sums, products, quotients and square roots are used, which all processors round alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tactile_toolkit.array_types import AnyArray, Bool, Float64, Floating, Int64

TIME_TOLERANCE_S = 1e-6
"""Gaps longer than the limit by at most this much are not too long, seconds: rounding of decimal times."""

# After so many halvings an angle is below 1.2e-5 rad, where arc and chord are equal to the last bit.
_HALVINGS = 17


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
    """The samples around each of n times.

    Attributes
    ----------
    nearest : ndarray of int64, shape (n,)
        Number of the nearest sample, the earlier of two equally near.
    before, after : ndarray of int64, shape (n,)
        The last sample at or before a time and the first at or after it; before the first sample and after
        the last one, both are that sample.
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
            Times of the samples, seconds of the same clock; each is later than the one before.
        max_gap_s : float
            A time has no value if its nearest sample is farther away than this, or if it lies between two
            samples that are farther apart, seconds.
        """
        last = len(sample_s) - 1
        found = np.searchsorted(sample_s, time_s)
        after = np.minimum(found, last)
        before = np.where(sample_s[after] == time_s, after, np.maximum(found - 1, 0))
        since, until = np.abs(time_s - sample_s[before]), np.abs(sample_s[after] - time_s)
        gap = sample_s[after] - sample_s[before]
        share = np.where(gap > 0, since / np.where(gap > 0, gap, 1), 0.0)
        longest = max_gap_s + TIME_TOLERANCE_S
        missing = (np.minimum(since, until) > longest) | (gap > longest)
        return cls(np.where(since <= until, before, after), before, after, share, missing)

    def samples(self, is_linear: bool = True) -> Int64:
        """Return the numbers of all samples that are used, rising; only the nearest ones if not linear."""
        used = [self.nearest, self.before, self.after]
        return np.unique(np.concatenate(used if is_linear else used[:1]))

    def among(self, samples: Int64) -> Neighbours:
        """Return the same neighbours, numbered among the samples that are used."""
        nearest, before, after = (
            np.searchsorted(samples, each) for each in (self.nearest, self.before, self.after)
        )
        return Neighbours(nearest, before, after, self.share, self.missing)

    def picked(self, values: AnyArray) -> AnyArray:
        """Return the nearest of values, shape (m, ...), for each time, shape (n, ...)."""
        return values[self.nearest]

    def interpolated(self, values: Floating) -> Float64:
        """Return values, shape (m, ...), on a straight line between two samples, shape (n, ...)."""
        first, second = (values[each].astype(np.float64, copy=False) for each in (self.before, self.after))
        share = self.share.reshape(-1, *[1] * (values.ndim - 1))
        with np.errstate(invalid="ignore", over="ignore"):  # infinite samples are the affair of the source
            return np.where(share == 0, first, first + (second - first) * share)

    def turned(self, quaternions: Floating) -> Float64:
        """Return quaternions, shape (m, 4), on the shorter turn from one to the next, shape (n, 4).

        The speed of the turn is constant (slerp); the real part may come first or last. Of quaternions of
        another length than one, the length is interpolated, so that a check of lengths still fails.
        """
        samples = quaternions.astype(np.float64, copy=False)
        first, second = samples[self.before], samples[self.after]
        lengths = [np.sqrt(_product(each, each)) for each in (first, second)]
        with np.errstate(invalid="ignore", divide="ignore"):  # there is no turn from or to zero
            start, end = (each / length for each, length in zip((first, second), lengths, strict=True))
        end = np.where(_product(start, end) < 0, -end, end)
        share = self.share[:, np.newaxis].copy()
        for _ in range(_HALVINGS):
            middle = start + end
            middle /= np.sqrt(_product(middle, middle))
            is_late = share >= 0.5
            start, end = np.where(is_late, middle, start), np.where(is_late, end, middle)
            share = 2 * share - is_late
        found = start + (end - start) * share
        length = lengths[0] + (lengths[1] - lengths[0]) * self.share[:, np.newaxis]
        found *= length / np.sqrt(_product(found, found))
        return np.where(self.share[:, np.newaxis] == 0, first, found)


def _product(first: Float64, second: Float64) -> Float64:
    """Return the inner product of each of n quaternions, shape (n, 1), added in one order everywhere."""
    products = first * second
    return (products[:, 0] + products[:, 1] + products[:, 2] + products[:, 3])[:, np.newaxis]
