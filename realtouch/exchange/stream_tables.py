"""Tables of streams: which are beside a recording, which column holds their times, and in which unit."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import PurePosixPath

import numpy as np
import pyarrow as pa

from realtouch.exchange.found_touches import open_source
from tactile_toolkit import store
from tactile_toolkit.array_types import Float64, Int64
from tactile_toolkit.column_tables import COLUMN_TABLE_ENDINGS, ColumnTable
from tactile_toolkit.errors import InputError
from tactile_toolkit.units import PER_SECOND

TIME_NAMES = ("time", "times", "timestamp", "timestamps", "time_stamp", "t", "stamp")
"""Names of columns of times, with or without a unit, such as ``time_ms``, where none is named."""

_JOINTS = "._"  # between the name of a recording and that of a stream
_UTC = pa.timestamp("ns", "UTC")


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """A table with a row for each sample, or for each picture of a recording.

    Attributes
    ----------
    name : str
        What the summary calls it, and columns whose names are taken.
    place : str
        Its address, for messages.
    table : ColumnTable
        What is read again for the samples that are used.
    rows : int
        Number of rows.
    time_column : str
        Column of times; empty if a row is a picture.
    time_s : ndarray of float64, shape (m,), or None
        Times of samples, seconds; each is later than the one before.
    duplicates : int
        Rows with the time of the row before, which is kept.
    """

    name: str
    place: str
    table: ColumnTable = field(repr=False)
    rows: int
    time_column: str = ""
    time_s: Float64 | None = field(default=None, repr=False)
    duplicates: int = 0
    _kept: Int64 | None = field(default=None, repr=False)

    def read(self, samples: Int64) -> pa.Table:
        """Return the rows of some samples, by rising numbers, without their times."""
        rows = samples if self._kept is None else self._kept[samples]
        table = self.table.rows(rows)
        return table.drop_columns([self.time_column]) if self.time_column else table

    def times_of_rows(self) -> Float64:
        """Return the times of all rows, which of duplicates are equal; there must be times."""
        assert self.time_s is not None
        if self._kept is None:
            return self.time_s
        return self.time_s[np.searchsorted(self._kept, np.arange(self.rows), side="right") - 1]

    def where(self, column: str) -> str:
        """Return how a message about a column begins."""
        return f"{self.place!r}: the column {column!r}"


def open_stream(
    folder: store.DataFolder,
    name: str,
    time: str | None = None,
    time_unit: str | None = None,
    stem: str = "",
) -> Stream:
    """Read the times of a table.

    Parameters
    ----------
    folder, name
        Where it is; its format follows from its ending.
    time : str, optional
        Column of times; empty if a row is a picture. By default the only column that is called as in
        :data:`TIME_NAMES`.
    time_unit : "s", "ms", "us" or "ns", optional
        Unit of a column whose name does not end in one; seconds by default, which integers must state.
    stem : str, optional
        Beginning of the file name that is not part of the name of the stream.

    Raises
    ------
    InputError
        The table cannot be read, has no rows, several columns of times, or times that are missing, run back
        or have no known unit.
    """
    place = folder.address(name)
    table = ColumnTable(place, partial(open_source, folder, name))
    column = _time_column(table.names, time, place)
    rows, found = table.scan(column)
    if not rows:
        raise InputError(f"{place!r} has no rows; expected a row for each sample")
    shown = PurePosixPath(name).stem
    shown = shown.removeprefix(stem).lstrip(_JOINTS) or shown
    if not column:
        return Stream(shown, place, table, rows)
    time_s = _seconds(found, column, time_unit, place)
    steps = np.diff(time_s)
    back = np.flatnonzero(~(steps >= 0))
    if len(back):
        row = int(back[0])
        raise InputError(
            f"{place!r}: the time runs back, from {time_s[row]:.6f} s in row {row + 1:,} to "
            f"{time_s[row + 1]:.6f} s in row {row + 2:,}; expected times that rise",
            next="sort the rows, or divide the table where the clock was set",
        )
    kept = np.flatnonzero(np.append(True, steps > 0))
    if len(kept) == rows:
        return Stream(shown, place, table, rows, column, time_s)
    return Stream(shown, place, table, rows, column, time_s[kept], rows - len(kept), kept)


def _time_column(names: Sequence[str], time: str | None, place: str) -> str:
    """Return the column of times; empty if there is none."""
    if time is not None and (not time or time in names):
        return time
    found = [name for name in names if _stem_and_unit(name)[0] in TIME_NAMES]
    if len(found) > 1:
        raise InputError(
            f"{place!r} has several columns of times: {', '.join(found)}",
            next="name one: `--map time=COLUMN`",
        )
    return found[0] if found else ""


def _stem_and_unit(name: str) -> tuple[str, str]:
    """Return the name of a column without its unit, in lower case, and the unit of times; empty for none."""
    stem, _, unit = name.lower().rpartition("_")
    return (stem, unit) if stem and unit in PER_SECOND else (name.lower(), "")


def _seconds(values: pa.ChunkedArray, column: str, given: str | None, place: str) -> Float64:
    """Return times in seconds; those with a date count from 1970, UTC."""
    what = f"{place!r}: the times {column!r}"
    if values.null_count:
        row = int(np.argmax(values.is_null().to_numpy())) + 1
        raise InputError(f"{what} are missing in row {row:,}; expected one in each row")
    stated = _stem_and_unit(column)[1]
    if stated and given and stated != given:
        raise InputError(f"{what} are in {stated} by their name; --time-unit states {given}")
    unit = stated or given or ""
    if pa.types.is_string(values.type):
        values = _instants(values, what)
    if pa.types.is_timestamp(values.type):
        nanoseconds: Int64 = values.cast(pa.timestamp("ns", values.type.tz)).cast(pa.int64()).to_numpy()
        return nanoseconds / PER_SECOND["ns"]
    if pa.types.is_duration(values.type):
        values, unit = values.cast(pa.duration("ns")).cast(pa.int64()), "ns"
    if pa.types.is_integer(values.type) and not unit:
        raise InputError(
            f"{what} are integers, whose unit is not known",
            next=f"add --time-unit {', '.join(PER_SECOND)}, or end the name of the column in the unit",
        )
    if not (pa.types.is_integer(values.type) or pa.types.is_floating(values.type)):
        raise InputError(f"{what} are of the type {values.type}; expected numbers, or dates with times")
    seconds: Float64 = values.to_numpy().astype(np.float64) / PER_SECOND[unit or "s"]
    finite = np.isfinite(seconds)
    if not finite.all():
        raise InputError(f"{what} are not finite in row {int(finite.argmin()) + 1:,}; expected numbers")
    return seconds


def _instants(values: pa.ChunkedArray, what: str) -> pa.ChunkedArray:
    """Return texts such as ``2026-01-31T12:00:00.5Z`` as times."""
    for data_type in (_UTC, pa.timestamp("ns")):
        try:
            return values.cast(data_type)
        except pa.ArrowException:
            continue
    shown = str(values[0].as_py())[:40]
    raise InputError(f"{what} are text such as {shown!r}; expected numbers, or dates with times (ISO 8601)")


def tables_by_stem(names: Iterable[str]) -> dict[str, list[str]]:
    """Return the tables of a folder that belong to each of its other files, by their names without endings.

    ``take1.csv``, ``take1.force.csv`` and ``take1_force.csv`` belong to ``take1.mp4``, unless a longer name
    fits as well, such as that of ``take1_force.mp4``.
    """
    seen = [name for name in names if not store.is_hidden(name)]
    tables = [name for name in seen if name.lower().endswith(COLUMN_TABLE_ENDINGS)]
    stems = {PurePosixPath(name).stem for name in {*seen} - {*tables}}
    found: dict[str, list[str]] = {}
    for name in sorted(tables):
        whole = PurePosixPath(name).stem
        ends = [at for at, letter in enumerate(whole) if letter in _JOINTS]
        fitting = (whole[:end] for end in (len(whole), *reversed(ends)))
        owner = next((stem for stem in fitting if stem in stems), None)
        if owner is not None:
            found.setdefault(owner, []).append(name)
    return found
