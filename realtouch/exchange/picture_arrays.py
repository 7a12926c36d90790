"""Pictures in an array of others: which axis holds the channels, and which values are levels of 8 bits.

Arrays of 8 bits are taken as they are. Of all others, every value is looked at before anything is made: only
what 8 bits hold without loss is converted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from realtouch.exchange.zarr_arrays import ZarrArray
from tactile_toolkit.array_types import Floating, UInt8
from tactile_toolkit.bounds import require_unpackable

_CHANNELS = (1, 3)
_MOST_LEVEL = 255
# What values may be multiples of, the first that fits: of floats 1/255 or 1, of integers 1, 257 or 256.
_DIVISORS = {"f": (1 / _MOST_LEVEL, 1.0), "u": (1.0, 257.0, 256.0), "i": (1.0, 257.0, 256.0), "b": ()}
_COMPRESSION = 8  # how much better than other files arrays of pictures may compress
_MOST_UNSTORED = 20_000  # pictures that may be stored in next to nothing
_LEAST_PICTURE_BYTES = 64
_LEAST_TOLERANCE = 1e-3  # levels; what single precision rounds off


@dataclass(frozen=True, eq=False)
class PictureArray:
    """Pictures along the first axis; values divided by ``divisor`` are levels from 0 to 255."""

    array: ZarrArray
    divisor: float

    @classmethod
    def of(cls, array: ZarrArray) -> PictureArray:
        """Look at an array; InputError for one that does not hold pictures of 8 bits."""
        pictures = cls(array, 1.0)
        shape = pictures.shape
        what = f"{array.group.place}/{array.path}: {array.shape}, {array.dtype},"
        stored = array.stored_bytes()
        require_unpackable(math.prod(array.shape) * array.dtype.itemsize, what, _COMPRESSION * stored)
        if len(shape) != 4 or not math.prod(shape) or shape[3] not in _CHANNELS:
            raise array.group.refused(
                array.path, f"an array {array.shape}; expected pictures of 1 or 3 channels, first or last"
            )
        most = _MOST_UNSTORED + stored // _LEAST_PICTURE_BYTES
        if len(pictures) > most:  # each takes time, though it need not take a byte
            raise array.group.refused(
                array.path, f"{len(pictures):,} pictures in {stored:,} bytes; expected at most {most:,}"
            )
        return pictures if array.dtype == np.uint8 else cls(array, pictures._lossless())

    def __len__(self) -> int:
        return self.array.shape[0]

    @property
    def _channel_axis(self) -> int:
        """Axis of the channels, where they come before height and width; else the last."""
        shape = self.array.shape
        if len(shape) == 4 and shape[3] not in _CHANNELS and shape[1] in _CHANNELS:
            return 1
        return -1

    @property
    def shape(self) -> tuple[int, ...]:
        """Pictures, height, width and channels, as far as there are such axes."""
        shape = self.array.shape
        if len(shape) == 3:
            return (*shape, 1)
        return (shape[0], *shape[2:], shape[1]) if self._channel_axis == 1 else shape

    def pixels(self, start: int, stop: int) -> UInt8:
        """Return some pictures, shape (n, H, W, 3), or (n, H, W) of one channel; uint8, contiguous."""
        found = self.array.rows(start, stop)
        if found.dtype != np.uint8:
            found = np.rint(found / self.divisor).astype(np.uint8)
        found = np.moveaxis(found, self._channel_axis, -1)
        if self.shape[3] == 1:
            found = found.reshape(found.shape[:3])
        return np.ascontiguousarray(found)

    def described(self) -> str:
        """Return what is done to the pictures; empty if they are taken as they are."""
        words = ["channels first"] * (self._channel_axis == 1) + ["one channel"] * (self.shape[3] == 1)
        if self.array.dtype != np.uint8:
            top = self.divisor * _MOST_LEVEL
            words.append(f"{self.array.dtype} from 0 to {top:g}, taken as levels from 0 to {_MOST_LEVEL}")
        return ", ".join(words)

    def _lossless(self) -> float:
        """Return what all values are multiples of; InputError if 8 bits would lose some."""
        dtype, step = self.array.dtype, self.array.chunks[0]
        tolerance = _LEAST_TOLERANCE
        if dtype.kind == "f":
            tolerance = max(tolerance, float(np.finfo(dtype).eps) * _MOST_LEVEL)
        fitting = list(_DIVISORS[dtype.kind])
        low, high = math.inf, -math.inf
        for start in range(0, len(self), step):
            values = self.array.rows(start, min(start + step, len(self)))
            low, high = np.minimum(low, values.min()), np.maximum(high, values.max())
            fitting = [each for each in fitting if _fits(values / each, tolerance)]
            if not fitting:
                raise self.array.group.refused(
                    self.array.path,
                    f"pictures of type {dtype}, values from {low:g} to {high:g}; expected levels that 8 bits "
                    "hold without loss: integers from 0 to 255, floats from 0 to 1 or 0 to 255 made of them, "
                    "or 16 bits that are multiples of 256 or 257",
                )
        return fitting[0]


def _fits(levels: Floating, tolerance: float) -> bool:
    """Return whether values are integers from 0 to 255, as far as rounding shows; False for NaN."""
    nearest = np.rint(levels)
    inside = (nearest >= 0) & (nearest <= _MOST_LEVEL)
    return bool((inside & (np.abs(levels - nearest) <= tolerance)).all())
