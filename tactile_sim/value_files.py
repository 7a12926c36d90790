"""JSON files with the values of a dataclass, such as the noise or the geometry of a sensor."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import TypeVar

import msgspec

from tactile_toolkit import store
from tactile_toolkit.errors import InputError, IntegrityError

T = TypeVar("T")
_MAX_BYTES = 1 << 16


def read_values(path: str | Path, values: type[T], what: str) -> T:
    """Read a JSON file with a value for each field of a dataclass, texts and numbers.

    InputError, in which ``what`` names the content of the file, for any other file.
    """
    try:
        with store.open_regular(store.expanded(path)) as stream:
            data = stream.read(_MAX_BYTES)
        found = msgspec.json.decode(data, type=dict[str, str | int | float])
        return values(**found)
    except InputError as error:
        raise InputError(f"{str(path)!r}: {error}") from error
    except (OSError, IntegrityError, msgspec.DecodeError, TypeError) as error:
        names = ", ".join(each.name for each in fields(values))  # type: ignore[arg-type]
        raise InputError(
            f"{what} cannot be read from {str(path)!r} ({error}); expected a JSON object with {names}"
        ) from error
