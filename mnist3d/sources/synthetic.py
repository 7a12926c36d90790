"""The embedded digit source: procedural handwriting, without any download."""

from __future__ import annotations

from dataclasses import dataclass
from operator import index
from typing import ClassVar

import numpy as np

from mnist3d.handwriting import allographs, inking, keyed_random, page_layout
from mnist3d.handwriting.writer_style import (
    DIGIT_STYLES,
    WriterStyle,
    choose_allograph,
    draw_style,
    style_for_digit,
    variation,
)
from mnist3d.published_splits import MAX_DIGITS
from mnist3d.sources.digit_source import DigitCatalog, DigitImage, require_known
from tactile_toolkit.checked_fields import check_fields, integer

DRAWING_VERSION = 2
"""Increased whenever the same seed and id would give other pixels than before."""

HWD_PLUS_COUNT = 13_580
"""Number of digits of HWD+: 97 writers with 140 digits each (Beaulac and Rosenthal 2022)."""

_PER_CLASS = 14
_PER_WRITER = 10 * _PER_CLASS

_HAND, _CLASS_NOISE, _WRITER_NOISE, _DIGIT, _INK = range(5)
"""First words of the keys of random streams."""

# Relative deviation of height and pen width between the digits of a writer whose jitter is 1.
_SIZE_JITTER = 0.06


@dataclass(frozen=True, slots=True)
class SyntheticSource:
    """Digits in procedural handwriting, laid out like HWD+.

    Every writer writes 140 digits in a row, 14 of each class, in one stable hand. An image is a pure function
    of seed and id: its bytes do not depend on order, process or machine.

    Parameters
    ----------
    seed : int
        Non-negative; another seed gives other writers.
    count : int
        Number of digits, at least 1. A larger count adds writers; the first digits stay the same.

    Raises
    ------
    InputError
        When `seed` or `count` is out of range.

    Examples
    --------
    >>> digit = SyntheticSource().image(150)
    >>> digit.label, digit.writer, digit.pixels.shape
    (0, 1, (500, 500))
    """

    name: ClassVar[str] = "synthetic"
    """Word that selects this source on the command line."""

    seed: int = integer(0)
    count: int = integer(HWD_PLUS_COUNT, 1, MAX_DIGITS)

    def __post_init__(self) -> None:
        check_fields(self, "the synthetic source")

    def fingerprint(self) -> dict[str, object]:
        """Return name, seed, count and the version of the drawing."""
        return {
            "name": self.name,
            "seed": self.seed,
            "count": self.count,
            "drawing_version": DRAWING_VERSION,
        }

    def catalog(self) -> DigitCatalog:
        """Return ids, labels and writers.

        Returns
        -------
        DigitCatalog
            Ids 0 to count - 1 in order, labels in runs of 14, writers in runs of 140.
        """
        ids = np.arange(self.count, dtype=np.int64)
        return DigitCatalog(ids, ids % _PER_WRITER // _PER_CLASS, ids // _PER_WRITER)

    def hand(self, writer: int) -> WriterStyle:
        """Return the traits of a writer, counted from 0; all digits of the writer share them."""
        return draw_style(keyed_random.KeyedRng(_HAND, self.seed, writer))

    def image(self, digit_id: int) -> DigitImage:
        """Draw one digit, 500 x 500 px.

        Raises
        ------
        InputError
            When there is no digit of that id.
        TypeError
            When `digit_id` is not an integer.
        """
        digit_id = index(digit_id)
        require_known(digit_id, self.count, "the synthetic source")
        writer, label = digit_id // _PER_WRITER, digit_id % _PER_WRITER // _PER_CLASS
        style, rng = self.hand(writer), keyed_random.KeyedRng(_DIGIT, self.seed, digit_id)
        height_px = style.height_px * (1.0 + _SIZE_JITTER * style.jitter * rng.approx_normal())
        pen_px = style.pen_px * (1.0 + _SIZE_JITTER * style.jitter * rng.approx_normal())
        class_noise = keyed_random.KeyedRng(_CLASS_NOISE, self.seed, label)
        choice = choose_allograph(label, writer, class_noise, rng, style.fidelity)
        writer_noise = keyed_random.KeyedRng(_WRITER_NOISE, self.seed, writer, label, choice)
        vary = variation(writer_noise, rng, style.jitter, DIGIT_STYLES[label][2])
        style = style_for_digit(style, label, vary)
        shape, _ = allographs.ALLOGRAPHS[label][choice]
        # The width of the pen as a share of the height between middle lines, larger in narrow hands.
        strokes = shape(vary, pen_px / (height_px - pen_px) / min(style.aspect, 1.0))
        paths = page_layout.on_page(strokes, style, height_px, pen_px, vary, rng)
        # Ink has a stream of its own, so that it does not depend on how many numbers the shape took.
        pixels = inking.ink_paths(paths, pen_px, style, keyed_random.KeyedRng(_INK, self.seed, digit_id))
        return DigitImage(digit_id, label, pixels, writer)
