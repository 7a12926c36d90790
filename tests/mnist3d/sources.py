"""A source that fails on purpose, for tests of runs, and messages of sources that cannot be used."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from mnist3d.sources import DigitCatalog, DigitImage, DigitSource
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.errors import InputError, ItemError

BLANK, FULL, UNREADABLE = 3, 11, 17


@dataclass(frozen=True)
class FlawedSource:
    """Thirty synthetic digits, three per class, of which three cannot be used."""

    seed: int = 0

    @property
    def name(self) -> str:
        return "flawed"

    def fingerprint(self) -> dict[str, object]:
        return {"name": self.name, "seed": self.seed}

    def catalog(self) -> DigitCatalog:
        ids = np.arange(30, dtype=np.int64)
        return DigitCatalog(ids, ids // 3, ids % 3)

    def image(self, digit_id: int) -> DigitImage:
        label = digit_id // 3
        if digit_id == UNREADABLE:
            raise ItemError("unreadable", f"image {digit_id} cannot be read")
        if digit_id in (BLANK, FULL):
            grey = 255 if digit_id == BLANK else 0
            return DigitImage(digit_id, label, np.full((500, 500), grey, np.uint8), digit_id % 3)
        drawn = SyntheticSource(self.seed).image(label * 14 + digit_id % 3)
        return DigitImage(digit_id, label, drawn.pixels, digit_id % 3)


def refusal(made: DigitSource) -> str:
    """Return the message with which a source refuses its files."""
    with pytest.raises(InputError) as caught:
        made.catalog()
    message = str(caught.value)
    assert "expected" in message
    assert "; next: " in message
    return message
