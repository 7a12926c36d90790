"""The IDX files in which MNIST and its kin are published."""

from __future__ import annotations

import gzip
import struct
import zlib
from math import prod
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.errors import InputError

__all__ = ["IMAGES_MAGIC", "LABELS_MAGIC", "read_idx", "unusable"]

IMAGES_MAGIC = 0x803
"""First number of a file of images: unsigned bytes (8) in three dimensions (3)."""

LABELS_MAGIC = 0x801
"""First number of a file of labels: unsigned bytes (8) in one dimension (1)."""


def read_idx(path: Path, magic: int) -> NDArray[np.uint8]:
    """Read a file of unsigned bytes, plain or (when its name ends in ``.gz``) gzipped.

    Parameters
    ----------
    path : Path
    magic : int
        The first number that the file must have; its last byte is the number of dimensions.

    Returns
    -------
    ndarray of uint8
        Read-only, shaped as the header says.

    Raises
    ------
    InputError
        When the file cannot be read, is damaged, cut off or too long, or is of another kind.
    """
    data = _unpacked(path)
    dimensions = magic & 0xFF
    start = 4 + 4 * dimensions
    if len(data) < start:
        raise unusable(path, f"is cut off, found {len(data)} bytes, expected a header of {start}")
    found, *shape = struct.unpack_from(f">{1 + dimensions}I", data)
    if found != magic:
        raise unusable(path, f"found magic number {found}, expected {magic}")
    promised = start + prod(shape)
    if len(data) != promised:
        raise unusable(path, f"found {len(data)} bytes, expected {promised} for an array of shape {shape}")
    return np.frombuffer(data, np.uint8, offset=start).reshape(shape)


def unusable(path: Path, story: str) -> InputError:
    """Say what is wrong with a file that has to be fetched again."""
    return InputError(f"{path}: {story}; next: remove it, then download or copy it again")


def _unpacked(path: Path) -> bytes:
    try:
        if path.suffix != ".gz":
            return path.read_bytes()
        with gzip.open(path) as stream:
            return stream.read()
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise unusable(path, f"is damaged or cut off ({error}), expected a whole gzip file") from error
    except OSError as error:
        raise unusable(path, f"cannot be read ({error.strerror}), expected an IDX file") from error
