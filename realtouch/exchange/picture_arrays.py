"""Arrays from other programs: pictures with a channel axis, and columns with a row for each picture.

Arrays of 8 bits are taken as they are. Of all others, every value is looked at before anything is made: only
what 8 bits hold without loss is converted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from realtouch import importing
from tactile_toolkit import bounds, errors, touch, wording
from tactile_toolkit.array_types import AnyArray, Floating, UInt8

_CHANNELS = (1, 3)
_MAX_LEVEL = 255
# What values may be multiples of, the first that fits: of floats 1/255 or 1, of integers 1, 257 or 256.
_DIVISORS = {"f": (1 / _MAX_LEVEL, 1.0), "u": (1.0, 257.0, 256.0), "i": (1.0, 257.0, 256.0)}
_COMPRESSION = 8  # how much better than other files arrays of pictures may compress
_MAX_UNSTORED = 20_000  # pictures that may be stored in next to nothing
_MIN_PICTURE_BYTES = 64
_MIN_TOLERANCE = 1e-3  # levels; what single precision rounds off
_MAX_NUMBERS = 256  # that are said of a picture in one array
_LARGEST_LETTER = 0x10FFFF
_SURROGATES = (0xD800, 0xDFFF)


@dataclass(frozen=True, eq=False)
class StoredArray:
    """An array of any format, whose metadata were checked: numbers, or text of a fixed length.

    ``block(n)`` reads the rows along the first axis from ``n * step`` on: ``step`` of them, or all that are
    left. ``stored_bytes()`` is about how many bytes are stored of the array.
    """

    place: str
    shape: tuple[int, ...]
    dtype: np.dtype[np.generic]
    step: int
    block: Callable[[int], AnyArray]
    stored_bytes: Callable[[], int]

    def refused(self, problem: str) -> errors.InputError:
        """Return the error for an array that cannot be used."""
        return errors.InputError(f"{self.place!r}: {problem}")

    def blocks(self) -> Iterator[AnyArray]:
        """Yield all rows, a block at a time."""
        return map(self.block, range(-(-self.shape[0] // self.step)))

    def rows(self) -> AnyArray:
        """Return all rows."""
        bounds.require_unpackable(math.prod(self.shape) * self.dtype.itemsize, f"{self.place}: {self.shape}")
        return np.concatenate([np.empty((0, *self.shape[1:]), self.dtype), *self.blocks()])


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
        pictures, stored = cls(array, sensor=sensor), array.stored_bytes()
        count = math.prod(array.shape)
        bounds.require_unpackable(
            count * array.dtype.itemsize,
            f"{array.place}: {array.shape}, {array.dtype},",
            _COMPRESSION * stored,
        )
        if not count or len(pictures.shape) != 4 or pictures.shape[3] not in _CHANNELS:
            raise array.refused(
                f"an array {array.shape}; expected pictures of 1 or 3 channels, first or last"
            )
        if array.dtype.kind not in _DIVISORS:
            raise array.refused(f"pictures of type {array.dtype}; expected numbers from 0 to 255")
        most = _MAX_UNSTORED + stored // _MIN_PICTURE_BYTES
        if len(pictures) > most:  # each takes time, though it need not take a byte
            raise array.refused(
                f"{wording.with_count(len(pictures), 'pictures')} in {stored:,} bytes; expected at most "
                f"{most:,}"
            )
        return pictures if array.dtype == np.uint8 else cls(array, pictures._lossless(), sensor)

    def __len__(self) -> int:
        return self.array.shape[0]

    @property
    def shape(self) -> tuple[int, ...]:
        """Pictures, height, width and channels, as far as there are such axes."""
        return self._upright(np.broadcast_to(np.uint8(0), self.array.shape)).shape

    def _upright(self, values: AnyArray) -> AnyArray:
        """Return the pictures of the sensor, with their channels last."""
        if self.sensor is not None:
            values = values[:, self.sensor]
        if values.ndim == 3:
            values = values[..., None]
        if values.ndim == 4 and values.shape[3] not in _CHANNELS and values.shape[1] in _CHANNELS:
            values = np.moveaxis(values, 1, -1)
        return values

    def pixels(self, number: int) -> UInt8:
        """Return the pictures of a block of the array, shape (n, H, W, 3); uint8."""
        found = self._upright(self.array.block(number))
        if found.dtype != np.uint8:
            found = np.rint(found / self.divisor).astype(np.uint8)
        return found.repeat(3 // found.shape[3], axis=3)

    def described(self) -> str:
        """Return what is done to the pictures; empty if they are taken as they are."""
        axes = len(self.array.shape) - (self.sensor is not None)
        words = ["channels first"] * (axes == 4 and self.array.shape[-1] not in _CHANNELS)
        words += ["one channel"] * (self.shape[3] == 1)
        if self.array.dtype != np.uint8:
            top = self.divisor * _MAX_LEVEL
            words.append(f"{self.array.dtype} from 0 to {top:g}, taken as levels from 0 to {_MAX_LEVEL}")
        return ", ".join([*words, "without loss"] if words else words)

    def _lossless(self) -> float:
        """Return what all values are multiples of; InputError if 8 bits would lose some."""
        dtype, tolerance = self.array.dtype, _MIN_TOLERANCE
        if dtype.kind == "f":
            tolerance = max(tolerance, float(np.finfo(dtype.name).eps) * _MAX_LEVEL)
        fitting = list(_DIVISORS[dtype.kind])
        low, high = math.inf, -math.inf
        for values in map(self._upright, self.array.blocks()):
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
    inside = (nearest >= 0) & (nearest <= _MAX_LEVEL)
    return bool((inside & (np.abs(levels - nearest) <= tolerance)).all())


OpenPictures = Callable[[str, str, str], PictureArray]
"""Opens the pictures that a touch is some of, given its ``home``, ``path`` and ``part``."""


def read_pictures(
    place: importing.PicturePlace, numbers: Sequence[int], opened: OpenPictures
) -> Iterator[bytes]:
    """Yield some pictures of an array, images as PNG, those of clips as JPEG; a block is read once."""
    pictures, pixels = opened(*place.file, place.part), lru_cache(1)(PictureArray.pixels)
    for number in numbers:
        block, row = divmod(number, pictures.array.step)
        yield touch.encode_image(pixels(pictures, block)[row], "jpeg" if place.frames else "png")


def described_pictures(touches: importing.FoundTouches, opened: OpenPictures) -> str:
    """Return what is done to the pictures of some touches; empty if they are taken as they are."""
    first = touches[0]
    words = [opened(first.home, first.path, first.part).described()]
    words += ["pictures of clips encoded as JPEG of quality 95"] * bool(first.frames)
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
        except errors.InputError:  # which names the place of the source
            if name in wanted:
                raise
            others.append(f"{name} (cannot be read)")
            continue
        width = math.prod(array.shape[1:])
        if array.shape[:1] == (frames,) and 0 < width <= _MAX_NUMBERS:
            size += frames * width * array.dtype.itemsize
            bounds.require_unpackable(size, f"{array.place}, with all arrays before it,")
            rows = _letters_checked(array).reshape(frames, width)
            found[name] = rows[:, 0] if width == 1 else rows
        elif name in wanted:
            raise array.refused(f"an array {array.shape}; expected {frames:,} rows of numbers, as frames")
        else:
            others.append(f"{name} {array.shape}")
    return found, others


def _letters_checked(array: StoredArray) -> AnyArray:
    """Return numbers as they are, and text as Unicode; InputError for text that is not."""
    rows = array.rows()
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
