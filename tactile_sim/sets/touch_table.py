"""Tables of touches whose places are given: read from a file, or made in Python."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from tactile_sim.user_values import real_array
from tactile_toolkit import store, touch
from tactile_toolkit.columns import column_types, tables, units
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.value_types import AnyArray, Float64, JsonDict

_POSITIONS = ("x_m", "y_m")
_NUMBERS = ("object_id", "round")
_POSES = ("object_x_m", "object_y_m", "object_turn_rad")
_COLUMNS = (*_POSITIONS, *_NUMBERS, *_POSES)
_INDEX_NAMES = ("column_1", "Unnamed: 0", "__index_level_0__")

# Larger values mean a wrong unit or column.
_MAX_TURNS_RAD = 1e4

# An object may be larger than the cell, and its origin off it.
_FARTHEST_M = {
    "x_m": touch.CELL_M[0] / 2,
    "y_m": touch.CELL_M[1] / 2,
    "object_x_m": 5 * touch.CELL_M[0],
    "object_y_m": 5 * touch.CELL_M[1],
}


@dataclass(frozen=True, eq=False)
class TouchTable:
    """A table of touches, in order within a round.

    Attributes
    ----------
    x_m, y_m : array of float, shape (n,)
        Where the gel goes, metres, cell frame.
    object_id : array of int, shape (n,), optional
        The `id` of the object that is touched. Without it, every object is touched at these places.
    round : array of int, shape (n,), optional
        Number of the round of the object, from 0. Without it, every round is made of these touches.
    object_x_m, object_y_m, object_turn_rad : array of float, shape (n,), optional
        Where the origin of the object's mesh lies while it is touched, metres, cell frame, and its turn about
        z, radians; it stands on the plate. All three or none: without them it lies as the plan says.

    Raises
    ------
    InputError
        Columns have different lengths, values are not finite, or a position lies outside the cell.
    """

    x_m: Float64
    y_m: Float64
    object_id: AnyArray | None = None
    round: AnyArray | None = None
    object_x_m: AnyArray | None = None
    object_y_m: AnyArray | None = None
    object_turn_rad: AnyArray | None = None

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
            CSV, TSV, JSON lines or Parquet, whose columns are named like the attributes; lengths may be in
            `_mm` or `_cm` instead of `_m`, the turn in `_deg` instead of `_rad`.

        Returns
        -------
        TouchTable

        Raises
        ------
        InputError
            The file does not exist, is not such a table, or holds values that the class refuses.
        """
        file = store.expanded(path)
        if file.suffix.lower() not in tables.Table.ENDINGS:
            raise InputError(
                f"given touches in {str(path)!r}: expected a file {', '.join(tables.Table.ENDINGS)}"
            )
        try:
            return cls(**_read_columns(file))
        except OSError as error:
            raise InputError(f"given touches in {str(path)!r} cannot be read ({error.strerror})") from error
        except (InputError, IntegrityError) as error:
            raise InputError(f"given touches in {str(path)!r}: {error}") from error

    @cached_property
    def rounds(self) -> int | None:
        """Number of rounds, or None where the table does not number them."""
        if self.round is None:
            return None
        return int(self.round.max()) + 1

    @cached_property
    def longest(self) -> int:
        """Number of touches of the longest round."""
        return max(len(rows) for rows in self._rows.values())

    def of(self, object_id: int, number: int) -> tuple[Float64, Float64 | None]:
        """Return the places of a round, shape (T, 2), and x, y and turn of the object, (T, 3), if given.

        T is 0 if the table has no such round.
        """
        key: tuple[int | None, int | None] = (object_id, number)
        if self.object_id is None:  # the same for every object
            key = (None, key[1])
        if self.round is None:  # the same for every round
            key = (key[0], None)
        rows = self._rows.get(key, [])
        positions = np.stack([getattr(self, name)[rows] for name in _POSITIONS], axis=1)
        if self.object_x_m is None:
            return positions, None
        return positions, np.stack([getattr(self, name)[rows] for name in _POSES], axis=1)

    def to_dict(self) -> JsonDict:
        """Return JSON values that identify the table: its columns, the number of rows, and a checksum."""
        columns = [getattr(self, name) for name in self._held]
        # Little-endian, so that the checksum does not depend on the machine.
        stored = b"".join(column.astype(column.dtype.newbyteorder("<")).tobytes() for column in columns)
        return {"columns": self._held, "rows": len(self.x_m), "sha256": hashlib.sha256(stored).hexdigest()}

    @property
    def _held(self) -> list[str]:
        return [name for name in _COLUMNS if name in _POSITIONS or getattr(self, name) is not None]

    @cached_property
    def _rows(self) -> dict[tuple[int | None, int | None], list[int]]:
        ids, rounds = (
            [None] * len(self.x_m) if column is None else column.tolist()
            for column in (self.object_id, self.round)
        )
        rows_of: dict[tuple[int | None, int | None], list[int]] = {}
        for row, key in enumerate(zip(ids, rounds, strict=True)):
            rows_of.setdefault(key, []).append(row)
        return rows_of


def _column(name: str, value: ArrayLike) -> AnyArray:
    """Return a column as float64 or int64; InputError, with the first bad row, where that is not possible."""
    numbers = real_array(value)
    if numbers is None or numbers.ndim != 1:
        raise InputError(
            f"column {name} of the given touches is {type(value).__name__}; expected a number for each touch"
        )
    if name in _NUMBERS:
        fits = (numbers == np.floor(numbers)) & (numbers >= 0) & (numbers < 2**53)
        expected = "an integer from 0"
    elif name in _FARTHEST_M:
        most = _FARTHEST_M[name]
        fits = np.abs(numbers) <= most
        expected = f"metres from {-most:g} to {most:g}"
    else:
        fits = np.abs(numbers) <= _MAX_TURNS_RAD
        expected = "radians"
    if not fits.all():
        row = int(np.argmin(fits))
        raise InputError(
            f"column {name} of the given touches is {np.asarray(value)[row]} in row {row}; expected "
            f"{expected}"
        )
    if name in _NUMBERS:
        return numbers.astype(np.int64)
    return numbers


def _read_columns(file: Path) -> dict[str, AnyArray]:
    """Read the columns of a table; InputError for other columns."""
    table = tables.Table.of(*store.split_uri(os.path.realpath(file)))
    read = table.whole(numbers=table.names)
    columns = {}
    for name, (ours, divisor) in _meanings(table.names).items():
        try:  # missing values become NaN, which is refused
            columns[ours] = column_types.floats_of(read[name]) / divisor
        except ValueError as error:
            raise InputError(f"column {name}: {error}; expected numbers") from error
    return columns


def meaning_of(name: str, known: Collection[str]) -> tuple[str, float] | None:
    """Return the known column for a name in any unit, such as ``x_mm``, and its divisor."""
    stem = name.rpartition("_")[0]
    unit = units.Quantity.stated_unit(name)
    for ours, per in (
        (f"{stem}_m", units.Quantity.LENGTH.per_unit),
        (f"{stem}_rad", units.Quantity.ANGLE.per_unit),
    ):
        if ours in known and unit in per:
            return ours, per[unit]
    return None


def _meanings(names: Sequence[str]) -> dict[str, tuple[str, float]]:
    """Return for each column of a table which of ours it is, and its divisor; InputError for other columns.

    A name may end in another unit, such as `x_mm` and `object_turn_deg`. The index of pandas is ignored.
    """
    meant: dict[str, tuple[str, float]] = {}
    named = [name for name in names if name not in _INDEX_NAMES]
    for name in named:
        meaning = meaning_of(name, _COLUMNS)
        if meaning is not None:
            meant[name] = meaning
        if name in _NUMBERS:
            meant[name] = name, 1.0
    named_columns = {ours for ours, _ in meant.values()}
    if len(named_columns) < len(named) or not set(_POSITIONS) <= named_columns:
        raise InputError(
            f"its columns are {', '.join(named)[:200]}; expected x_m, y_m and of these, each once: "
            f"{', '.join(_COLUMNS[2:])}; or lengths in _mm or _cm, and the turn in _deg"
        )
    return meant
