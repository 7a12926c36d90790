"""Times of streams: which column holds them, and what they are in seconds."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from tactile_toolkit.array_types import Float64, Int64
from tactile_toolkit.errors import InputError
from tactile_toolkit.units import PER_SECOND, stated_unit

TIME_NAMES = ("time", "times", "timestamp", "timestamps", "time_stamp", "t", "stamp")
"""Names of columns of times, with or without a unit, such as ``time_ms``, where none is named."""

_INSTANTS = (pa.timestamp("ns", "UTC"), pa.timestamp("ns"))
_NUMBER = re.compile(r"\s*[+-]?[0-9.,]+(?:[eE][+-]?[0-9]+)?\s*")
_LONGEST_SHOWN = 40


def time_column(names: Sequence[str], time: str | None, place: str) -> str:
    """Return the column of times: the one that is named, if it is there, or the only one called as such.

    It is empty if there is none. InputError, which names ``place``, if there are several.
    """
    if time is not None and (not time or time in names):
        return time
    found = [name for name in names if _is_time(name)]
    if len(found) > 1:
        columns = ", ".join(found)
        raise InputError(
            f"{place!r} has several columns of times: {columns}", next="name one: `--map time=COLUMN`"
        )
    return found[0] if found else ""


def _unit(name: str) -> str:
    """Return the unit of times that a column states; empty for none."""
    unit = stated_unit(name) or ""
    return unit if unit in PER_SECOND else ""


def _is_time(name: str) -> bool:
    return name.lower().removesuffix(f"_{_unit(name)}") in TIME_NAMES


def seconds(values: pa.ChunkedArray, column: str, given: str | None, place: str) -> Float64:
    """Return times in seconds; those with a date count from 1970, UTC.

    The name of the column states the unit, else ``given`` does; floats without are seconds. InputError, which
    names ``place``: a time is missing or none, or integers have no unit.
    """
    what = f"{place!r}: the times {column!r}"
    if values.null_count:
        row = int(np.argmax(values.is_null().to_numpy())) + 1
        raise InputError(f"{what} are missing in row {row:,}; expected one in each row")
    if pa.types.is_string(values.type):
        values = _instants(values, what)
    is_integer = pa.types.is_integer(values.type)
    if pa.types.is_timestamp(values.type) or pa.types.is_duration(values.type):
        kind = pa.duration("ns")
        if pa.types.is_timestamp(values.type):
            kind = pa.timestamp("ns", values.type.tz)
        nanoseconds: Int64 = values.cast(kind).cast(pa.int64()).to_numpy()
        return nanoseconds / PER_SECOND["ns"]
    unit = _unit(column) or given
    if is_integer and not unit:
        raise InputError(
            f"{what} are integers, whose unit is not known",
            next=f"add --time-unit {', '.join(PER_SECOND)}, or end the name of the column in the unit",
        )
    if not (is_integer or pa.types.is_floating(values.type)):
        raise InputError(f"{what} are of the type {values.type}; expected numbers, or dates with times")
    found: Float64 = values.to_numpy().astype(np.float64) / PER_SECOND[unit or "s"]
    finite = np.isfinite(found)
    if not finite.all():
        raise InputError(f"{what} are not finite in row {int(finite.argmin()) + 1:,}; expected numbers")
    return found


def _instants(values: pa.ChunkedArray, what: str) -> pa.ChunkedArray:
    """Return texts such as ``2026-01-31T12:00:00.5Z`` as times."""
    for data_type in _INSTANTS:
        try:
            return values.cast(data_type)
        except pa.ArrowException:
            continue
    row, text = next(
        ((row, text) for row, text in enumerate(values.to_pylist(), 1) if not _NUMBER.fullmatch(text)),
        (1, str(values[0].as_py())),
    )
    raise InputError(
        f"{what} hold {text[:_LONGEST_SHOWN]!r} in row {row:,}; expected numbers, or times of ISO 8601"
    )
