"""Arrays of others: pictures, of which some axis holds the channels, and what is said of each picture.

Arrays of 8 bits are taken as they are. Of all others, every value is looked at before anything is made: only
what 8 bits hold without loss is converted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from realtouch.exchange.found_touches import FoundTouch
from tactile_toolkit.array_types import AnyArray, Floating, UInt8
from tactile_toolkit.bounds import require_unpackable
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch import encode_image

_CHANNELS = (1, 3)
_MOST_LEVEL = 255
# What values may be multiples of, the first that fits: of floats 1/255 or 1, of integers 1, 257 or 256.
_DIVISORS = {"f": (1 / _MOST_LEVEL, 1.0), "u": (1.0, 257.0, 256.0), "i": (1.0, 257.0, 256.0)}
_COMPRESSION = 8  # how much better than other files arrays of pictures may compress
_MOST_UNSTORED = 20_000  # pictures that may be stored in next to nothing
_LEAST_PICTURE_BYTES = 64
_LEAST_TOLERANCE = 1e-3  # levels; what single precision rounds off
_MOST_NUMBERS = 256  # that are said of a picture in one array
_LARGEST_LETTER = 0x10FFFF
_SURROGATES = (0xD800, 0xDFFF)


class StoredArray(Protocol):
    """An array of any format, whose metadata were checked."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Length of each axis."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of the values: numbers, or text of a fixed length."""

    @property
    def place(self) -> str:
        """Address of the array, for messages."""

    @property
    def step(self) -> int:
        """How many rows are read in one go."""

    def rows(self, start: int, stop: int) -> AnyArray:
        """Return what lies at some places along the first axis, shape (stop - start, ...)."""

    def stored_bytes(self) -> int:
        """Return about how many bytes are stored of the array."""

    def refused(self, problem: str) -> InputError:
        """Return the error for an array that cannot be used."""


@dataclass(frozen=True, eq=False)
class PictureArray:
    """Pictures along the first axis; values divided by ``divisor`` are levels from 0 to 255.

    ``sensor`` is the number along the second axis, of pictures of several sensors.
    """

    array: StoredArray
    divisor: float = 1.0
    sensor: int | None = None

    @classmethod
    def of(cls, array: StoredArray, sensor: int | None = None) -> PictureArray:
        """Look at an array; InputError for one that does not hold pictures of 8 bits."""
        pictures = cls(array, sensor=sensor)
        shape = pictures.shape
        what = f"{array.place}: {array.shape}, {array.dtype},"
        stored = array.stored_bytes()
        require_unpackable(math.prod(array.shape) * array.dtype.itemsize, what, _COMPRESSION * stored)
        if len(shape) != 4 or not math.prod(shape) or shape[3] not in _CHANNELS:
            raise array.refused(
                f"an array {array.shape}; expected pictures of 1 or 3 channels, first or last"
            )
        if array.dtype.kind not in _DIVISORS:
            raise array.refused(f"pictures of type {array.dtype}; expected numbers from 0 to 255")
        most = _MOST_UNSTORED + stored // _LEAST_PICTURE_BYTES
        if len(pictures) > most:  # each takes time, though it need not take a byte
            raise array.refused(f"{len(pictures):,} pictures in {stored:,} bytes; expected at most {most:,}")
        return pictures if array.dtype == np.uint8 else cls(array, pictures._lossless(), sensor)

    def __len__(self) -> int:
        return self.array.shape[0]

    @property
    def _stored_shape(self) -> tuple[int, ...]:
        shape = self.array.shape
        return shape if self.sensor is None else (shape[0], *shape[2:])

    def _rows(self, start: int, stop: int) -> AnyArray:
        found = self.array.rows(start, stop)
        return found if self.sensor is None else found[:, self.sensor]

    @property
    def _channel_axis(self) -> int:
        """Axis of the channels, where they come before height and width; else the last."""
        shape = self._stored_shape
        if len(shape) == 4 and shape[3] not in _CHANNELS and shape[1] in _CHANNELS:
            return 1
        return -1

    @property
    def shape(self) -> tuple[int, ...]:
        """Pictures, height, width and channels, as far as there are such axes."""
        shape = self._stored_shape
        if len(shape) == 3:
            return (*shape, 1)
        return (shape[0], *shape[2:], shape[1]) if self._channel_axis == 1 else shape

    def pixels(self, start: int, stop: int) -> UInt8:
        """Return some pictures, shape (n, H, W, 3), or (n, H, W) of one channel; uint8, contiguous."""
        found = self._rows(start, stop)
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
        return ", ".join([*words, "without loss"] if words else words)

    def _lossless(self) -> float:
        """Return what all values are multiples of; InputError if 8 bits would lose some."""
        dtype, step = self.array.dtype, self.array.step
        tolerance = _LEAST_TOLERANCE
        if dtype.kind == "f":
            tolerance = max(tolerance, float(np.finfo(dtype).eps) * _MOST_LEVEL)
        fitting = list(_DIVISORS[dtype.kind])
        low, high = math.inf, -math.inf
        for start in range(0, len(self), step):
            values = self._rows(start, min(start + step, len(self)))
            low, high = np.minimum(low, values.min()), np.maximum(high, values.max())
            fitting = [each for each in fitting if _fits(values / each, tolerance)]
            if not fitting:
                raise self.array.refused(
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


def encoded_pictures(
    items: Iterable[FoundTouch], opened: Callable[[FoundTouch], PictureArray]
) -> Iterator[bytes]:
    """Yield each picture of some items in order, images as PNG, those of clips as JPEG.

    A chunk is unpacked once.
    """
    shown, held, chunk = ("", "", ""), range(0), np.zeros(0, np.uint8)
    for item in items:
        if shown != (item.home, item.path, item.part):
            shown, held, pictures = (item.home, item.path, item.part), range(0), opened(item)
        for number in range(item.start, item.start + max(1, item.frames)):
            if number not in held:
                first = number - number % pictures.array.step
                held = range(first, min(first + pictures.array.step, len(pictures)))
                chunk = pictures.pixels(held.start, held.stop)
            pixels = chunk[number - held.start]
            if not item.frames:
                yield encode_image(pixels, "png")
            else:
                yield encode_image(pixels if pixels.ndim == 3 else pixels[..., None].repeat(3, axis=2))


def described_pictures(items: Sequence[FoundTouch], opened: Callable[[FoundTouch], PictureArray]) -> str:
    """Return what is done to the pictures of some items; empty if they are taken as they are."""
    words = [opened(items[0]).described()]
    if items[0].frames:
        words.append("pictures of clips encoded as JPEG of quality 95")
    return "; ".join(filter(None, words))


def columns_of(
    arrays: Mapping[str, Callable[[], StoredArray]], frames: int, wanted: Collection[str]
) -> tuple[dict[str, AnyArray], list[str]]:
    """Read what is said of each picture: shape (frames,), or (frames, k) of vectors and matrices.

    Takes functions that open arrays, by name. Returns what is left out, too, with its shape. InputError if
    one of those is wanted.
    """
    found: dict[str, AnyArray] = {}
    others, size = [], 0
    for name, opened in arrays.items():
        try:
            array = opened()
        except InputError:  # which names the place of the source
            if name in wanted:
                raise
            others.append(f"{name} (cannot be read)")
            continue
        width = math.prod(array.shape[1:])
        if array.shape[:1] == (frames,) and 0 < width <= _MOST_NUMBERS:
            size += frames * width * array.dtype.itemsize
            require_unpackable(size, f"{array.place}, with all arrays before it,")
            rows = _letters_checked(array, array.rows(0, frames)).reshape(frames, width)
            found[name] = rows[:, 0] if width == 1 else rows
        elif name in wanted:
            raise array.refused(f"an array {array.shape}; expected {frames:,} rows of numbers, as frames")
        else:
            others.append(f"{name} {array.shape}")
    return found, others


def _letters_checked(array: StoredArray, rows: AnyArray) -> AnyArray:
    """Return numbers as they are, and text as Unicode; InputError for text that is not."""
    try:
        if rows.dtype.kind == "S":
            rows = np.char.decode(rows, "utf-8")
    except UnicodeDecodeError as error:
        raise array.refused("bytes that are not UTF-8; expected text") from error
    if rows.dtype.kind == "U":
        letters = np.ascontiguousarray(rows).view(np.uint32)
        low, high = _SURROGATES
        if letters.max(initial=0) > _LARGEST_LETTER or ((letters >= low) & (letters <= high)).any():
            raise array.refused("letters that are not Unicode; expected text")
    return rows
