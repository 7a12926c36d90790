"""A ``.npy`` file checked by its header and read one part at a time."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache
from math import prod
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.errors import InputError

__all__ = ["NpyFile", "open_npy"]

_MAGIC = b"\x93NUMPY"


@dataclass(frozen=True, slots=True)
class NpyFile:
    """What the header of a ``.npy`` file says, and the way to its numbers.

    Attributes
    ----------
    path : str
    shape : tuple of int
    dtype : numpy.dtype
    fortran : bool
        Whether the first axis varies fastest in the file.
    offset : int
        Bytes before the first number.
    stamp : tuple of int
        Size in bytes and time of change in ns: together with `path` it identifies the content for caches.
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

    Raises
    ------
    InputError
        When the file is missing, is not a ``.npy`` file, is shorter than its header promises, or holds
        pickled Python objects (which are never loaded: they can run code).
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


@lru_cache(maxsize=8)
def _checked(path: str, size: int, time_ns: int) -> NpyFile:
    with Path(path).open("rb") as stream:
        shape, fortran, dtype = _header(stream, path)
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


def _header(stream: BinaryIO, path: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    start = stream.read(len(_MAGIC))
    if start != _MAGIC:
        message = (
            f"{path}: is not a .npy file, found {start!r} at its start, expected {_MAGIC!r}; "
            "next: give a file written by numpy.save"
        )
        raise InputError(message)
    stream.seek(0)
    try:
        return _parse(stream)
    except (ValueError, EOFError) as error:
        message = (
            f"{path}: the header of this .npy file is damaged ({error}), expected shape and dtype; "
            "next: download or copy it again"
        )
        raise InputError(message) from error


def _parse(stream: BinaryIO) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    with warnings.catch_warnings():
        # A file written by Python 2 reads well; that it is old is no news to its user.
        warnings.simplefilter("ignore", UserWarning)
        if np.lib.format.read_magic(stream) == (1, 0):
            return np.lib.format.read_array_header_1_0(stream)
        return np.lib.format.read_array_header_2_0(stream)
