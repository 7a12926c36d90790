"""Record data sets: lazy sequences of typed records over stored rows, and views of them."""

from __future__ import annotations

import hashlib
import html
import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import copy
from functools import reduce
from typing import Any, ClassVar, Generic, Self, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.array_types import AnyArray, Int64
from tactile_toolkit.builtin_values import is_integer, to_builtin_number
from tactile_toolkit.checked_fields import checked_integer
from tactile_toolkit.errors import InputError, IntegrityError, ToolkitError
from tactile_toolkit.read.columns import (
    RowGroup,
    Rows,
    column_types,
    table_bytes,
    whole_number,
    whole_numbers,
)
from tactile_toolkit.read.order import StoredParts
from tactile_toolkit.read.parquet import ShardedTable
from tactile_toolkit.read.source import RowSource
from tactile_toolkit.shown_text import printable
from tactile_toolkit.wording import class_name, with_count

T = TypeVar("T")

_SHOWN_PICTURES = 8
_MOST_NAMES = 10
_SHOWN_IDS = 4
# 0.7 + 0.2 + 0.1 is 0.9999999999999999.
_ROUNDING = 1e-9


class Row:
    """One stored row, its fields read on demand: ``group`` is the rows it belongs to, ``index`` its own."""

    __slots__ = ("group", "index")

    def __init__(self, group: Rows, index: int) -> None:
        self.group = group
        self.index = index

    def array(self, name: str) -> AnyArray:
        """Return a field of shape (n, width) as a read-only view of the stored values."""
        try:
            return self.group.ragged(name)[self.index]
        except IntegrityError:  # of another row, maybe: this one alone
            alone = self.group.table.slice(self.index, 1)
            return RowGroup(alone, self.path, self.number).ragged(name)[0]

    def value(self, name: str) -> Any:
        """Return a plain field as numpy's scalar or Python's object."""
        return self.group.flat(name)[self.index]

    def required(self, name: str) -> Any:
        """Return a plain field as :meth:`value` does; IntegrityError where it is null."""
        value = self.value(name)
        # Of a column with nulls, numpy makes NaN of those of numbers.
        missing = value is None or (isinstance(value, (float, np.floating)) and value != value)
        if missing and not self.group.arrow(name)[self.index].is_valid:
            raise self.group.damaged(name, self.index, "no value is stored")
        return value

    def integer(self, name: str) -> int:
        """Return a plain field as an int; IntegrityError where its value is none, as 1.5, or null."""
        value = self.value(name)
        if isinstance(value, np.signedinteger):
            return int(value)
        # A null next to it made numpy's column inexact.
        stored = self.group.arrow(name)[self.index].as_py()
        number = whole_number(stored)
        if number is None:
            found = "no value is stored" if stored is None else f"the value is {stored!r}"
            raise self.group.damaged(name, self.index, found, "an integer")
        return number

    def has(self, name: str) -> bool:
        """Return whether the data set has a column."""
        return name in self.group.names

    @property
    def path(self) -> str:
        """File that it is stored in."""
        return self.group.path

    @property
    def number(self) -> int:
        """Its row number in that file."""
        return self.group.first_row + self.index

    def equals(self, other: Row) -> bool:
        """Return whether two rows have the same columns and values, wherever they are stored."""
        import pyarrow as pa

        one, another = (
            pa.table({name: row.group.arrow(name).slice(row.index, 1) for name in sorted(row.group.names)})
            for row in (self, other)
        )
        if one.schema != another.schema:
            return False
        # To Arrow a NaN equals nothing; written it equals itself.
        return bool(one.equals(another)) or repr(one.to_pydict()) == repr(another.to_pydict())

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as a table of this one row, not as its entire row group."""
        content = table_bytes(self.group.table.slice(self.index, 1)).to_pybytes()
        return _row_from_ipc, (content, self.path, self.number)


def _row_from_ipc(content: bytes, path: str, number: int) -> Row:
    import pyarrow as pa

    return Row(RowGroup(pa.ipc.open_stream(content).read_all(), path, number), 0)


class Record:
    """Base of typed records of one row: frozen, each field loaded on first use, picklable."""

    __slots__ = ("_loaded", "_row")
    _row: Row
    _loaded: dict[str, Any]

    def __init__(self, row: Row) -> None:
        object.__setattr__(self, "_row", row)
        object.__setattr__(self, "_loaded", {})

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{type(self).__name__} is frozen; {name!r} cannot be set")

    def __reduce__(self) -> tuple[Any, ...]:
        return (type(self), (self._row,))

    def __eq__(self, other: object) -> bool:
        """Return whether the other is a record of the same kind with the same stored values."""
        if not isinstance(other, Record) or type(other) is not type(self):
            return NotImplemented
        return self._row.equals(other._row)

    def __hash__(self) -> int:
        # Of this row alone: a neighbour's damage must not make a record differ from its pickled copy.
        try:
            number = self._row.group.arrow("id")[self._row.index].as_py()
        except (KeyError, ValueError):
            number = None
        return hash((type(self), number))

    def _tile_html(self) -> str:
        """Return what a notebook shows of the record among others: a small picture, where there is any."""
        return ""

    def _once(self, name: str, load: Callable[[], T]) -> T:
        """Load a field on its first use and keep it."""
        loaded = self._loaded
        if name not in loaded:
            loaded[name] = load()
        value: T = loaded[name]
        return value


def checked_index(index: int, length: int, of: str, things: str) -> int:
    """Turn an index that may count from the end into one from 0; IndexError, in these words, out of range."""
    if not -length <= index < length:
        raise IndexError(f"{of} {index} is out of range for {length} {things}")
    return index + length if index < 0 else index


def flattened(values: Iterable[Any]) -> Iterator[Any]:
    """Yield values, and those of collections among them, at any depth."""
    for value in values:
        if isinstance(value, Iterable) and not isinstance(value, (str, bytes)):
            yield from flattened(value)
        else:
            yield value


def picks_several(index: Any) -> bool:
    """Return whether an index stands for several items: a slice, or a list, array or tensor of them."""
    if isinstance(index, (slice, list, tuple)):
        return True
    return hasattr(index, "__array__") and np.ndim(index) > 0


def positions(index: Any, length: int) -> Int64:
    """Turn a slice, ints or a boolean mask into positions, shape (n,), 0 to below that length.

    Raises IndexError for a mask of another length and for ints out of range, TypeError for anything else.
    """
    if isinstance(index, slice):
        return np.arange(*index.indices(length))
    chosen = np.asarray(index)
    if chosen.ndim != 1 or (chosen.size and chosen.dtype.kind not in "iub"):
        raise TypeError(
            f"rows are chosen by a slice, ints or booleans, not {chosen.dtype} of shape {chosen.shape}"
        )
    found: Int64 = np.arange(length)[chosen if chosen.size else np.zeros(0, np.int64)]
    return found


class RecordDataset(Sequence[T], Generic[T]):
    """A lazy sequence of records.

    Indexing with an int gives a record; with a slice, a list or array of ints, or a boolean mask gives a
    view that copies no data, and views of views compose. ``a + b`` joins data sets of one kind. Opening reads
    no row; safe to share between threads, to fork and to pickle. Data sets are equal that hold equal records
    in the same order. What is drawn at random follows from the seed and the number of items alone: not from
    what was read before, the machine or the version of numpy.

    Parameters
    ----------
    table : ShardedTable
        Stored rows.
    rows : sequence of int, optional
        Which of them, in which order; all by default.
    label_names : sequence of str
        Name of each class.
    """

    record_class: ClassVar[Any] = Record
    things: ClassVar[str] = "rows"
    """What the items are called."""

    def __init__(
        self,
        table: ShardedTable,
        rows: range | Int64 | None = None,
        label_names: Sequence[str] = (),
    ) -> None:
        self._table = table
        self._rows = range(len(table)) if rows is None else rows
        self._label_names = tuple(label_names)

    @property
    def label_names(self) -> tuple[str, ...]:
        """Name of each class, in order of the label."""
        return self._label_names

    @property
    def ids(self) -> AnyArray:
        """Id of each row, shape (len,); reads the id column only."""
        values = self.column("id")
        are_whole = values.dtype.kind == "f" and whole_numbers(values).all()
        return values.astype(np.int64) if are_whole else values

    @property
    def column_names(self) -> tuple[str, ...]:
        """Columns that all rows have, as they are stored; a struct goes by its fields: ``info.gel_id``."""
        return tuple(self._types)

    @property
    def _types(self) -> dict[str, Any]:
        """Arrow type of each column that joined sets store alike, by dotted name; structs are left out."""
        import pyarrow as pa

        found, *others = [column_types(schema) for schema in self._table.schemas] or [{}]
        return {
            name: each
            for name, each in found.items()
            if not pa.types.is_struct(each) and all(other.get(name) == each for other in others)
        }

    def _stores(self, name: str) -> list[bool]:
        return [name in column_types(schema) for schema in self._table.schemas]

    def has_column(self, name: str) -> bool:
        """Return whether all rows have a stored column, by dotted name."""
        return all(self._stores(name))

    def _integers(self, name: str, unstored: Callable[[], Int64], stored: Callable[[T], int]) -> Int64:
        """Read a column of integers; ``unstored`` gives all of a set without it, ``stored`` that of a row."""
        known = self._stores(name)
        if all(known):
            return self.int_column(name)
        # Joined sets may differ.
        return np.array([stored(each) for each in self], np.int64) if any(known) else unstored()

    @property
    def _plain_columns(self) -> tuple[str, ...]:
        import pyarrow as pa

        large = (pa.types.is_nested, pa.types.is_binary)
        return tuple(name for name, each in self._types.items() if not any(test(each) for test in large))

    def to_hf(self) -> Any:
        """Return the rows as a data set of the library `datasets`, with their features.

        Nothing is copied where the cache can be written: it views the rows where they lie unpacked, and only
        row groups that hold some of these rows are unpacked. (Pickled, as for workers that are spawned, it
        takes its rows along; ours takes their addresses.)

        Returns
        -------
        datasets.Dataset
            The same rows in the same order, with the columns that all of them have.

        Raises
        ------
        IntegrityError
            A file is damaged.
        """
        import pyarrow as pa
        from datasets import Dataset

        rows = [self._row(int(number)) for number in self._rows]
        blocks = {(row.path, row.group.first_row): row.group.table for row in rows}
        starts = dict(zip(blocks, np.cumsum([0, *map(len, blocks.values())]).tolist(), strict=False))
        places = [starts[row.path, row.group.first_row] + row.index for row in rows]
        parts = list(blocks.values()) or [schema.empty_table() for schema in self._table.schemas[:1]]
        if not parts:
            return Dataset.from_dict({})
        shared = set.intersection(*({(each.name, each.type) for each in part.schema} for part in parts))
        names = [each.name for each in parts[0].schema if (each.name, each.type) in shared]
        table = pa.concat_tables([part.select(names) for part in parts])
        # Its own fingerprint would be that of all bytes.
        content = repr([names, list(starts), self.identity])
        stored = Dataset(table, fingerprint=hashlib.sha256(content.encode()).hexdigest()[:16])
        return stored if places == list(range(len(table))) else stored.select(places)

    def column(self, name: str) -> AnyArray:
        """Read one plain column, shape (len,), without touching any other.

        Raises
        ------
        InputError
            When the data set has no such column.
        """
        try:
            values = self._table.column(name)
        except KeyError as error:
            raise InputError(f"no column {name!r} in this data set") from error
        rows = self._rows
        if isinstance(rows, range):
            # One that runs down to row 0 stops at -1, which to a slice is the last row.
            return values[rows.start : rows.stop if rows.stop >= 0 else None : rows.step]
        return values[rows]

    def int_column(self, name: str) -> Int64:
        """Read one column of integers, shape (len,), int64, without touching any other.

        Raises
        ------
        InputError
            When the data set has no such column.
        IntegrityError
            A value is missing, not an integer, or does not fit into 64 bits; names file and row.
        """
        values = self.column(name)
        usable = whole_numbers(values)
        if usable.all():
            return np.ascontiguousarray(values, np.int64)
        # With a missing value in any row, chosen or not, large ones are inexact; the row itself knows.
        found = np.where(usable, values, 0).astype(np.int64)
        for position in np.flatnonzero(~usable).tolist():
            found[position] = self._row(int(self._rows[position])).integer(name)
        return found

    @property
    def identity(self) -> str:
        """What distinguishes the stored rows that this is a view of from all others, later ones there too."""
        return self._table.identity

    @property
    def labels(self) -> Int64:
        """Label of each item, shape (len,), int64; reads the label column only.

        Raises
        ------
        IntegrityError
            A label is missing, not an integer, or does not fit into 64 bits.
        """
        return self.int_column("label")

    @property
    def splits(self) -> tuple[str, ...]:
        """Splits that the rows are of, by the names of their files."""
        return tuple(dict.fromkeys(split for _, split in self._table.origins if split))

    def __len__(self) -> int:
        return len(self._rows)

    def _item(self, position: int) -> T:
        """Return one item; IndexError out of range."""
        length = len(self._rows)
        # Not `checked_index`, which would cost a tenth of all that `touches[i]` does.
        if not -length <= position < length:
            raise IndexError(f"index {position} is out of range for {with_count(length, self.things)}")
        return self._stored(int(self._rows[position]))

    def _select(self, chosen: slice | Int64) -> Self:
        """Return a view of the items at some positions."""
        return self._view(self._rows[chosen] if isinstance(chosen, slice) else self._row_numbers[chosen])

    def _view(self, rows: range | Int64) -> Self:
        view = copy(self)
        view._rows = rows
        return view

    @property
    def _row_numbers(self) -> Int64:
        return np.asarray(self._rows, np.int64)

    @overload
    def __getitem__(self, index: int) -> T: ...
    @overload
    def __getitem__(self, index: slice | Sequence[int] | Sequence[bool] | AnyArray) -> Self: ...
    def __getitem__(self, index: Any) -> T | Self:
        """Return an item (int) or a view (slice, or a list, array or tensor of ints or booleans).

        Raises
        ------
        IndexError
            An int is out of range, or a mask has another length.
        TypeError
            It is something else.
        """
        if isinstance(index, int):
            return self._item(index)
        if isinstance(index, slice):
            return self._select(index)
        if picks_several(index):
            return self._select(positions(index, len(self)))
        return self._item(operator.index(index))

    def by_id(self, id: int | str) -> T:
        """Return the item that has an id, the first one where several have it; reads the ids only.

        Parameters
        ----------
        id : int or str
            The ``id`` of the item: a number for digits, scenes and other meshes, text for rounds and touches.

        Raises
        ------
        InputError
            No item has it, or the items have no ids.
        """
        number = to_builtin_number(id)
        places = np.flatnonzero(self.ids == number)
        if not len(places):
            # Those of items, for touches have others than the column of their rounds.
            first = [repr(getattr(item, "id", None)) for item in self[:_SHOWN_IDS]]
            raise InputError(
                f"{', '.join(self._description())}: there is no id {id!r}",
                next=f"give one such as {', '.join(first) or '(none, it is empty)'}",
            )
        return self._item(int(places[0]))

    def select(self, indices: Iterable[int]) -> Self:
        """Return the items at some places, in the order given; same as indexing with a list.

        Raises
        ------
        IndexError
            One is out of range.
        TypeError
            They are not integers.
        """
        return self._select(positions(indices if picks_several(indices) else list(indices), len(self)))

    def filter(self, function: Callable[[T], Any]) -> Self:
        """Return the items for which a function is true, in their order.

        Only the fields that the function asks for are read.
        """
        kept = np.zeros(len(self), bool)
        for position, item in self._each():
            kept[position] = bool(function(item))
        return self._select(np.flatnonzero(kept))

    def filter_labels(self, *labels: int | str | Iterable[int | str]) -> Self:
        """Return the items of some classes, given as numbers or names, or as sequences of them.

        Raises
        ------
        InputError
            A class is not one of :attr:`label_names`.
        """
        wanted = list(map(self._label_number, flattened(labels)))
        return self._select(np.flatnonzero(np.isin(self.labels, wanted)))

    def by_label(self) -> dict[str, Self]:
        """Return one view per class, by class name."""
        labels = self.labels
        return {
            name: self._select(np.flatnonzero(labels == number))
            for number, name in enumerate(self.label_names)
        }

    def shuffle(self, seed: int) -> Self:
        """Return all items in a random order, the same for the same seed and length everywhere.

        Parameters
        ----------
        seed : int
            From 0.

        Raises
        ------
        InputError
            The seed is not an integer from 0.
        """
        return self._select(self._order(seed))

    def sample(self, n: int, seed: int) -> Self:
        """Return so many items, drawn at random without repetition.

        These are the first ``n`` of :meth:`shuffle`: a larger sample of the same seed holds a smaller one.

        Parameters
        ----------
        n : int
            How many, at most as many as there are.
        seed : int
            From 0.

        Raises
        ------
        InputError
            There are fewer items, or a number is not a whole one from 0.
        """
        return self._select(self._order(seed)[: checked_integer(n, "n, the size of a sample,", 0, len(self))])

    def split(self, *parts: float, seed: int, stratify: bool = False) -> tuple[Self, ...]:
        """Divide the items at random into parts that share none and leave none out.

        As `datasets`, scikit-learn and torch do, items are drawn whatever their classes unless asked
        otherwise.

        Parameters
        ----------
        *parts : float or int
            Size of each part: shares as floats, which add up to at most 1, or numbers of items as ints. What
            they leave is one more part, the last: ``train, test = digits.split(0.8, seed=0)``.
        seed : int
            From 0.
        stratify : bool
            Give each class to all parts in the same shares, up to one item or so.

        Returns
        -------
        tuple of views
            Each in random order. Shares are rounded where they end, so that no part is off by an item or
            more.

        Raises
        ------
        InputError
            Parts add up to more than there is, are negative or of both kinds; or the seed is not a whole
            number from 0.

        Notes
        -----
        Touches of one round, or rounds of one object, may come into several parts. Divide the objects
        instead where that matters.
        """
        ends = _part_ends([to_builtin_number(part) for part in parts], len(self))
        order = self._order(seed)
        if not stratify:
            return tuple(self._select(part) for part in np.split(order, ends)[: len(ends)])
        # Each class is spread evenly over 0 to 1, from a start of its own: a cut anywhere divides all classes
        # alike, up to one item of each.
        labels = self.labels[order]
        classes, counts = np.unique(labels, return_counts=True)
        # Numbers behind those of the order, which is the same whether classes are asked for or not.
        starts = _numbers(seed, len(order) + len(classes))[len(order) :] / 2.0**64
        spread = np.empty(len(order))
        for label, count, start in zip(classes, counts, starts, strict=True):
            spread[labels == label] = (np.arange(count) + start) / count
        part_of = np.empty(len(order), np.int64)
        part_of[np.argsort(spread, kind="stable")] = np.searchsorted(ends, np.arange(len(order)), "right")
        return tuple(self._select(order[part_of == part]) for part in range(len(ends)))

    def to_pandas(self) -> Any:
        """Return the plain columns as a table with one row for each item.

        Meshes, images and other lists stay where they are: ``to_hf().to_pandas()`` has them too.
        ``to_pandas().describe()`` sums up the numbers.

        Returns
        -------
        pandas.DataFrame
        """
        import pandas as pd

        return pd.DataFrame({name: self.column(name) for name in self._plain_columns})

    @classmethod
    def concatenate(cls, datasets: Iterable[Self]) -> Self:
        """Join data sets of one kind end to end; same as ``a + b + ...``.

        Raises
        ------
        InputError
            When there is nothing to join, or class names differ.
        """
        parts = list(datasets)
        if not parts:
            raise InputError("nothing to concatenate; expected at least one data set")
        return reduce(operator.add, parts)

    def __add__(self, other: Self) -> Self:
        if type(other) is not type(self):
            return NotImplemented
        if other.label_names != self.label_names:
            raise InputError(f"cannot join data sets with classes {self.label_names} and {other.label_names}")
        return self._concat(other)

    def __iter__(self) -> Iterator[T]:
        for position in range(len(self)):
            yield self._item(position)

    def __eq__(self, other: object) -> bool:
        """Return whether both hold equal items in the same order, with the same names of classes."""
        if not isinstance(other, type(self)) or type(other) is not type(self):
            return NotImplemented
        if len(self) != len(other) or self.label_names != other.label_names:
            return False
        if self.identity == other.identity and np.array_equal(self._rows, other._rows):
            return True
        return all(one == another for one, another in zip(self, other, strict=True))

    def __hash__(self) -> int:
        # Equal sets have equal hashes; what the rows hold is not read for that.
        return hash((type(self), len(self), self.label_names))

    def __repr__(self) -> str:
        return printable(
            f"{type(self).__name__}({', '.join([*self._description(), self._classes_in_words()])})"
        )

    def _repr_html_(self) -> str:
        """Show what it is, and small pictures of some items or what is wrong with them, in a notebook."""
        pictures: list[str] = []
        problems: dict[str, None] = {}
        for position in np.linspace(0, len(self) - 1, min(len(self), _SHOWN_PICTURES)).round().tolist():
            try:
                item: Any = self._item(int(position))
                pictures.append(item._tile_html())
            except (ToolkitError, ValueError, OSError) as error:
                problems[f"<div>{html.escape(printable(str(error)))}</div>"] = None  # each once
        tiles = f'<div style="display:flex;flex-wrap:wrap;gap:4px">{"".join(pictures)}</div>'
        return f"<div>{html.escape(repr(self))}{tiles if any(pictures) else ''}{''.join(problems)}</div>"

    def _row(self, number: int) -> Row:
        """Return a row by its number among those that are stored."""
        return Row(*self._table.locate(number))

    def _stored(self, row: int) -> T:
        record: T = self.record_class(self._row(row))
        return record

    def _concat(self, other: Self) -> Self:
        joined = self._view(np.concatenate([self._row_numbers, other._row_numbers + len(self._table)]))
        joined._table = ShardedTable((*self._table.shards, *other._table.shards))
        return joined

    def _stored_parts(self) -> StoredParts:
        rows, starts = self._rows, self._table.part_starts
        if isinstance(rows, range) and rows.step == 1:
            return StoredParts(np.unique(np.clip(starts, rows.start, rows.stop) - rows.start))
        order = np.argsort(self._row_numbers, kind="stable")
        return StoredParts(np.unique(np.searchsorted(self._row_numbers[order], starts)), order)

    def _row_groups(self, chosen: Int64) -> list[tuple[RowSource, int]]:
        rows = self._rows
        numbers = np.unique(rows.start + rows.step * chosen if isinstance(rows, range) else rows[chosen])
        return self._table.row_groups(numbers)

    def _description(self) -> list[str]:
        return with_origins(with_count(len(self), self.things), self._table)

    def _each(self) -> Iterator[tuple[int, T]]:
        """Yield place and item of all, in whatever order is quickest, for looking at small fields."""
        return enumerate(self)

    def _order(self, seed: int) -> Int64:
        return np.argsort(_numbers(seed, len(self)), kind="stable")

    def _label_number(self, label: Any) -> int:
        known, number = self.label_names, to_builtin_number(label)
        if number in known:
            return known.index(number)
        if is_integer(number) and 0 <= number < len(known):
            return int(number)
        listed = ", ".join(known)
        raise InputError(f"no class {label!r}; expected an integer below {len(known)} or one of {listed}")

    def _class_counts(self) -> dict[str, int]:
        if "label" not in self._plain_columns:
            return {}
        known, (numbers, counts) = self.label_names, np.unique(self.labels, return_counts=True)
        names = (class_name(known, label) for label in numbers.tolist())
        return dict.fromkeys(known, 0) | dict(zip(names, counts.tolist(), strict=True))

    def _classes_in_words(self) -> str:
        try:
            names = [name for name, count in self._class_counts().items() if count]
        except (ToolkitError, ValueError, OSError):
            return "classes unreadable"
        if not names:
            return "no classes"
        further = len(names) - _MOST_NAMES
        shown = names if further <= 0 else [*names[:_MOST_NAMES], f"{further:,} more"]
        return f"{'class' if len(names) == 1 else 'classes'} {', '.join(shown)}"


def with_origins(things: str, table: ShardedTable) -> list[str]:
    """Say of what data sets and splits some things are, such as ``20 rows``."""
    origins = table.origins
    names = dict.fromkeys(name for name, _ in origins)
    splits = dict.fromkeys(f"split {split}" for _, split in origins if split)
    return [f"{things} of {' and '.join(names)}" if names else things, *splits]


def _numbers(seed: int, count: int) -> NDArray[np.uint64]:
    """Return random bits: of the stream of PCG64, which numpy promises to keep, unlike its shuffles."""
    return np.asarray(np.random.PCG64(checked_integer(seed, "seed")).random_raw(count), np.uint64)


def _part_ends(parts: Sequence[Any], length: int) -> list[int]:
    """Return where each part ends, the one that is left over included; InputError for impossible sizes."""
    numbers, shares = is_integer(*parts), all(isinstance(part, float) and 0 <= part <= 1 for part in parts)
    total, whole = (sum(parts), length) if numbers or shares else (0, 0)
    whole = whole if numbers else 1
    if not parts or not (numbers or shares) or total > whole + _ROUNDING or min(parts) < 0:
        asked = ", ".join(map(repr, parts)) or "nothing"
        raise InputError(
            f"a split into {asked} was asked for; expected shares such as 0.8, 0.2 that add up to at most 1, "
            f"or integers that add up to at most {with_count(length, 'rows')}"
        )
    if numbers:
        ends = np.cumsum(parts).tolist()
    else:
        ends = np.minimum(np.round(np.cumsum(parts) * length), length).astype(int).tolist()
    return ends if total >= whole - _ROUNDING else [*ends, length]
