"""Smallest, median and largest of numbers that are too many to be held."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Spread"]

_HELD = 1 << 20
_DIGIT_BITS = 16
_SIGN = np.uint64(1 << 63)


class Spread:
    """Smallest, median and largest of numbers that are shown in passes, all of them in each.

    A million are held, and one pass does. Of more the median is found digit by digit, in four passes.
    """

    def __init__(self) -> None:
        self.is_found = False
        self._count, self._least, self._most, self._median = 0, math.inf, -math.inf, math.nan
        self._held: list[NDArray[np.float64]] | None = []
        self._middle = (_Ranked(), _Ranked())

    def add(self, numbers: NDArray[Any]) -> None:
        """Take a piece of a pass."""
        if self.is_found or not len(numbers):
            return
        values = np.asarray(numbers, np.float64) + 0.0  # of two zeros one
        if self._middle[0].is_new:
            self._count += len(values)
            self._least = float(np.minimum(self._least, values.min()))
            self._most = float(np.maximum(self._most, values.max()))
            if self._held is not None:
                self._held.append(values)
                if self._count <= _HELD:
                    return
                values, self._held = np.concatenate(self._held), None
        bits = values.view(np.uint64)
        keys = np.where(bits & _SIGN, ~bits, bits | _SIGN)  # in the order of the numbers
        for ranked in self._middle:
            ranked.add(keys)

    def end_pass(self) -> None:
        """Look at what a pass has shown."""
        if self._held is not None:
            self._median = float(np.median(np.concatenate(self._held))) if self._held else math.nan
            self.is_found = True
            return
        ends = [
            ranked.end_pass(rank)
            for ranked, rank in zip(self._middle, ((self._count - 1) // 2, self._count // 2), strict=True)
        ]
        self.is_found = all(ends)
        if self.is_found:
            keys = np.array([ranked.key for ranked in self._middle], np.uint64)
            values = np.where(keys & _SIGN, keys ^ _SIGN, ~keys).view(np.float64)
            self._median = math.nan if math.isnan(self._least) else float(np.mean(values))

    def rounded(self) -> tuple[float, ...]:
        """Return smallest, median and largest to three decimals; nothing of no numbers."""
        if not self._count:
            return ()
        return tuple(round(value, 3) for value in (self._least, self._median, self._most))


class _Ranked:
    """The key of one rank, of which each pass finds the next digit, by counting."""

    def __init__(self) -> None:
        self.key, self.is_new = 0, True
        self._known = 0  # bits of the key
        self._before = 0  # keys that begin with less
        self._counts = np.zeros(1 << _DIGIT_BITS, np.int64)

    def add(self, keys: NDArray[np.uint64]) -> None:
        rest = np.uint64(64 - self._known)
        inside = keys if self.is_new else keys[keys >> rest == np.uint64(self.key)]
        digits = (inside >> np.uint64(64 - self._known - _DIGIT_BITS)) & np.uint64((1 << _DIGIT_BITS) - 1)
        self._counts += np.bincount(digits.astype(np.int64), minlength=len(self._counts))

    def end_pass(self, rank: int) -> bool:
        """Find the next digit of the key of this rank, and tell whether it was the last."""
        ends = self._before + np.cumsum(self._counts)
        digit = int(np.searchsorted(ends, rank, side="right"))
        self._before = int(ends[digit] - self._counts[digit])
        self.key, self.is_new = self.key << _DIGIT_BITS | digit, False
        self._known += _DIGIT_BITS
        self._counts[:] = 0
        return self._known == 64
