"""Tables of streams: which are beside a recording, which column holds their times, and in which unit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import PurePosixPath

import numpy as np
import pyarrow as pa

from realtouch.exchange.found_touches import column_table
from realtouch.exchange.stream_times import seconds, time_column
from tactile_toolkit import store
from tactile_toolkit.array_types import Float64, Int64
from tactile_toolkit.column_tables import COLUMN_TABLE_ENDINGS, ColumnTable
from tactile_toolkit.errors import InputError

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
        :data:`realtouch.exchange.stream_times.TIME_NAMES`.
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
    table = column_table(folder, name)
    column = time_column(table.names, time, place)
    rows, found = table.scan(column)
    if not rows:
        raise InputError(f"{place!r} has no rows; expected a row for each sample")
    shown = PurePosixPath(name).stem
    shown = shown.removeprefix(stem).lstrip(_JOINTS) or shown
    if not column:
        return Stream(shown, place, table, rows)
    time_s = seconds(found, column, time_unit, place)
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
