"""Writers: their styles, and streams of random numbers that are the same on every platform."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mnist3d.handwriting import allographs, curves
from tactile_toolkit.array_types import Float64, UInt8

_BLOCK = 64
_UNIT = 2.0**-53

# The sum of four uniform numbers has the variance 1/3.
_ROOT_3 = 1.7320508075688772

DIGIT_STYLES = (
    (0.93, 0.12, 1.1),
    (0.96, 0.05, 1.0),
    (0.96, -0.08, 1.1),
    (1.08, -0.04, 1.3),
    (0.99, 0.05, 1.0),
    (1.13, -0.04, 1.05),
    (1.01, -0.03, 1.1),
    (1.03, -0.07, 1.0),
    (1.0, -0.03, 1.0),
    (1.02, 0.03, 0.95),
)
"""For each digit: width relative to the writer's, lean beyond the writer's slant, freedom of its shape."""

_ASPECT, _SLANT, _TILT, _BOW = 0.10, 0.10, 0.04, 0.02
"""Spread of the traits of a writer from digit to digit."""

_BETWEEN_WRITERS = 0.68

# Fractions of the square roots of the first ten primes, so that no two digits repeat in step.
_STRIDES = tuple(round(math.sqrt(prime) % 1.0, 8) for prime in (2, 3, 5, 7, 11, 13, 17, 19, 23, 29))


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


@dataclass(frozen=True, slots=True)
class WriterStyle:
    """The stable traits of a writer."""

    slant: float  # sideways shift of the top per unit of height; positive leans right
    tilt: float  # rise of the writing line per unit of width
    aspect: float  # factor on the width of every glyph
    bow: float  # how much verticals bend, as a share of the height
    height_px: float  # of the ink
    pen_px: float
    nib: float  # 0 for a round tip; 0.2 for a chisel tip whose stroke varies by 20 % with its direction
    nib_lean: float  # slope of the chisel's edge
    pressure: float  # relative change of the stroke width along a stroke
    roundness: int  # smoothing rounds on corners
    jitter: float  # size of the changes from digit to digit, relative to those between writers
    tremor_px: float  # deviation of the pen's path
    roughness_px: float  # deviation of the edge of the ink
    gaps: float  # mean number of light spots in the ink
    specks: float  # mean number of stray dots next to it
    fidelity: float  # chance that a digit takes the writer's preferred shape


def draw_style(rng: KeyedRng) -> WriterStyle:
    """Draw a writer's traits.

    The ranges of height and pen width are those of HWD+ (Beaulac and Rosenthal 2022): ink 250 to 330 px
    tall, strokes 20 to 45 px wide.
    """
    return WriterStyle(
        slant=0.13 + 0.19 * rng.approx_normal(),
        tilt=0.03 * rng.approx_normal(),
        aspect=1.14 + 0.105 * rng.approx_normal(),
        bow=0.02 * rng.approx_normal(),
        height_px=rng.uniform(258.0, 322.0),
        pen_px=rng.uniform(21.0, 43.0),
        nib=max(0.0, rng.uniform(-0.15, 0.20)),
        nib_lean=rng.uniform(-1.0, 1.0),
        pressure=rng.uniform(0.02, 0.09),
        roundness=int(5.0 * rng.unit()),
        jitter=rng.uniform(0.5, 0.8),
        tremor_px=rng.uniform(0.3, 1.4),
        roughness_px=rng.uniform(0.5, 1.4),
        gaps=rng.uniform(0.0, 7.0),
        specks=rng.uniform(0.0, 4.0),
        fidelity=rng.uniform(0.7, 1.0),
    )


def variation(writer: KeyedRng, digit: KeyedRng, jitter: float, freedom: float = 1.0) -> curves.Vary:
    """Return the function that gives each number of a shape its value for one writer and one digit.

    `writer` is the stream of this writer and shape, which all digits of this shape share. `jitter` is the
    weight of the stream of this `digit`. `freedom` scales all spreads.
    """
    of_writer, of_digit = _BETWEEN_WRITERS * freedom, jitter * freedom

    def vary(mean: float, spread: float) -> float:
        # The order in which both streams are read is part of what a seed gives.
        writer_noise, digit_noise = writer.approx_normal(), digit.approx_normal()
        return mean + spread * (of_writer * writer_noise + of_digit * digit_noise)

    return vary


def style_for_digit(style: WriterStyle, label: int, vary: curves.Vary) -> WriterStyle:
    """Return a style for one digit: people write some digits wider or steeper than others."""
    width, lean, _ = DIGIT_STYLES[label]
    return replace(
        style,
        aspect=style.aspect * width * max(0.5, vary(1.0, _ASPECT)),
        slant=style.slant + lean + vary(0.0, _SLANT),
        tilt=style.tilt + vary(0.0, _TILT),
        bow=style.bow + vary(0.0, _BOW),
    )


def choose_allograph(label: int, writer: int, class_noise: KeyedRng, digit: KeyedRng, fidelity: float) -> int:
    """Return the shape of `label` to draw: the writer's own with chance `fidelity`, else any.

    Writers take their shapes along a low-discrepancy sequence, so that a few dozen writers show every shape
    in about its share, with any seed. `class_noise` is the stream of this seed and label.
    """
    weights = [weight for _, weight in allographs.ALLOGRAPHS[label]]
    mark = (class_noise.unit() + writer * _STRIDES[label]) % 1.0
    preferred, other = index_at(weights, mark), index_at(weights, digit.unit())
    return preferred if digit.unit() < fidelity else other
