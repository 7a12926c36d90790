"""Values that users give: arrays and numbers, checked before compiled loops, and files of such values.

Compiled loops check nothing. Files are arrays (.npz), or JSON files with the values of a dataclass.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

from tactile_toolkit import cache, store
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.value_types import AnyArray, Float64

MAX_NUMBERS = 1 << 30
_MAX_SHOWN = 60
T = TypeVar("T")
_MAX_BYTES = 1 << 16


def real_array(value: object) -> Float64 | None:
    """Return real numbers as an array of float64; None for anything else, and for more than 2**30 of them."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, OverflowError):
        return None
    if array.dtype.kind not in "iuf" or array.size > MAX_NUMBERS:
        return None
    return np.asarray(array, np.float64)


def is_real_array(value: object) -> bool:
    """Return whether a value is an array of real numbers, with a dimension and at most 2**30 of them."""
    if not isinstance(value, np.ndarray) or value.ndim == 0:
        return False
    return value.dtype.kind in "iuf" and value.size <= MAX_NUMBERS


def finite_array(
    value: object, name: str, shape: tuple[int | None, ...], expected: str, *, most: float = math.inf
) -> Float64:
    """Return finite numbers as an array of float64 of a shape, in which None is any length above 0.

    InputError, which begins with ``name`` and states what was ``expected``, for anything else, and for
    numbers beyond -most to most.
    """
    array = real_array(value)
    if array is None or array.ndim != len(shape) or not _has_sides(array.shape, shape):
        raise InputError(f"is {shown(value)}; expected {expected}", field=name)
    if not (np.abs(array) <= most).all() or not np.isfinite(array).all():
        wrong = array[~(np.isfinite(array) & (np.abs(array) <= most))].flat[0]
        limit = f", at most {most:g}" if math.isfinite(most) else ""
        raise InputError(f"is or holds {wrong:g}; expected {expected}, finite{limit}", field=name)
    return array


def _has_sides(sides: tuple[int, ...], shape: tuple[int | None, ...]) -> bool:
    expected = zip(sides, shape, strict=True)
    return all(side > 0 if length is None else side == length for side, length in expected)


def shown(value: object) -> str:
    """Return a value in messages: an array by its type and shape, anything else in short."""
    if isinstance(value, np.ndarray) and value.ndim:
        return f"an array of {value.dtype} of the shape {value.shape}"
    text = repr(value)
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]} ..."


def read_values(path: str | Path, values: type[T], what: str) -> T:
    """Read a JSON file with a value for each field of a dataclass, texts and numbers.

    InputError, in which ``what`` names the content of the file, for any other file.
    """
    declared = [field for field in fields(values) if field.name != "twin"]  # type: ignore[arg-type]
    names = [field.name for field in declared]
    required = {field.name for field in declared if field.default is MISSING}
    try:
        with store.open_regular(store.expanded(path)) as stream:
            data = stream.read(_MAX_BYTES)
        stored = msgspec.json.decode(data, type=dict[str, str | int | float])
        if not required <= set(stored) <= set(names):
            problem = f"it has {', '.join(stored) or 'no values'}"
            raise msgspec.ValidationError(problem)
        return values(**stored)
    except InputError as error:
        raise InputError(f"{str(path)!r}: {error}") from error
    except (OSError, IntegrityError, msgspec.DecodeError) as error:
        raise InputError(
            f"{what} cannot be read from {str(path)!r} ({error}); expected a JSON object with "
            f"{', '.join(names)}"
        ) from error


def npz_bytes(arrays: Mapping[str, AnyArray], comment: bytes = b"") -> bytes:
    """Return the bytes of a file of arrays; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    # Stored, not deflated: floats do not compress, and zlib differs between machines.
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))  # the same time in each file
            with archive.open(entry, "w") as stream:
                np.lib.format.write_array(stream, np.ascontiguousarray(array), allow_pickle=False)
        archive.comment = comment
    return buffer.getvalue()


def read_npz(path: Path) -> tuple[dict[str, AnyArray], bytes]:
    """Read the arrays and the comment of a file; numpy and zipfile raise many kinds of errors for others."""
    with store.open_regular(path) as stream, zipfile.ZipFile(stream) as archive:
        cache.require_unpackable(sum(entry.file_size for entry in archive.infolist()), repr(str(path)))
        comment = archive.comment
        stream.seek(0)
        with np.load(stream, allow_pickle=False) as stored:
            return dict(stored), comment
