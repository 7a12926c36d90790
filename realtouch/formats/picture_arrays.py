"""Arrays from other programs: pictures with a channel axis, and columns with a row for each picture.

Arrays of 8 bits are taken as they are. Every value of another array is checked before a picture is made: only
values that 8 bits hold without loss are converted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Literal

import numpy as np
import pyarrow as pa

from realtouch.importing import import_options, source_files, source_touches
from tactile_toolkit import cache, errors, store, touch, wording
from tactile_toolkit.columns import column_types
from tactile_toolkit.value_types import AnyArray, Floating, UInt8

_CHANNELS = (1, 3)
_MAX_LEVEL = 255
# Values may be multiples of one of these; the first that fits is taken.
_DIVISORS = {"f": (1 / _MAX_LEVEL, 1.0), "u": (1.0, 257.0, 256.0), "i": (1.0, 257.0, 256.0)}
_COMPRESSION = 8  # arrays of pictures may compress this many times better than other files
_MAX_UNSTORED = 20_000  # pictures that may take almost no bytes
_MIN_PICTURE_BYTES = 64
_MIN_TOLERANCE = 1e-3  # levels; rounding errors of single precision
_ROWS_TRIED = 8
_MAX_NUMBERS = 256  # for each picture in one array
_LAST_CODE_POINT = 0x10FFFF
_SURROGATES = (0xD800, 0xDFFF)


@dataclass(frozen=True, eq=False)
class StoredArray:
    """An array of any format with checked metadata: numbers, or text of a fixed length.

    ``block(n)`` reads ``step`` rows along the first axis from ``n * step`` on, or the remaining ones.
    ``stored_bytes()`` returns the approximate size of the stored array in bytes.
    """

    address: str
    shape: tuple[int, ...]
    dtype: np.dtype[np.generic]
    step: int
    block: Callable[[int], AnyArray]
    stored_bytes: Callable[[], int]

    def refused(self, problem: str) -> errors.InputError:
        """Return the error for an array that cannot be used."""
        return errors.InputError(f"{self.address!r}: {problem}")

    def blocks(self) -> Iterator[AnyArray]:
        """Yield all rows, a block at a time."""
        return map(self.block, range(-(-self.shape[0] // self.step)))

    def rows(self) -> AnyArray:
        """Return all rows."""
        cache.require_unpackable(math.prod(self.shape) * self.dtype.itemsize, f"{self.address}: {self.shape}")
        return np.concatenate([np.empty((0, *self.shape[1:]), self.dtype), *self.blocks()])


@dataclass(frozen=True, eq=False)
class PictureArray:
    """Pictures along the first axis; values divided by ``divisor`` are levels from 0 to 255.

    ``sensor`` is the index along the second axis, if the array has pictures of several sensors.
    """

    array: StoredArray
    divisor: float = 1.0
    sensor: int | None = None

    @classmethod
    def of(cls, array: StoredArray, sensor: int | None = None) -> PictureArray:
        """Check an array; InputError unless it holds pictures that 8 bits can hold."""
        pictures = cls(array, sensor=sensor)
        stored = array.stored_bytes()
        count = math.prod(array.shape)
        cache.require_unpackable(
            count * array.dtype.itemsize,
            f"{array.address}: {array.shape}, {array.dtype},",
            _COMPRESSION * stored,
        )
        if not count or len(pictures.shape) != 4 or pictures.shape[3] not in _CHANNELS:
            raise array.refused(
                f"an array {array.shape}; expected pictures of 1 or 3 channels, first or last"
            )
        if array.dtype.kind not in _DIVISORS:
            raise array.refused(f"pictures of type {array.dtype}; expected numbers from 0 to 255")
        most = _MAX_UNSTORED + stored // _MIN_PICTURE_BYTES
        if len(pictures) > most:  # each takes time, even if it takes no bytes
            raise array.refused(
                f"{wording.with_count(len(pictures), 'pictures')} in {stored:,} bytes; expected at most "
                f"{most:,}"
            )
        if array.dtype == np.uint8:
            return pictures
        return cls(array, pictures._lossless_divisor(), sensor)

    def __len__(self) -> int:
        return self.array.shape[0]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of pictures, height, width and channels, as far as there are such axes."""
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
        pictures = self._upright(self.array.block(number))
        if pictures.dtype != np.uint8:
            pictures = np.rint(pictures / self.divisor).astype(np.uint8)
        return pictures.repeat(3 // pictures.shape[3], axis=3)

    @property
    def picture_bytes(self) -> int:
        """Approximate size of a picture in bytes."""
        return math.prod(self.shape[1:])

    def contents(self, numbers: Iterable[int], *, is_clip: bool) -> Iterator[bytes | errors.ItemError]:
        """Yield pictures by their numbers, as PNG or, for clips, JPEG; the last block is kept."""
        pixels = lru_cache(1)(self.pixels)
        encoding: Literal["jpeg", "png"] = "jpeg" if is_clip else "png"
        for number in numbers:
            block, row = divmod(number, self.array.step)
            yield touch.encode_image(pixels(block)[row], encoding)

    @property
    def conversions(self) -> tuple[str, str]:
        """How the pictures are converted, as single images and in clips; empty if they are kept."""
        axes = len(self.array.shape) - (self.sensor is not None)
        top = self.divisor * _MAX_LEVEL
        applies = {
            "channels first": axes == 4 and self.array.shape[-1] not in _CHANNELS,
            "one channel": self.shape[3] == 1,
            f"{self.array.dtype} from 0 to {top:g}, taken as levels from 0 to {_MAX_LEVEL}": (
                self.array.dtype != np.uint8
            ),
        }
        words = [text for text, is_so in applies.items() if is_so]
        parts = [", ".join([*words, "without loss"])] if words else []
        return "".join(parts), "; ".join([*parts, "pictures of clips encoded as JPEG of quality 95"])

    def _lossless_divisor(self) -> float:
        """Return a number of which all values are multiples; InputError if 8 bits would lose some."""
        dtype = self.array.dtype
        tolerance = _MIN_TOLERANCE
        if dtype.kind == "f":
            tolerance = max(tolerance, float(np.finfo(dtype.name).eps) * _MAX_LEVEL)
        fitting = list(_DIVISORS[dtype.kind])
        low = math.inf
        high = -math.inf
        for values in map(self._upright, self.array.blocks()):
            low, high = np.minimum(low, values.min()), np.maximum(high, values.max())
            fitting = [divisor for divisor in fitting if _fits(values / divisor, tolerance)]
            if not fitting:
                raise self.array.refused(
                    f"pictures of type {dtype}, values from {low:g} to {high:g}; expected levels that 8 bits "
                    "hold without loss: integers from 0 to 255, floats from 0 to 1 or 0 to 255 made of them, "
                    "or 16 bits that are multiples of 256 or 257",
                )
        return fitting[0]


def _fits(levels: Floating, tolerance: float) -> bool:
    """Return whether values are integers from 0 to 255, within a tolerance; False for NaN."""
    nearest = np.rint(levels)
    inside = (nearest >= 0) & (nearest <= _MAX_LEVEL)
    return bool((inside & (np.abs(levels - nearest) <= tolerance)).all())


@dataclass(frozen=True, eq=False)
class EncodedPictures:
    """Pictures that a source holds as encoded bytes, one in each row.

    ``read(n)`` returns the bytes of a row; ItemError if there are none. ``picture_bytes`` is the approximate
    size of one.
    """

    address: str
    count: int
    picture_bytes: int
    read: Callable[[int], bytes]
    conversions = ("", "")

    def __len__(self) -> int:
        return self.count

    def checked(self) -> EncodedPictures:
        """Return the pictures; InputError if none of the first rows is a picture."""
        for number in range(min(len(self), _ROWS_TRIED)):
            with suppress(ValueError, errors.ItemError):
                touch.EncodedImage(touch.EncodedImage(self.read(number)).storable()[0]).size()
                return self
        raise errors.InputError(
            f"{self.address!r}: rows of bytes; expected pictures, encoded or as an array of pixels",
            next="name the pictures: --map image=PATH",
        )

    def contents(self, numbers: Iterable[int], *, is_clip: bool) -> Iterator[bytes | errors.ItemError]:
        """Yield the pictures with some numbers, unchanged."""
        for number in numbers:
            try:
                yield self.read(number)
            except errors.ItemError as error:
                yield error


Pictures = PictureArray | EncodedPictures
OpenPictures = Callable[[store.DataFolder, str, str], Pictures]
"""Opens the array with the pictures of a touch, given the opened source, the ``path`` and the ``part``."""


def read_contents(
    locations: Iterable[source_touches.PictureLocation], opened: OpenPictures
) -> Iterator[bytes | errors.ItemError]:
    """Yield pictures of arrays, in order: images as PNG, pictures of clips as JPEG."""
    return source_files.pictures_by_file(partial(_read_pictures, opened), locations)


def _read_pictures(
    opened: OpenPictures,
    home: store.DataFolder,
    picture: source_touches.PictureLocation,
    numbers: Sequence[int],
) -> Iterator[bytes | errors.ItemError]:
    """Yield pictures of an array by their numbers."""
    return opened(home, picture.path, picture.part).contents(numbers, is_clip=picture.frames > 0)


def columns_of(
    arrays: Mapping[str, Callable[[], StoredArray]],
    frames: int,
    stated: import_options.ImportColumns,
) -> tuple[dict[str, pa.Array], list[str]]:
    """Read fields of each picture: numbers and texts, or lists of them for vectors and matrices.

    ``arrays`` holds functions that open arrays, by name. Also returns the names of the arrays that are left
    out, each with its shape or the reason. Raises InputError if such an array is ``stated``.
    """
    required = {*stated.found_in(arrays).names(), source_files.NUMBERED}
    columns: dict[str, pa.Array] = {}
    others = []
    size = 0
    for name, opened in arrays.items():
        try:
            array = opened()
        except errors.InputError:  # its message, which names the place of the source, is not kept
            if name in required:
                raise
            others.append(f"{name} (cannot be read)")
            continue
        width = math.prod(array.shape[1:])
        if array.shape[:1] == (frames,) and 0 < width <= _MAX_NUMBERS:
            size += frames * width * array.dtype.itemsize
            cache.require_unpackable(size, f"{array.address}, with all arrays before it,")
            rows = _rows_with_checked_text(array).reshape(frames, width)
            columns[name] = column_types.column_of(rows[:, 0] if width == 1 else rows)
        elif name in required:
            raise array.refused(f"an array {array.shape}; expected {frames:,} rows of numbers, as frames")
        else:
            others.append(f"{name} {array.shape}")
    return columns, others


def _rows_with_checked_text(array: StoredArray) -> AnyArray:
    """Return all rows, text as Unicode; InputError for text that is not Unicode."""
    rows = array.rows()
    try:
        if rows.dtype.kind == "S":
            rows = np.char.decode(rows, "utf-8")
    except UnicodeDecodeError as error:
        raise array.refused("bytes that are not UTF-8; expected text") from error
    if rows.dtype.kind == "U":
        points = np.ascontiguousarray(rows).view(np.uint32)
        low, high = _SURROGATES
        if points.max(initial=0) > _LAST_CODE_POINT or ((points >= low) & (points <= high)).any():
            raise array.refused("letters that are not Unicode; expected text")
    return rows
