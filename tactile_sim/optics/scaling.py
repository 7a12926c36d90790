"""Pictures in another size than they were rendered in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.touch.jpeg import resized

__all__ = ["scaled"]


def scaled(pictures: NDArray[np.uint8], size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """Scale pictures (n, H, W, 3) to the size that is wanted, where they have another."""
    width, height = size_px
    if pictures.shape[1:3] == (height, width):
        return pictures
    return np.stack([resized(each, width, height) for each in pictures])
