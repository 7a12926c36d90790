"""HWD+ as published by its authors: ``.npy`` files of images and of their writers."""

from __future__ import annotations

import hashlib
import warnings
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

import numpy as np

import mnist3d.ink
from mnist3d.ink.grey_levels import as_grey
from mnist3d.sources.digit_source import NO_WRITER, DigitCatalog, DigitImage, require_known
from tactile_toolkit.array_types import AnyArray, Int64
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import with_count

_SCALE_SAMPLE = 16
_FINGERPRINT_SAMPLE = 64


@dataclass(frozen=True, slots=True)
class HwdPlusSource:
    """The two ``.npy`` files of HWD+ (Beaulac and Rosenthal 2022), or other files of the same layout.

    The image array is mapped for one image at a time, so memory does not grow with the file. Integers of any
    width are grey levels from 0 to 255. Floats run from 0 to 1 if the brightest pixels of 16 evenly spaced
    images have a median of at most 1, otherwise from 0 to 255. The scale is decided once per file. Images of
    another size are fitted into 500 x 500 px.

    Parameters
    ----------
    images : str
        ``Images(500x500).npy``: shape (N, 500, 500), dark ink on light paper, any integer or float dtype.
    writer_info : str
        ``WriterInfo.npy``: one row per image, column 0 is the digit; numbers or strings of digits.
    writer_column : int, optional
        Column of `writer_info` that numbers the writer; by default the writer is unknown.

    Notes
    -----
    The id of an image is its row. An array in Fortran order is slow to read, as the pixels of an image are
    spread over the file.
    """

    name: ClassVar[str] = "hwdplus"
    """Word that selects this source on the command line."""

    images: str
    writer_info: str
    writer_column: int | None = None

    def catalog(self) -> DigitCatalog:
        """Check both files and return ids, labels and writers.

        Raises InputError when a file is missing, damaged or of another shape or type, when the numbers of
        rows differ, or when a label is not an integer from 0 to 9.
        """
        count, (labels, writers) = len(self._stack()), self._annotations()
        if len(labels) != count:
            raise InputError(
                f"{self.writer_info}: found {len(labels)} rows, expected {count}, one for each image of "
                f"{self.images}",
                next="take both files from the same download",
            )
        return DigitCatalog(np.arange(count), labels, writers)

    def image(self, digit_id: int) -> DigitImage:
        """Read the image of row `digit_id` only.

        Raises ItemError ``"unknown-id"``, ``"not-finite"`` (NaN or infinite pixels) or ``"bad-pixels"``
        (values outside the grey scale of the file).
        """
        stack, (labels, writers) = self._stack(), self._annotations()
        where = f"{self.images}, row {digit_id}"
        require_known(digit_id, min(len(stack), len(labels)), self.images)
        full_scale = _full_scale(self.images, _stamp(self.images))
        pixels = mnist3d.ink.fit(as_grey(np.array(stack[digit_id]), full_scale, where))
        return DigitImage(digit_id, int(labels[digit_id]), pixels, int(writers[digit_id]))

    def fingerprint(self) -> dict[str, object]:
        """Return dtype and shape, and SHA-256 of labels, writers and 64 evenly spaced images.

        Only a sample is hashed, because hashing gigabytes would take longer than making the first shard.
        Raises InputError as :meth:`catalog` does.
        """
        stack, (labels, writers) = self._stack(), self._annotations()
        sample = hashlib.sha256()
        for row in _evenly_spaced(len(stack), _FINGERPRINT_SAMPLE):
            sample.update(self._stack()[row].tobytes())
        return {
            "name": self.name,
            "dtype": stack.dtype.str,
            "shape": list(stack.shape),
            "labels_sha256": hashlib.sha256(labels.tobytes()).hexdigest(),
            "writers_sha256": hashlib.sha256(writers.tobytes()).hexdigest(),
            "images_sample_sha256": sample.hexdigest(),
        }

    def _stack(self) -> AnyArray:
        # Mapped again for each image: pages of a lasting mapping count as memory of the process.
        stack = open_npy(self.images)
        shape = stack.shape
        squarish = len(shape) == 3 and min(shape) > 0 and max(shape[1:]) <= 1.5 * min(shape[1:])
        if squarish and stack.dtype.kind in "biuf":
            return stack
        raise InputError(
            f"{self.images}: found shape {shape} of {stack.dtype}, expected (N, 500, 500) of integers or "
            "floats",
            next="give the file 'Images(500x500).npy' of HWD+",
        )

    def _annotations(self) -> tuple[Int64, Int64]:
        return _labels_and_writers(self.writer_info, _stamp(self.writer_info), self.writer_column)


@lru_cache(maxsize=4)
def _full_scale(path: str, stamp: tuple[int, int]) -> float:
    stack = open_npy(path)
    if stack.dtype.kind == "b":
        return 1.0
    if stack.dtype.kind in "iu":
        return 255.0
    # The median, as a single image may be damaged or hold no paper.
    values = (stack[row] for row in _evenly_spaced(len(stack), _SCALE_SAMPLE))
    brightest = [float(np.max(each, where=np.isfinite(each), initial=-np.inf)) for each in values]
    finite = [each for each in brightest if each > -np.inf]
    # Half a grey level of slack: rounding may have left white a little above 1.
    if finite and float(np.median(finite)) <= 1 + 0.5 / 255:
        return 1.0
    return 255.0


def _evenly_spaced(count: int, wanted: int) -> list[int]:
    return [int(row) for row in np.rint(np.linspace(0, count - 1, min(count, wanted)))]


@lru_cache(maxsize=4)
def _labels_and_writers(path: str, stamp: tuple[int, int], writer_column: int | None) -> tuple[Int64, Int64]:
    cells = open_npy(path)
    if cells.ndim not in (1, 2) or min(cells.shape) <= 0 or cells.dtype.kind not in "biufUS":
        raise InputError(
            f"{path}: found shape {cells.shape} of {cells.dtype}, expected one row per image with the "
            "digit in column 0, as numbers or strings of digits",
            next="give the file 'WriterInfo.npy' of HWD+",
        )
    table = np.array(cells).reshape(len(cells), -1)
    labels, writers = _int_column(table, 0, path, 9), np.full(len(table), NO_WRITER, np.int64)
    if writer_column is not None:
        if not 1 <= writer_column < table.shape[1]:
            raise InputError(
                f"{path}: there is no writer column {writer_column}; the file has "
                f"{with_count(table.shape[1], 'columns')}; expected one after column 0, which is the digit",
                next="change --writer-column, or leave it out",
            )
        writers = _int_column(table, writer_column, path)
    for shared in (labels, writers):
        shared.flags.writeable = False
    return labels, writers


def _int_column(table: AnyArray, column: int, path: str, most: float = np.inf) -> Int64:
    """Return a column of numbers, or of strings of digits, as integers.

    ``most`` is 9 for a column of digits, which are not negative.
    """
    expected = "a digit from 0 to 9" if most == 9 else "an integer"
    next_step = "check that this file belongs to the images and is not damaged"
    try:
        numbers = table[:, column].astype(np.float64)
    except ValueError as error:
        found = f"column {column} holds text that is not a number"
        raise InputError(f"{path}: {found}, expected {expected}", next=next_step) from error
    # From 2**53 on, floats cannot represent all integers.
    fits = (np.rint(numbers) == numbers) & (np.abs(numbers) < 2.0**53)
    fits &= (most > 9) | ((numbers >= 0) & (numbers <= most))
    if not fits.all():
        found = table[int(np.argmin(fits)), column].item()
        raise InputError(
            f"{path}: row {np.argmin(fits)}, column {column}: found {found!r}, expected {expected}",
            next=next_step,
        )
    return numbers.astype(np.int64)


def open_npy(path: str) -> AnyArray:
    """Map a ``.npy`` file without reading its numbers.

    Raises InputError when the file is missing, is not a ``.npy`` file, is shorter than its header states, or
    holds pickled Python objects (which are never loaded, as they can run code).
    """
    try:
        with warnings.catch_warnings():
            # Files of Python 2, or with old names of types, can be read: no warning is needed.
            warnings.simplefilter("ignore")
            return np.lib.format.open_memmap(path, mode="r")
    except Exception as error:  # a damaged header, which numpy parses as Python, raises many types
        raise InputError(
            f"{path}: cannot be read ({error}), expected an intact .npy file of numbers or strings, as "
            "numpy.save writes them",
            next="check the path, or download or copy it again",
        ) from error


def _stamp(path: str) -> tuple[int, int]:
    """Return size and modification time, by which caches recognise a replaced file; 0 if it is missing."""
    try:
        status = Path(path).stat()
    except OSError:
        return 0, 0
    return status.st_size, status.st_mtime_ns
