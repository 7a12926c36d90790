"""Streams of random numbers that are the same on every platform and with every version of numpy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tactile_toolkit.array_types import Float64, UInt8

_BLOCK = 64
_UNIT = 2.0**-53
# The sum of four uniform numbers has the variance 1/3.
_ROOT_3 = 1.7320508075688772


class KeyedRng:
    """A stream of numbers for a key of non-negative integers; streams of different keys are independent.

    Only the raw words of PCG64 and :class:`numpy.random.SeedSequence` are used, whose streams numpy promises
    to keep (NEP 19). The methods of ``Generator`` may change between versions. The rest is addition and
    multiplication, which IEEE 754 rounds the same way everywhere.
    """

    __slots__ = ("_bits", "_left")

    def __init__(self, *key: int) -> None:
        # With the length of the key, because SeedSequence pads short keys with zeros.
        self._bits = np.random.PCG64(np.random.SeedSequence((len(key), *key)))
        self._left: list[float] = []

    def unit(self) -> float:
        """Return the next number, uniform in [0, 1)."""
        if not self._left:
            self._left = self.units(_BLOCK).tolist()
        return self._left.pop()

    def units(self, number: int) -> Float64:
        """Return new numbers, uniform in [0, 1), shape (number,)."""
        return (self._bits.random_raw(number) >> np.uint64(11)).astype(np.float64) * _UNIT

    def uniform(self, low: float, high: float) -> float:
        """Return a number, uniform between `low` and `high`."""
        return low + (high - low) * self.unit()

    def approx_normal(self) -> float:
        """Return a nearly normal number: mean 0, standard deviation 1, never beyond 3.5.

        It is the sum of four uniform numbers. A normal number needs a logarithm, whose last bit differs
        between platforms, and has a tail that would tear glyphs apart.
        """
        return (self.unit() + self.unit() + self.unit() + self.unit() - 2.0) * _ROOT_3

    def approx_normals(self, number: int) -> Float64:
        """Return nearly normal numbers, shape (number,)."""
        units = self.units(4 * number)
        return (units[0::4] + units[1::4] + units[2::4] + units[3::4] - 2.0) * _ROOT_3

    def bytes(self, number: int) -> UInt8:
        """Return uniform bytes, shape (number,)."""
        words = self._bits.random_raw(-(-number // 8)).astype("<u8")
        return words.view(np.uint8)[:number]

    def pick(self, weights: Sequence[float]) -> int:
        """Return a random index, with chances in proportion to the weights."""
        return index_at(weights, self.unit())


def index_at(weights: Sequence[float], mark: float) -> int:
    """Return the index under `mark` when the weights divide [0, 1) in their proportions."""
    left = mark * sum(weights)
    for index, weight in enumerate(weights):
        left -= weight
        if left < 0.0:
            return index
    return len(weights) - 1
