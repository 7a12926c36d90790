"""Which shapes each digit can take, and which of them a writer prefers."""

from __future__ import annotations

from mnist3d.sources.handwriting import lower, upper
from mnist3d.sources.handwriting.dice import Dice, index_at
from mnist3d.sources.handwriting.upper import Shape

__all__ = ["ALLOGRAPHS", "Variation", "choose_allograph"]

ALLOGRAPHS: tuple[tuple[tuple[Shape, float], ...], ...] = (
    ((upper.zero_narrow, 0.40), (upper.zero_round, 0.35), (upper.zero_overlapping, 0.25)),
    ((upper.one_plain, 0.79), (upper.one_with_flag, 0.09), (upper.one_with_upstroke, 0.06), (upper.one_with_foot, 0.06)),
    ((upper.two_round, 0.50), (upper.two_looped, 0.28), (upper.two_angular, 0.22)),
    ((upper.three_round, 0.60), (upper.three_looped, 0.25), (upper.three_flat_topped, 0.15)),
    ((upper.four_open, 0.44), (upper.four_closed, 0.20), (upper.four_one_stroke, 0.24), (upper.four_low_stem, 0.12)),
    ((lower.five_with_bar, 0.45), (lower.five_one_stroke, 0.35), (lower.five_round, 0.20)),
    ((lower.six_curved, 0.55), (lower.six_straight, 0.25), (lower.six_curled, 0.20)),
    ((lower.seven_plain, 0.52), (lower.seven_crossed, 0.26), (lower.seven_serif, 0.22)),
    ((lower.eight_s_first, 0.60), (lower.eight_two_rings, 0.12), (lower.eight_open, 0.28)),
    ((lower.nine_straight, 0.48), (lower.nine_curved, 0.43), (lower.nine_g_shaped, 0.09)),
)
"""For each digit the shapes and the share of writers who prefer them.

The shapes are those seen in MNIST and in collections of pen strokes; the shares are estimates by eye, with
mostly bare 1s and open 4s, as North Americans write.
"""

_BETWEEN_WRITERS = 1.1
_STRIDES = (0.41421356, 0.73205081, 0.23606798, 0.64575131, 0.31662479, 0.60555128, 0.12310563, 0.35889894, 0.79583152, 0.38516481)
"""Fractions of the square roots of the first ten primes: no two digits repeat in step."""


class Variation:
    """Gives every number of a shape its value for one writer and one digit.

    Parameters
    ----------
    writer : Dice
        Stream of this writer and shape: the same in all the writer's digits of that shape.
    digit : Dice
        Stream of this digit.
    jitter : float
        Weight of the second stream.
    """

    __slots__ = ("_digit", "_jitter", "_writer")

    def __init__(self, writer: Dice, digit: Dice, jitter: float) -> None:
        self._writer = writer
        self._digit = digit
        self._jitter = jitter

    def __call__(self, mean: float, spread: float) -> float:
        """Return `mean` plus a bell-shaped deviation of size `spread`."""
        habit, whim = self._writer.bell(), self._digit.bell()
        return mean + spread * (_BETWEEN_WRITERS * habit + self._jitter * whim)


def choose_allograph(label: int, writer: int, seed_dice: Dice, digit: Dice, fidelity: float) -> int:
    """Return which shape of `label` to draw: the writer's own, or now and then another.

    Writers take their shapes by turns along a low-discrepancy sequence, so that a few dozen writers already
    show every shape in about its share, with any seed.

    Parameters
    ----------
    label : int
        0 to 9.
    writer : int
        Number of the writer.
    seed_dice, digit : Dice
        Streams of this seed and label, and of this digit.
    fidelity : float
        Chance of the writer's own shape.
    """
    weights = [weight for _, weight in ALLOGRAPHS[label]]
    mark = (seed_dice.unit() + writer * _STRIDES[label]) % 1.0
    preferred, other = index_at(weights, mark), index_at(weights, digit.unit())
    return preferred if digit.unit() < fidelity else other
