"""Files of values: arrays (.npz), and JSON files with the values of a dataclass."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

from tactile_toolkit import cache, store
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.value_types import AnyArray

T = TypeVar("T")
_MAX_BYTES = 1 << 16


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
