"""Touches whose places are given: read from a table, or made in Python."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_sim.sensor import CELL_M
from tactile_toolkit.bounds import require_plain_archive, require_unpackable
from tactile_toolkit.errors import InputError
from tactile_toolkit.store.files import expanded

_PLACES = ("x_m", "y_m")
_NUMBERS = ("object_id", "round")
_POSES = ("object_x_m", "object_y_m", "object_turn_rad")
_COLUMNS = (*_PLACES, *_NUMBERS, *_POSES)
# Memory that reading takes for each row, in whatever columns, with the numbers of rounds and objects.
_BYTES_PER_ROW = 512
_LONGEST_HEADER = 4096
_LINE_ENDS = frozenset(b"\r\n")
_PIECE_BYTES = 1 << 20
# More is a wrong unit or column; sines are right up to a million turns.
_MOST_TURNS_RAD = 1e4


@dataclass(frozen=True, eq=False)
class GivenTouches:
    """A table of touches; within a round they are made in the order in which they stand.

    Attributes
    ----------
    x_m, y_m : array of float, shape (n,)
        Where the gel goes, metres, cell frame.
    object_id : array of int, shape (n,), optional
        The `id` of the object that is touched. Without it, every object is touched there.
    round : array of int, shape (n,), optional
        Number of the round of the object, from 0. Without it, every round is made of these touches.
    object_x_m, object_y_m, object_turn_rad : array of float, shape (n,), optional
        Where the origin of the object's mesh lies while it is touched, metres, cell frame, and its turn about
        z, radians; it stands on the plate. All three or none: without them it lies as the plan says.

    Raises
    ------
    InputError
        Columns of other lengths, values that are not finite numbers, a place off the cell.
    """

    x_m: Any
    y_m: Any
    object_id: Any = None
    round: Any = None
    object_x_m: Any = None
    object_y_m: Any = None
    object_turn_rad: Any = None

    def __post_init__(self) -> None:
        for name in _COLUMNS:
            value = getattr(self, name)
            if value is not None or name in _PLACES:
                object.__setattr__(self, name, _column(name, value))
        lengths = {name: len(getattr(self, name)) for name in _COLUMNS if getattr(self, name) is not None}
        if len(set(lengths.values())) != 1 or not len(self.x_m):
            held = ", ".join(f"{name} {count}" for name, count in lengths.items())
            raise InputError(
                f"given touches have columns of lengths {held}; expected one length of at least 1"
            )
        if 0 < sum(getattr(self, name) is not None for name in _POSES) < len(_POSES):
            missing = [name for name in _POSES if getattr(self, name) is None]
            raise InputError(
                f"given touches lack {', '.join(missing)}; expected all of {', '.join(_POSES)}, or none"
            )

    @classmethod
    def read(cls, path: str | Path) -> GivenTouches:
        """Read a table from a file.

        Parameters
        ----------
        path : str or path
            CSV with a header line, Parquet, or `.npz`, whose columns are named as the attributes.

        Returns
        -------
        GivenTouches

        Raises
        ------
        InputError
            The file is not there, is not such a table, or holds values as above.
        """
        file = expanded(path)
        readers = {".csv": _read_csv, ".parquet": _read_parquet, ".npz": _read_npz}
        if file.suffix.lower() not in readers:
            raise InputError(f"given touches in {str(path)!r}: expected a file {', '.join(readers)}")
        try:
            columns = readers[file.suffix.lower()](file)
        except InputError as error:  # more than the limit
            raise InputError(f"given touches in {str(path)!r}: {error}") from error
        except Exception as error:  # pyarrow, zipfile and numpy raise many kinds
            raise InputError(
                f"given touches in {str(path)!r} cannot be read ({error}); expected a "
                f"whole {file.suffix.lower()} file with columns {', '.join(_PLACES)}"
            ) from error
        unknown, missing = set(columns) - set(_COLUMNS), set(_PLACES) - set(columns)
        if unknown or missing:
            wrong = f"unknown columns {sorted(unknown)}" if unknown else f"no {sorted(missing)}"
            raise InputError(
                f"given touches in {str(path)!r} have {wrong}; expected x_m, y_m and of these: "
                f"{', '.join(_COLUMNS[2:])}"
            )
        try:
            return cls(**columns)
        except InputError as error:
            raise InputError(f"{str(path)!r}: {error}") from error

    @cached_property
    def rounds(self) -> int | None:
        """Number of rounds, or None where the table does not say."""
        return None if self.round is None else int(self.round.max()) + 1

    @cached_property
    def longest(self) -> int:
        """Most touches that a round has."""
        return max(len(rows) for rows in self._rows.values())

    def of(self, object_id: int, number: int) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """Return the places of a round, shape (T, 2), and x, y and turn of the object, (T, 3), if given.

        T is 0 where the table has no such round.
        """
        # None stands for every object, and for every round.
        rows = self._rows.get(
            (None if self.object_id is None else object_id, None if self.round is None else number), []
        )
        places = np.stack([getattr(self, name)[rows] for name in _PLACES], axis=1)
        if self.object_x_m is None:
            return places, None
        return places, np.stack([getattr(self, name)[rows] for name in _POSES], axis=1)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values that decide what is made: which columns, how many rows, and their checksum."""
        held = [name for name in _COLUMNS if getattr(self, name) is not None]
        # Little-endian: the checksum is that of the numbers, not of the machine.
        stored = b"".join(
            getattr(self, name).astype(getattr(self, name).dtype.newbyteorder("<")).tobytes() for name in held
        )
        return {"columns": held, "rows": len(self.x_m), "sha256": hashlib.sha256(stored).hexdigest()}

    @cached_property
    def _rows(self) -> dict[tuple[int | None, int | None], list[int]]:
        count = len(self.x_m)
        ids = [None] * count if self.object_id is None else self.object_id.tolist()
        rounds = [None] * count if self.round is None else self.round.tolist()
        found: dict[tuple[int | None, int | None], list[int]] = {}
        for row, key in enumerate(zip(ids, rounds, strict=True)):
            found.setdefault(key, []).append(row)
        return found


def _column(name: str, value: Any) -> NDArray[Any]:
    """Return one column as float64 or int64; InputError for what cannot be one, with the first bad row."""
    whole = name in _NUMBERS
    try:
        found = np.asarray(value)
        numbers = found.astype(np.float64)
    except (TypeError, ValueError):
        found = numbers = np.empty((0, 0))
    if numbers.ndim != 1 or found.dtype.kind not in "iuf":
        raise InputError(
            f"column {name} of the given touches is {type(value).__name__}; expected a number for each touch"
        )
    if whole:
        wrong = ~(np.isfinite(numbers) & (numbers == np.floor(numbers)) & (numbers >= 0) & (numbers < 2**53))
        expected = "an integer from 0"
    elif name == "object_turn_rad":
        wrong, expected = ~(np.abs(numbers) <= _MOST_TURNS_RAD), "radians"
    else:
        half_m = CELL_M["xy".index(name.removeprefix("object_")[0])] / 2
        # An object may be larger than the cell, and its origin off it.
        half_m = half_m if name in _PLACES else 10 * half_m
        wrong, expected = ~(np.abs(numbers) <= half_m), f"metres from {-half_m:g} to {half_m:g}"
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"column {name} of the given touches is {found[row]} in row {row}; expected {expected}"
        )
    return found.astype(np.int64) if whole else numbers


def _read_csv(file: Path) -> Mapping[str, Any]:
    from pyarrow import csv

    with file.open("rb") as stream:
        head = stream.read(_LONGEST_HEADER)
        if len(head) == _LONGEST_HEADER and not _LINE_ENDS.intersection(head):
            raise ValueError(f"its first line has more than {_LONGEST_HEADER:,} bytes")
        stream.seek(0)
        pieces = iter(lambda: stream.read(_PIECE_BYTES), b"")
        lines = sum(max(map(piece.count, (b"\n", b"\r"))) for piece in pieces)
    _require_rows(lines, file)
    return _numbers(csv.read_csv(file))


def _read_parquet(file: Path) -> Mapping[str, Any]:
    from pyarrow import parquet

    with parquet.ParquetFile(file) as source:
        metadata = source.metadata
        groups = [metadata.row_group(number) for number in range(metadata.num_row_groups)]
        columns = [metadata.schema.column(number) for number in range(metadata.num_columns)]
        if len({column.path for column in columns}) < len(columns):
            raise ValueError(f"{len(columns):,} columns, some of one name; expected each once")
        for column in columns:
            if column.path not in _COLUMNS:
                return {each.path: None for each in columns}  # which is refused, unread
            if "BYTE_ARRAY" in column.physical_type:
                raise ValueError(f"column {column.path} holds {column.physical_type}; expected numbers")
        counts = [group.column(number).num_values for group in groups for number in range(group.num_columns)]
        _require_rows(max(metadata.num_rows, sum(counts) // max(len(columns), 1)), file)
        return _numbers(source.read())


def _require_rows(rows: int, file: Path) -> None:
    require_unpackable(_BYTES_PER_ROW * rows, f"a table of {rows:,} rows", file.stat().st_size)


def _numbers(table: Any) -> Mapping[str, Any]:
    import pyarrow as pa

    # What is missing becomes NaN, which is refused by its row.
    empty = {name: pa.types.is_null(table.schema.field(name).type) for name in table.column_names}
    return {
        name: (table.column(name).cast(pa.float64()) if empty[name] else table.column(name)).to_numpy()
        for name in table.column_names
    }


def _read_npz(file: Path) -> Mapping[str, Any]:
    with zipfile.ZipFile(file) as archive:
        require_plain_archive(archive)
        size_bytes = sum(entry.file_size for entry in archive.infolist())
        # Integers of a byte become numbers of eight, and are copied.
        require_unpackable(8 * size_bytes, f"a table of {size_bytes:,} bytes", file.stat().st_size)
    with np.load(file, allow_pickle=False) as stored:
        return dict(stored)
