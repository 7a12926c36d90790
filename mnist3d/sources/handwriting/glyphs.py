"""Which shapes each digit can take, and which of them a writer prefers."""

from __future__ import annotations

from mnist3d.sources.handwriting import digits_0_to_4 as low
from mnist3d.sources.handwriting import digits_5_to_9 as high
from mnist3d.sources.handwriting.hand import KeyedRng, index_at
from mnist3d.sources.handwriting.strokes import Shape

__all__ = ["ALLOGRAPHS", "Variation", "choose_allograph"]

ALLOGRAPHS: tuple[tuple[tuple[Shape, float], ...], ...] = (
    ((low.zero_narrow, 0.40), (low.zero_round, 0.35), (low.zero_overlapping, 0.25)),
    (
        (low.one_plain, 0.77),
        (low.one_with_flag, 0.10),
        (low.one_with_upstroke, 0.08),
        (low.one_with_foot, 0.05),
    ),
    ((low.two_round, 0.50), (low.two_looped, 0.28), (low.two_angular, 0.22)),
    ((low.three_round, 0.60), (low.three_looped, 0.25), (low.three_flat_topped, 0.15)),
    ((low.four_open, 0.47), (low.four_closed, 0.16), (low.four_one_stroke, 0.22), (low.four_low_stem, 0.15)),
    ((high.five_with_bar, 0.45), (high.five_one_stroke, 0.35), (high.five_round, 0.20)),
    ((high.six_curved, 0.55), (high.six_straight, 0.25), (high.six_curled, 0.20)),
    ((high.seven_plain, 0.52), (high.seven_crossed, 0.26), (high.seven_serif, 0.22)),
    ((high.eight_s_first, 0.60), (high.eight_two_rings, 0.12), (high.eight_open, 0.28)),
    ((high.nine_straight, 0.66), (high.nine_curved, 0.24), (high.nine_g_shaped, 0.10)),
)
"""For each digit the shapes and the share of writers who prefer them.

The shapes are those seen in MNIST and in collections of pen strokes; the shares are estimates by eye, with
mostly bare 1s and open 4s, as North Americans write.
"""

_BETWEEN_WRITERS = 1.1
_STRIDES = (
    0.41421356,
    0.73205081,
    0.23606798,
    0.64575131,
    0.31662479,
    0.60555128,
    0.12310563,
    0.35889894,
    0.79583152,
    0.38516481,
)
"""Fractions of the square roots of the first ten primes: no two digits repeat in step."""


class Variation:
    """Gives every number of a shape its value for one writer and one digit.

    `writer` is the stream of this writer and shape, the same in all the writer's digits of that shape;
    `jitter` is the weight of the stream of this `digit`.
    """

    __slots__ = ("_digit", "_jitter", "_writer")

    def __init__(self, writer: KeyedRng, digit: KeyedRng, jitter: float) -> None:
        self._writer = writer
        self._digit = digit
        self._jitter = jitter

    def __call__(self, mean: float, spread: float) -> float:
        """Return `mean` plus a nearly normal deviation of size `spread`."""
        habit, whim = self._writer.approx_normal(), self._digit.approx_normal()
        return mean + spread * (_BETWEEN_WRITERS * habit + self._jitter * whim)


def choose_allograph(label: int, writer: int, fashion: KeyedRng, digit: KeyedRng, fidelity: float) -> int:
    """Return which shape of `label` to draw: with the chance `fidelity` the writer's own, else any.

    Writers take their shapes by turns along a low-discrepancy sequence, so that a few dozen writers already
    show every shape in about its share, with any seed. `fashion` is the stream of this seed and label.
    """
    weights = [weight for _, weight in ALLOGRAPHS[label]]
    mark = (fashion.unit() + writer * _STRIDES[label]) % 1.0
    preferred, other = index_at(weights, mark), index_at(weights, digit.unit())
    return preferred if digit.unit() < fidelity else other
