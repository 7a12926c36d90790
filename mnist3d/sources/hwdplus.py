"""HWD+ as its authors publish it: an array of images and an array about their writers, in ``.npy`` files."""

from __future__ import annotations

import hashlib
import re
import tokenize
import warnings
from dataclasses import dataclass
from functools import lru_cache
from math import prod
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mnist3d.sources import NO_WRITER, DigitCatalog, DigitImage
from mnist3d.sources.canvas import as_grey, fit
from tactile_toolkit.errors import InputError, ItemError

__all__ = ["HwdPlusSource", "NpyFile", "open_npy"]

_SCALE_SAMPLE = 16
_FINGERPRINT_SAMPLE = 64
# At most 18 figures: the number fits 64 bits.
_INTEGER = re.compile(r"\s*([+-]?[0-9]{1,18})(\.0*)?\s*")
_MAGIC = b"\x93NUMPY"


@dataclass(frozen=True, slots=True)
class HwdPlusSource:
    """The two ``.npy`` files of HWD+ (Beaulac & Rosenthal 2022), or of anything in the same layout.

    The image array is mapped one image at a time, so memory does not grow with the file. Integers are grey
    levels 0 to 255 whatever their width. Floats run from 0 to 1 or from 0 to 255: the file is taken to be the
    first when the median of the largest values of 16 evenly spaced images (paper is the brightest thing on
    each) is at most 1. That is decided once per file, never per image. Images of another size than
    500 x 500 px are fitted into it.

    Parameters
    ----------
    images : str
        ``Images(500x500).npy``: shape (N, 500, 500), dark ink on light paper, any integer or float dtype.
    writer_info : str
        ``WriterInfo.npy``: one row per image, column 0 is the digit. Numbers, or strings of digits.
    writer_column : int, optional
        Column of `writer_info` that numbers the writer; by default the writer is unknown.

    Notes
    -----
    The id of an image is its row. An array in Fortran order works but is slow to read, as the pixels of one
    image lie all over the file.
    """

    name: ClassVar[str] = "hwdplus"
    """Word that selects this source on the command line."""

    images: str
    writer_info: str
    writer_column: int | None = None

    def catalog(self) -> DigitCatalog:
        """Check both files and return ids, labels and writers.

        Raises InputError when a file is missing, damaged or of another shape or type, when the two differ in
        rows, or when a label is not a whole number from 0 to 9.
        """
        stack, (labels, writers) = self._stack(), self._people()
        if len(labels) != stack.shape[0]:
            message = (
                f"{self.writer_info}: found {len(labels)} rows, expected {stack.shape[0]}, one for each "
                f"image of {self.images}; next: take both files from the same download"
            )
            raise InputError(message)
        return DigitCatalog(np.arange(len(labels)), labels, writers)

    def image(self, digit_id: int) -> DigitImage:
        """Read the image of row `digit_id`, and nothing else of the file.

        Raises ItemError ``"unknown-id"``, ``"not-finite"`` (NaN or infinite pixels) or ``"bad-pixels"``
        (values outside the grey scale of the file).
        """
        stack, (labels, writers) = self._stack(), self._people()
        where = f"{self.images}, row {digit_id}"
        if not 0 <= digit_id < min(stack.shape[0], len(labels)):
            reason = "unknown-id"
            message = f"{where}: no such image, expected rows 0 to {stack.shape[0] - 1}; next: check the id"
            raise ItemError(reason, message)
        pixels = fit(as_grey(stack.row(digit_id), _full_scale(stack), where))
        return DigitImage(digit_id, int(labels[digit_id]), pixels, int(writers[digit_id]))

    def fingerprint(self) -> dict[str, object]:
        """Return dtype and shape, and SHA-256 of labels, writers and 64 evenly spaced images.

        A sample, because hashing gigabytes would take longer than the first shard.

        Raises InputError when a file cannot be used; see :meth:`catalog`.
        """
        stack, (labels, writers) = self._stack(), self._people()
        sample = hashlib.sha256()
        for row in _evenly_spaced(stack.shape[0], _FINGERPRINT_SAMPLE):
            sample.update(np.ascontiguousarray(stack.row(row)).tobytes())
        return {
            "name": self.name,
            "dtype": stack.dtype.str,
            "shape": list(stack.shape),
            "labels_sha256": hashlib.sha256(labels.tobytes()).hexdigest(),
            "writers_sha256": hashlib.sha256(writers.tobytes()).hexdigest(),
            "images_sample_sha256": sample.hexdigest(),
        }

    def _stack(self) -> NpyFile:
        file = open_npy(self.images)
        shape = file.shape
        squarish = len(shape) == 3 and min(shape) > 0 and max(shape[1:]) <= 1.5 * min(shape[1:])
        if squarish and file.dtype.kind in "biuf":
            return file
        message = (
            f"{file.path}: found shape {shape} of {file.dtype}, expected (N, 500, 500) of integers or "
            "floats; next: give the file 'Images(500x500).npy' of HWD+"
        )
        raise InputError(message)

    def _people(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        return _labels_and_writers(open_npy(self.writer_info), self.writer_column)


# Keyed by the file's size and time too (both are part of NpyFile), so a replaced file is read again.
@lru_cache(maxsize=4)
def _full_scale(stack: NpyFile) -> float:
    if stack.dtype.kind in "iu":
        return 255.0
    if stack.dtype.kind == "b":
        return 1.0
    brightest = []
    # A median of several: a single image may be damaged, or hold no paper.
    for row in _evenly_spaced(stack.shape[0], _SCALE_SAMPLE):
        values = stack.row(row)
        finite = values[np.isfinite(values)]
        if finite.size:
            brightest.append(float(finite.max()))
    # Half a grey level of slack: rounding may have left white a little above 1.
    return 1.0 if brightest and float(np.median(brightest)) <= 1 + 0.5 / 255 else 255.0


def _evenly_spaced(count: int, wanted: int) -> list[int]:
    picks = np.linspace(0, count - 1, min(count, wanted))
    return [int(row) for row in np.rint(picks)]


@lru_cache(maxsize=4)
def _labels_and_writers(
    file: NpyFile, writer_column: int | None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    if len(file.shape) not in (1, 2) or min(file.shape) <= 0 or file.dtype.kind not in "biufUS":
        message = (
            f"{file.path}: found shape {file.shape} of {file.dtype}, expected one row per image with the "
            "digit in column 0, as numbers or strings of digits; next: give the file 'WriterInfo.npy' of HWD+"
        )
        raise InputError(message)
    table = file.read().reshape(file.shape[0], -1)
    labels = _int_column(table, 0, file.path)
    wrong = np.flatnonzero((labels < 0) | (labels > 9))
    if wrong.size:
        raise _bad_cell(file.path, int(wrong[0]), 0, labels[wrong[0]], "a digit from 0 to 9")
    writers = _writers(table, writer_column, file.path)
    for shared in (labels, writers):
        shared.flags.writeable = False
    return labels, writers


def _writers(table: NDArray[Any], writer_column: int | None, path: str) -> NDArray[np.int64]:
    if writer_column is None:
        return np.full(len(table), NO_WRITER, np.int64)
    width = table.shape[1]
    if not 1 <= writer_column < width:
        there = (
            f"expected 1 to {width - 1}" if width > 1 else "expected none, as there is no column of writers"
        )
        message = (
            f"{path}: writer column {writer_column} is not there, {there} (the file has {width} columns, "
            "column 0 is the digit); next: change --writer-column"
        )
        raise InputError(message)
    return _int_column(table, writer_column, path)


def _int_column(table: NDArray[Any], column: int, path: str) -> NDArray[np.int64]:
    cells = table[:, column]
    if cells.dtype.kind in "biu":
        return cells.astype(np.int64)
    if cells.dtype.kind == "f":
        # From 2**53 on a float no longer tells one whole number from the next.
        whole = np.isfinite(cells) & (np.rint(cells) == cells) & (np.abs(cells) < 2.0**53)
        numbers = np.where(whole, cells, 0).astype(np.int64)
    else:
        texts = cells if cells.dtype.kind == "U" else np.char.decode(cells, "ascii", "replace")
        found = [_INTEGER.fullmatch(str(text)) for text in texts]
        whole = np.array([match is not None for match in found])
        numbers = np.array([int(match[1]) if match else 0 for match in found], np.int64)
    if not whole.all():
        row = int(np.argmin(whole))
        raise _bad_cell(path, row, column, cells[row], "a whole number")
    return numbers


def _bad_cell(path: str, row: int, column: int, value: Any, expected: str) -> InputError:
    shown = value.item() if isinstance(value, np.generic) else value
    return InputError(
        f"{path}: row {row}, column {column}: found {shown!r}, expected {expected}; "
        "next: check that this file belongs to the images and is not damaged"
    )


@dataclass(frozen=True, slots=True)
class NpyFile:
    """What the header of a ``.npy`` file says, and the way to its numbers.

    In ``fortran`` order the first axis varies fastest; ``offset`` counts the bytes before the first number.
    The ``stamp`` (size in bytes, time of change in ns) and `path` identify the content for caches.
    """

    path: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    fortran: bool
    offset: int
    stamp: tuple[int, int]

    def read(self) -> NDArray[Any]:
        """Read the whole array, shape `shape`."""
        return np.array(self._map(0, self.shape, "F" if self.fortran else "C"))

    def row(self, index: int) -> NDArray[Any]:
        """Read entry `index` of the first of three axes, shape ``shape[1:]``.

        Only that entry is mapped, and unmapped again: pages of a mapping that stays count as memory of the
        process, so one mapping of the whole file would seem to grow up to the size of the file.
        """
        count, height, width = self.shape
        if not self.fortran:
            return np.array(self._map(index * height * width, (height, width), "C"))
        out = np.empty((height, width), self.dtype)
        for column in range(width):
            out[:, column] = self._map(column * height * count, (height, count), "C")[:, index]
        return out

    def _map(self, first: int, shape: tuple[int, ...], order: Any) -> NDArray[Any]:
        at = self.offset + first * self.dtype.itemsize
        try:
            return np.memmap(self.path, self.dtype, "r", at, shape, order)
        except (OSError, ValueError) as error:
            message = (
                f"{self.path}: cannot be read at byte {at} ({error}), expected {shape} numbers there; "
                "next: leave the file alone during a run and start again"
            )
            raise InputError(message) from error


def open_npy(path: str) -> NpyFile:
    """Check a ``.npy`` file without reading its numbers.

    Raises InputError when the file is missing, is not a ``.npy`` file, is shorter than its header promises,
    or holds pickled Python objects (which are never loaded: they can run code).
    """
    try:
        status = Path(path).stat()
        return _checked(path, status.st_size, status.st_mtime_ns)
    except FileNotFoundError:
        message = f"{path}: no such file, expected a .npy file; next: check the path"
        raise InputError(message) from None
    except OSError as error:
        message = f"{path}: cannot be opened ({error.strerror}), expected a .npy file; next: check the path"
        raise InputError(message) from error


_DAMAGED_HEADER = (
    *(ValueError, TypeError, EOFError, SyntaxError, tokenize.TokenError),
    *(OverflowError, RecursionError, MemoryError),
)
"""What numpy's parsing of a damaged header, which is Python's text, runs into."""


@lru_cache(maxsize=8)
def _checked(path: str, size: int, time_ns: int) -> NpyFile:
    with Path(path).open("rb") as stream:
        start = stream.read(len(_MAGIC))
        if start != _MAGIC:
            message = (
                f"{path}: is not a .npy file, found {start!r} at its start, expected {_MAGIC!r}; "
                "next: give a file written by numpy.save"
            )
            raise InputError(message)
        stream.seek(0)
        try:
            with warnings.catch_warnings():
                # A file written by Python 2, or with an old name of a type, reads well: no news to its user.
                warnings.simplefilter("ignore")
                if np.lib.format.read_magic(stream) == (1, 0):
                    shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
                else:
                    # It reads version 3 as well, which only spells names of fields otherwise.
                    shape, fortran, dtype = np.lib.format.read_array_header_2_0(stream)
            if min(shape, default=0) < 0:
                message = f"shape {shape}"
                raise ValueError(message)
        except _DAMAGED_HEADER as error:
            message = (
                f"{path}: the header of this .npy file is damaged ({error}), expected shape and dtype; "
                "next: download or copy it again"
            )
            raise InputError(message) from error
        offset = stream.tell()
    if dtype.hasobject:
        message = (
            f"{path}: holds pickled Python objects, expected plain numbers or strings; next: save it again "
            "with a numeric dtype, such as numpy.save(path, array.astype(int))"
        )
        raise InputError(message)
    promised = offset + prod(shape) * dtype.itemsize
    if size < promised:
        message = (
            f"{path}: is cut off, found {size} bytes, expected {promised} for {shape} of {dtype}; "
            "next: download or copy it again"
        )
        raise InputError(message)
    return NpyFile(path, shape, dtype, fortran, offset, (size, time_ns))
