"""The embedded digit source: handwriting drawn by procedure, without any download."""

from __future__ import annotations

from dataclasses import dataclass
from operator import index

import numpy as np

from mnist3d.sources import DigitCatalog, DigitImage
from mnist3d.sources.handwriting.dice import Dice
from mnist3d.sources.handwriting.glyphs import ALLOGRAPHS, Variation, choose_allograph
from mnist3d.sources.handwriting.hand import Hand, hand_of
from mnist3d.sources.handwriting.pen import draw
from mnist3d.sources.handwriting.pose import on_page
from mnist3d.sources.handwriting.shape import Stroke
from tactile_toolkit.errors import InputError

__all__ = ["DRAWING_VERSION", "HWD_PLUS_COUNT", "SyntheticSource"]

DRAWING_VERSION = 1
"""Raised whenever the same seed and id would give other pixels than before."""

HWD_PLUS_COUNT = 13_580
"""Number of digits of HWD+: 97 writers with 140 digits each (Beaulac and Rosenthal 2022)."""

_PER_CLASS = 14
_PER_WRITER = 10 * _PER_CLASS
_HAND, _FASHION, _HABIT, _DIGIT, _INK = range(5)
"""First words of the keys of the random streams."""
_SIZE_JITTER = 0.06
"""Relative deviation of height and pen width between the digits of a writer whose jitter is 1."""


@dataclass(frozen=True, slots=True)
class SyntheticSource:
    """Digits in procedural handwriting, laid out like HWD+.

    Every writer writes 140 digits in a row, 14 of each class, in one stable hand. An image is a pure
    function of seed and id: the same bytes in any order, process or machine.

    Parameters
    ----------
    seed : int
        Non-negative; another seed gives other writers.
    count : int
        Number of digits, at least 1. A larger count only adds writers; the first digits stay the same.

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

    seed: int = 0
    count: int = HWD_PLUS_COUNT

    def __post_init__(self) -> None:
        if self.seed < 0:
            msg = f"the seed of the synthetic source is {self.seed}; expected 0 or more; next: choose another"
            raise InputError(msg)
        if self.count < 1:
            msg = (
                f"the synthetic source was asked for {self.count} digits; expected 1 or more; "
                f"next: choose a count such as {HWD_PLUS_COUNT}, that of HWD+"
            )
            raise InputError(msg)

    @property
    def name(self) -> str:
        """Word that selects this source on the command line."""
        return "synthetic"

    def fingerprint(self) -> dict[str, object]:
        """Return name, seed, count and the version of the drawing."""
        return {
            "name": self.name,
            "seed": int(self.seed),
            "count": int(self.count),
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

    def hand(self, writer: int) -> Hand:
        """Return the traits of a writer.

        Parameters
        ----------
        writer : int
            0 or more.

        Returns
        -------
        Hand
            Slant, proportions, pen and habits, the same for all digits of this writer.
        """
        return hand_of(Dice(_HAND, self.seed, writer))

    def image(self, digit_id: int) -> DigitImage:
        """Draw one digit.

        Parameters
        ----------
        digit_id : int
            From 0 to ``count - 1``.

        Returns
        -------
        DigitImage
            Pixels uint8 of shape (500, 500), 0 is ink and 255 is paper.

        Raises
        ------
        InputError
            When there is no digit of that id.
        TypeError
            When `digit_id` is not an integer.
        """
        digit_id = index(digit_id)
        if not 0 <= digit_id < self.count:
            msg = (
                f"the synthetic source has no digit {digit_id}; expected an id from 0 to {self.count - 1}; "
                "next: choose such an id or raise the source's count"
            )
            raise InputError(msg)
        writer, label = digit_id // _PER_WRITER, digit_id % _PER_WRITER // _PER_CLASS
        hand, dice = self.hand(writer), Dice(_DIGIT, self.seed, digit_id)
        height_px = hand.height_px * (1.0 + _SIZE_JITTER * hand.jitter * dice.bell())
        pen_px = hand.pen_px * (1.0 + _SIZE_JITTER * hand.jitter * dice.bell())
        strokes = self._strokes(writer, label, hand, _share(pen_px, height_px, hand.aspect), dice)
        paths = on_page(strokes, hand, height_px, pen_px, dice)
        pixels = draw(paths, pen_px, hand, Dice(_INK, self.seed, digit_id))
        return DigitImage(digit_id, label, pixels, writer)

    def _strokes(self, writer: int, label: int, hand: Hand, pen: float, dice: Dice) -> list[Stroke]:
        fashion = Dice(_FASHION, self.seed, label)
        choice = choose_allograph(label, writer, fashion, dice, hand.fidelity)
        vary = Variation(Dice(_HABIT, self.seed, writer, label, choice), dice, hand.jitter)
        shape, _ = ALLOGRAPHS[label][choice]
        return shape(vary, pen)


def _share(pen_px: float, height_px: float, aspect: float) -> float:
    """Return the pen's width as a share of the height between middle lines, larger in narrow hands."""
    return pen_px / (height_px - pen_px) / min(aspect, 1.0)
