"""Touches whose places are given: read from a table, or made in Python."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tactile_sim.pressing import CELL_M
from tactile_toolkit import store
from tactile_toolkit.array_types import AnyArray, Float64
from tactile_toolkit.bounds import require_plain_archive, require_unpackable
from tactile_toolkit.errors import InputError
from tactile_toolkit.text_tables import TABLE_ENDINGS, table_text
from tactile_toolkit.units import PER_METRE, PER_RADIAN, stated_unit

_POSITIONS = ("x_m", "y_m")
_NUMBERS = ("object_id", "round")
_POSES = ("object_x_m", "object_y_m", "object_turn_rad")
_ENDINGS = (*TABLE_ENDINGS, ".parquet", ".npz")
_COLUMNS = (*_POSITIONS, *_NUMBERS, *_POSES)
_INDEX_NAMES = ("", "Unnamed: 0", "__index_level_0__")
# Memory that reading takes for each row, in whatever columns, with the numbers of rounds and objects.
_BYTES_PER_ROW = 512
# More is a wrong unit or column; sines are right up to a million turns.
_MOST_TURNS_RAD = 1e4
# An object may be larger than the cell, and its origin off it.
_FARTHEST_M = {
    "x_m": CELL_M[0] / 2,
    "y_m": CELL_M[1] / 2,
    "object_x_m": 5 * CELL_M[0],
    "object_y_m": 5 * CELL_M[1],
}


@dataclass(frozen=True, eq=False)
class TouchTable:
    """A table of touches, in order within a round.

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
        Columns of other lengths, values that are not finite numbers, a position outside the cell.
    """

    x_m: Any
    y_m: Any
    object_id: Any = None
    round: Any = None
    object_x_m: Any = None
    object_y_m: Any = None
    object_turn_rad: Any = None

    def __post_init__(self) -> None:
        for name in self._held:
            object.__setattr__(self, name, _column(name, getattr(self, name)))
        lengths = {name: len(getattr(self, name)) for name in self._held}
        if len(set(lengths.values())) != 1 or not len(self.x_m):
            held = ", ".join(f"{name} {count}" for name, count in lengths.items())
            raise InputError(
                f"given touches have columns of lengths {held}; expected one length of at least 1"
            )
        missing = [name for name in _POSES if name not in self._held]
        if 0 < len(missing) < len(_POSES):
            raise InputError(
                f"given touches have no {', '.join(missing)}; expected all of {', '.join(_POSES)}, or none"
            )

    @classmethod
    def read(cls, path: str | Path) -> TouchTable:
        """Read a table from a file.

        Parameters
        ----------
        path : str or path
            CSV with a header line, Parquet, or `.npz`, whose columns are named as the attributes; lengths may
            be in `_mm` or `_cm` instead of `_m`, the turn in `_deg` instead of `_rad`.

        Returns
        -------
        TouchTable

        Raises
        ------
        InputError
            The file is not there, is not such a table, or holds values as above.
        """
        file = store.expanded(path)
        if file.suffix.lower() not in _ENDINGS:
            raise InputError(f"given touches in {str(path)!r}: expected a file {', '.join(_ENDINGS)}")
        try:
            return cls(**_read_columns(file))
        except InputError as error:
            raise InputError(f"given touches in {str(path)!r}: {error}") from error
        except Exception as error:  # pyarrow, zipfile and numpy raise many kinds
            raise InputError(
                f"given touches in {str(path)!r} cannot be read ({error}); expected an intact "
                f"{file.suffix.lower()} file with columns {', '.join(_POSITIONS)}"
            ) from error

    @cached_property
    def rounds(self) -> int | None:
        """Number of rounds, or None where the table does not say."""
        return None if self.round is None else int(self.round.max()) + 1

    @cached_property
    def longest(self) -> int:
        """Most touches that a round has."""
        return max(len(rows) for rows in self._rows.values())

    def of(self, object_id: int, number: int) -> tuple[Float64, Float64 | None]:
        """Return the places of a round, shape (T, 2), and x, y and turn of the object, (T, 3), if given.

        T is 0 where the table has no such round.
        """
        # None stands for every object, and for every round.
        key = (None if self.object_id is None else object_id, None if self.round is None else number)
        rows = self._rows.get(key, [])
        places = np.stack([getattr(self, name)[rows] for name in _POSITIONS], axis=1)
        if self.object_x_m is None:
            return places, None
        return places, np.stack([getattr(self, name)[rows] for name in _POSES], axis=1)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values that decide what is made: which columns, how many rows, and their checksum."""
        columns = [getattr(self, name) for name in self._held]
        # Little-endian: the checksum is that of the numbers, not of the machine.
        stored = b"".join(column.astype(column.dtype.newbyteorder("<")).tobytes() for column in columns)
        return {"columns": self._held, "rows": len(self.x_m), "sha256": hashlib.sha256(stored).hexdigest()}

    @property
    def _held(self) -> list[str]:
        return [name for name in _COLUMNS if name in _POSITIONS or getattr(self, name) is not None]

    @cached_property
    def _rows(self) -> dict[tuple[int | None, int | None], list[int]]:
        nothing = [None] * len(self.x_m)
        ids = nothing if self.object_id is None else self.object_id.tolist()
        rounds = nothing if self.round is None else self.round.tolist()
        found: dict[tuple[int | None, int | None], list[int]] = {}
        for row, key in enumerate(zip(ids, rounds, strict=True)):
            found.setdefault(key, []).append(row)
        return found


def _column(name: str, value: Any) -> AnyArray:
    """Return one column as float64 or int64; InputError for what cannot be one, with the first bad row."""
    try:
        found = np.asarray(value)
        numbers = found.astype(np.float64)
    except (TypeError, ValueError):
        found = numbers = np.empty((0, 0))
    if numbers.ndim != 1 or found.dtype.kind not in "iuf":
        raise InputError(
            f"column {name} of the given touches is {type(value).__name__}; expected a number for each touch"
        )
    if name in _NUMBERS:
        fits = (numbers == np.floor(numbers)) & (numbers >= 0) & (numbers < 2**53)
        expected = "an integer from 0"
    else:
        most = _FARTHEST_M.get(name, _MOST_TURNS_RAD)
        fits = np.abs(numbers) <= most
        expected = f"metres from {-most:g} to {most:g}" if name in _FARTHEST_M else "radians"
    if not fits.all():
        row = int(np.argmin(fits))
        raise InputError(
            f"column {name} of the given touches is {found[row]} in row {row}; expected {expected}"
        )
    return found.astype(np.int64) if name in _NUMBERS else numbers


def _read_columns(file: Path) -> Mapping[str, Any]:
    """Read a table whose columns are those of touches; InputError for other columns, or too many rows."""
    with store.open_regular(file) as stream:
        size_bytes = file.stat().st_size
        if file.suffix.lower() == ".npz":
            with zipfile.ZipFile(stream) as archive:
                require_plain_archive(archive)
                unpacked = sum(entry.file_size for entry in archive.infolist())
                # Integers of a byte become numbers of eight, and are copied.
                require_unpackable(8 * unpacked, f"a table of {unpacked:,} bytes", size_bytes)
            with np.load(stream, allow_pickle=False) as stored:
                meant = _meaning(stored.files)
                return {ours: _scaled(stored[name], divisor) for name, (ours, divisor) in meant.items()}
        from pyarrow import parquet

        if file.suffix.lower() in TABLE_ENDINGS:
            table = _read_csv(stream.read(), str(file))
            meant = _numbers_in(table.schema, len(table), size_bytes)
        else:
            with parquet.ParquetFile(stream) as source:
                meant = _numbers_in(source.schema_arrow, source.metadata.num_rows, size_bytes)
                table = source.read()
    # What is missing becomes NaN, which is refused by its row.
    return {ours: _scaled(table.column(name).to_numpy(), divisor) for name, (ours, divisor) in meant.items()}


def _read_csv(content: bytes, path: str) -> Any:
    from pyarrow import csv

    text, separator = table_text(content, path)
    # A comma that separates nothing is the decimal mark.
    mark = "," if separator != "," and "," in text else "."
    table = csv.read_csv(
        io.BytesIO(text.encode()),
        parse_options=csv.ParseOptions(delimiter=separator),
        convert_options=csv.ConvertOptions(decimal_point=mark),
    )
    return table.rename_columns([name.strip() for name in table.column_names])


def _numbers_in(schema: Any, rows: int, size_bytes: int) -> dict[str, tuple[str, float]]:
    """Return what the columns of a table mean; InputError for other than numbers, or too many rows."""
    from pyarrow import types

    meant = _meaning(schema.names)
    for each in schema:
        if each.name in meant and not (types.is_integer(each.type) or types.is_floating(each.type)):
            raise InputError(f"column {each.name} holds {each.type}; expected numbers")
    require_unpackable(_BYTES_PER_ROW * rows, f"a table of {rows:,} rows", size_bytes)
    return meant


def _scaled(values: Any, divisor: float) -> Any:
    return values if divisor == 1 else values / divisor


def _meaning(names: Sequence[str]) -> dict[str, tuple[str, float]]:
    """Return for each column which of ours it is, and by what it is divided; InputError for others.

    Its name may end in another unit, as `x_mm` and `object_turn_deg`. The index, which
    pandas writes without a name or under one of its own, is passed over.
    """
    meant = {}
    for name in (each for each in names if each not in _INDEX_NAMES):
        stem, unit = name.rpartition("_")[0], stated_unit(name)
        for ours, per in ((f"{stem}_m", PER_METRE), (f"{stem}_rad", PER_RADIAN)):
            if ours in _COLUMNS and unit in per:
                meant[name] = ours, per[unit]
        if name in _NUMBERS:
            meant[name] = name, 1.0
    found = [ours for ours, _ in meant.values()]
    columns = [name for name in names if name not in _INDEX_NAMES]
    if len(set(found)) < len(columns) or not set(_POSITIONS) <= set(found):
        raise InputError(
            f"its columns are {', '.join(columns)[:200]}; expected x_m, y_m and of these, each once: "
            f"{', '.join(_COLUMNS[2:])}; or lengths in _mm or _cm, and the turn in _deg"
        )
    return meant
