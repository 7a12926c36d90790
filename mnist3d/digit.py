"""A digit image as every source hands it out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["DigitCatalog", "DigitImage", "NO_WRITER"]

NO_WRITER = -1
"""Writer number of digits whose writer is unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class DigitImage:
    """One handwritten digit.

    Attributes
    ----------
    id : int
        Number of the digit in its source (in HWD+: the row of the image array).
    label : int
        The digit written, 0 to 9.
    pixels : ndarray of uint8, shape (H, W)
        Grey levels, dark ink on light paper whatever the source stored: 0 is ink, 255 is paper. Row 0 is
        the top of the digit as it is read.
    writer : int
        Number of the writer in the source, or :data:`NO_WRITER`.
    """

    id: int
    label: int
    pixels: NDArray[np.uint8]
    writer: int = NO_WRITER


@dataclass(frozen=True, slots=True, eq=False)
class DigitCatalog:
    """What a source holds, without its pixels: three arrays of the same length.

    Attributes
    ----------
    ids : ndarray of int64, shape (N,)
        Distinct, in increasing order.
    labels : ndarray of int64, shape (N,)
        Digit of each id, 0 to 9.
    writers : ndarray of int64, shape (N,)
        Writer of each id, or :data:`NO_WRITER`.
    """

    ids: NDArray[np.int64]
    labels: NDArray[np.int64]
    writers: NDArray[np.int64]

    def __len__(self) -> int:
        """Count the digits of the source."""
        return len(self.ids)
