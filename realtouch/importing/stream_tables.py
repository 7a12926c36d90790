"""Tables of streams: which are beside a recording, which column holds their times, and in which unit."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import PurePosixPath

import numpy as np
import pyarrow as pa

from realtouch.import_columns import ImportColumns
from realtouch.importing.fields import times_s
from realtouch.importing.source_files import column_table
from tactile_toolkit import store
from tactile_toolkit.array_types import Float64
from tactile_toolkit.column_tables import COLUMN_TABLE_ENDINGS, ColumnTable
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.units import PER_SECOND, stated_unit

TIME_NAMES = ("time", "times", "timestamp", "timestamps", "time_stamp", "t", "stamp")
"""Names of columns of times, with or without a unit, such as ``time_ms``, where none is named."""

_JOINTS = "._"  # between the name of a recording and that of a stream


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
    time_s : ndarray of float64, shape (rows,), or None
        Times of samples, seconds; none is earlier than the one before. Of samples of one time, the first
        counts.
    """

    name: str
    place: str
    table: ColumnTable = field(repr=False)
    rows: int
    time_column: str = ""
    time_s: Float64 | None = field(default=None, repr=False)


def open_stream(folder: store.DataFolder, name: str, columns: ImportColumns, stem: str = "") -> Stream:
    """Read the times of a table.

    Parameters
    ----------
    folder, name
        Where it is; its format follows from its ending.
    columns : ImportColumns
        ``time`` is the column of times, if the table has it; if empty, a row is a picture. Else it is the
        only column that is called as in :data:`TIME_NAMES`. ``time_unit`` is the unit of one whose name does
        not end in one; seconds by default, which integers must state.
    stem : str, optional
        Beginning of the file name that is not part of the name of the stream.

    Raises
    ------
    InputError
        The table cannot be read, has no rows, several columns of times, or times that are missing, run back
        or have no known unit.
    """
    place = folder.address(name)
    table = column_table(folder, name)
    column = _time_column(table.names, columns.time, place)
    rows, values = table.scan(column)
    if not rows:
        raise InputError(f"{place!r} has no rows; expected a row for each sample")
    whole = PurePosixPath(name).stem
    shown = whole.removeprefix(stem).lstrip(_JOINTS) or whole
    if not column:
        return Stream(shown, place, table, rows)
    return Stream(shown, place, table, rows, column, _seconds(values, column, columns.time_unit, place))


def _time_column(names: Sequence[str], time: str | None, place: str) -> str:
    if time is not None and (not time or time in names):
        return time
    # Only a unit of time is taken off: a column `t_mm` is no time.
    known = {name for base in TIME_NAMES for name in (base, *(f"{base}_{unit}" for unit in PER_SECOND))}
    found = [name for name in names if name.lower() in known]
    if len(found) > 1:
        words = f"{place!r} has several columns of times: {', '.join(found)}"
        raise InputError(words, next="name one: `--map time=COLUMN`")
    return found[0] if found else ""


def _seconds(values: pa.Array, column: str, given: str | None, place: str) -> Float64:
    """Return times in seconds, which do not run back; those with a date count from 1970, UTC."""
    what, stated = f"{place!r}: the times {column!r}", stated_unit(column)
    if pa.types.is_integer(values.type) and not (stated or given):
        raise InputError(
            f"{what} are integers, whose unit is not known",
            next=f"add --time-unit {', '.join(PER_SECOND)}, or end the name of the column in the unit",
        )
    try:
        found = times_s(values, ImportColumns(time=column, time_unit=None if stated else given))
    except ItemError as error:
        raise InputError(f"{what}: {error.what}") from error
    back = np.flatnonzero(np.diff(found) < 0)
    if len(back):
        row = int(back[0])
        raise InputError(
            f"{place!r}: the time runs back, from {found[row]:.6f} s in row {row + 1:,} to "
            f"{found[row + 1]:.6f} s in row {row + 2:,}; expected times that rise",
            next="sort the rows, or divide the table where the clock was set",
        )
    return found


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
        fitting = [end for end in range(len(whole), 0, -1) if whole[end:][:1] in _JOINTS]
        owner = next((whole[:end] for end in fitting if whole[:end] in stems), None)
        if owner is not None:
            found.setdefault(owner, []).append(name)
    return found
