"""Record data sets: lazy sequences of typed records over stored rows, and views of them."""

from __future__ import annotations

import hashlib
import html
import operator
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import copy
from functools import reduce
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeVar, overload

import numpy as np
import pyarrow as pa

from tactile_toolkit import checked_fields, errors, wording
from tactile_toolkit.read import order, record, schemas, shard, sharded_table
from tactile_toolkit.read.record import Record, Row
from tactile_toolkit.read.sharded_table import explain_batches
from tactile_toolkit.value_types import AnyArray, Int64

if TYPE_CHECKING:
    import pandas as pd
    from datasets import Dataset

T = TypeVar("T")
S = TypeVar("S")
_SHOWN_PICTURES = 8
_MAX_NAMES = 10
_SHOWN_IDS = 4


class LazySequence(Sequence[T], Generic[T, S]):
    """A sequence whose items are made on access: an int gives one of them.

    A slice, a list or array of ints, or a boolean mask gives several, as :meth:`_several` makes them.
    """

    __slots__ = ()
    thing: ClassVar[str]
    things: ClassVar[str]
    """Nouns for an item and for several."""

    @overload  # type: ignore[override]
    def __getitem__(self, index: int) -> T: ...

    @overload
    def __getitem__(self, index: slice | Sequence[int] | Sequence[bool] | AnyArray) -> S: ...

    def __getitem__(self, index: Any) -> T | S:
        """Return an item (int), or several of them (a slice, or a list, array or tensor).

        Raises
        ------
        IndexError
            An int is out of range, or a mask has another length.
        TypeError
            The index has another type.
        """
        if _picks_several(index):
            return self._several(index if isinstance(index, slice) else positions(index, len(self)))
        return self._item(self.checked_index(operator.index(index)))

    def checked_index(self, index: int) -> int:
        """Return the index of an item from the start; IndexError if it is out of range."""
        length = len(self)
        if not -length <= index < length:
            words = wording.with_count(length, self.things)
            raise IndexError(f"{self.thing} {index} is out of range for {words}")
        return index % length

    def checked_indices(self, index: object) -> list[int]:
        """Return the indices of several items from the start; raises as indexing does."""
        indices: list[int] = positions(index, len(self)).tolist()
        return indices

    @abstractmethod
    def _item(self, index: int) -> T:
        """Return one item by its index from the start."""

    @abstractmethod
    def _several(self, index: Any) -> S:
        """Return several items; the index is as the user gave it."""


class RecordDataset(Sequence[T], Generic[T]):
    """A lazy sequence of records.

    Indexing with an int gives a record; a slice, a list or array of ints, or a boolean mask gives a view
    without copying data, and views of views compose. ``a + b`` joins data sets of one kind. Opening reads no
    row. Data sets can be shared between threads, forked and pickled. They are equal if they hold equal
    records in the same order. Random choices depend only on the seed and the number of items, not on earlier
    reads, the machine or the version of numpy.

    Parameters
    ----------
    table : ShardedTable
        Stored rows.
    rows : sequence of int, optional
        Numbers of the rows, in order; all by default.
    label_names : sequence of str
        Name of each class.
    """

    record_class: ClassVar[Any] = Record

    things: ClassVar[str] = "rows"
    """Noun for the items, in the plural."""

    def __init__(
        self,
        table: sharded_table.ShardedTable,
        rows: range | Int64 | None = None,
        label_names: Sequence[str] = (),
    ) -> None:
        self.table = table
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
        are_whole = values.dtype.kind == "f" and record.whole_numbers(values).all()
        if are_whole:
            values = values.astype(np.int64)
        return values

    @property
    def object_ids(self) -> AnyArray:
        """Id of the object of each row, shape (len,), by which users choose; usually that of the row."""
        return self.ids

    @property
    def column_names(self) -> tuple[str, ...]:
        """Stored columns that all rows have; fields of structs have dotted names: ``info.gel_id``."""
        return tuple(self._types)

    @property
    def _types(self) -> dict[str, pa.DataType]:
        """Arrow type of each column that joined sets share, by dotted name, without structs."""
        types, *further_types = [schemas.column_types(schema) for schema in self.table.schemas] or [{}]
        return {
            name: data_type
            for name, data_type in types.items()
            if not pa.types.is_struct(data_type)
            and all(shared.get(name) == data_type for shared in further_types)
        }

    def _stores(self, name: str) -> list[bool]:
        return [name in schemas.column_types(schema) for schema in self.table.schemas]

    def has_column(self, name: str) -> bool:
        """Return whether all rows have a stored column, by dotted name."""
        return all(self._stores(name))

    @property
    def plain_columns(self) -> tuple[str, ...]:
        """Names of the columns of numbers and texts."""
        large = (pa.types.is_nested, pa.types.is_binary)
        return tuple(
            name for name, data_type in self._types.items() if not any(test(data_type) for test in large)
        )

    def to_hf(self) -> Dataset:
        """Return the rows as a data set of the library `datasets`, with their features.

        Nothing is copied if the cache can be written: the result views unpacked rows, and only row groups
        with rows of this data set are unpacked. When pickled, as for spawned workers, it contains its rows,
        unlike this class, which pickles their addresses.

        Returns
        -------
        datasets.Dataset
            The same rows in the same order, with their common columns.

        Raises
        ------
        IntegrityError
            A file is damaged.
        """
        # `datasets` takes seconds to import.
        from datasets import Dataset

        rows = [self._row_at(int(number)) for number in self._rows]
        blocks = {(row.path, row.group.first_row): row.group.table for row in rows}
        starts = dict(zip(blocks, np.cumsum([0, *map(len, blocks.values())]).tolist(), strict=False))
        row_indices = [starts[row.path, row.group.first_row] + row.index for row in rows]
        parts = list(blocks.values()) or [schema.empty_table() for schema in self.table.schemas[:1]]
        if not parts:
            return Dataset.from_dict({})
        shared = set.intersection(*({(column.name, column.type) for column in part.schema} for part in parts))
        names = [column.name for column in parts[0].schema if (column.name, column.type) in shared]
        table = pa.concat_tables([part.select(names) for part in parts])
        # Its default fingerprint would hash all bytes.
        content = repr([names, list(starts), self.identity])
        stored = Dataset(table, fingerprint=hashlib.sha256(content.encode()).hexdigest()[:16])
        if row_indices != list(range(len(table))):
            stored = stored.select(row_indices)
        return stored

    def column(self, name: str) -> AnyArray:
        """Read one plain column, shape (len,), and no other.

        Raises
        ------
        InputError
            When the data set has no such column.
        """
        try:
            values = self.table.column(name)
        except KeyError as error:
            known = self.plain_columns
            raise errors.InputError(
                f"no column {name!r} in this data set{wording.did_you_mean(name, known)}; it has the columns "
                f"{', '.join(self.column_names)}",
                next="name one of these",
            ) from error
        rows = self._rows
        if isinstance(rows, range):
            # A range down to row 0 stops at -1, which a slice takes for the last row.
            return values[rows.start : rows.stop if rows.stop >= 0 else None : rows.step]
        return values[rows]

    def int_column(self, name: str) -> Int64:
        """Read one column of integers, shape (len,), int64, and no other.

        Raises
        ------
        InputError
            When the data set has no such column.
        IntegrityError
            A value is missing, not an integer, or does not fit into 64 bits; names file and row.
        """
        values = self.column(name)
        usable = record.whole_numbers(values)
        if usable.all():
            return np.ascontiguousarray(values, np.int64)
        # A missing value in any row makes large ones inexact, so they are read from the row itself.
        integers = np.where(usable, values, 0).astype(np.int64)
        for position in np.flatnonzero(~usable).tolist():
            integers[position] = self._row_at(int(self._rows[position])).integer(name)
        return integers

    @property
    def identity(self) -> str:
        """Text that identifies the stored rows, which changes when files are replaced."""
        return self.table.identity

    @property
    def files(self) -> tuple[shard.Shard, ...]:
        """The Parquet files that the data set was opened from, whichever rows of them it holds."""
        return self.table.files

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
        """Splits of the rows, by the names of their files."""
        return tuple(dict.fromkeys(split for _, split in self.table.origins if split))

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def row_numbers(self) -> Int64:
        """Number of each item among all rows of the files, shape (len,)."""
        return np.asarray(self._rows, np.int64)

    def to_pandas(self) -> pd.DataFrame:
        """Return the plain columns as a table with one row for each item.

        Meshes, images and other lists are left out; ``to_hf().to_pandas()`` includes them.

        Returns
        -------
        pandas.DataFrame
        """
        # pandas takes half a second to import.
        import pandas as pd

        return pd.DataFrame({name: self.column(name) for name in self.plain_columns})

    def _row_at(self, number: int) -> Row:
        """Return a stored row by number."""
        return Row(*self.table.locate(number))

    def stored_parts(self) -> order.StoredParts:
        """Return which items are stored together, in files and row groups."""
        numbers, starts = self._stored_numbers, self._stored_starts
        if (np.diff(numbers) == 1).all():
            return order.StoredParts(np.unique(np.searchsorted(numbers, starts)))
        stored = np.argsort(numbers, kind="stable")
        return order.StoredParts(np.unique(np.searchsorted(numbers[stored], starts)), stored)

    @property
    def _stored_numbers(self) -> Int64:
        """Number of each item among all that are stored, shape (len,), int64."""
        return self.row_numbers

    @property
    def _stored_starts(self) -> Int64:
        """Number of the first item of each part that training shuffles, and of all stored items."""
        return self.table.part_starts

    def row_groups(self, chosen: Int64) -> list[tuple[sharded_table.RowSource, int]]:
        """Return the row groups of rows at positions (n,), each once: a source, and a number in it."""
        rows = self._rows
        numbers = np.unique(rows.start + rows.step * chosen if isinstance(rows, range) else rows[chosen])
        return self.table.row_groups(numbers)

    def _integers(self, name: str, unstored: Callable[[], Int64], stored: Callable[[T], int]) -> Int64:
        """Read a column of integers; ``unstored`` computes it for sets without it, ``stored`` for one row."""
        known = self._stores(name)
        if all(known):
            return self.int_column(name)
        # Joined sets may differ.
        return np.array([stored(item) for item in self], np.int64) if any(known) else unstored()

    def _row_number(self, position: int) -> int:
        """Return the row number of an item; IndexError out of range."""
        # Not by the steps of `LazySequence`, which would take a tenth of the time of `touches[i]`.
        length = len(self._rows)
        if not -length <= position < length:
            raise IndexError(
                f"index {position} is out of range for {wording.with_count(length, self.things)}"
            )
        return int(self._rows[position])

    def _item(self, position: int) -> T:
        return self._stored(self._row_number(position))

    def _select(self, chosen: slice | Int64) -> Self:
        """Return a view of items at given positions."""
        return self._view(self._rows[chosen] if isinstance(chosen, slice) else self.row_numbers[chosen])

    def _view(self, rows: range | Int64) -> Self:
        view = copy(self)
        vars(view).update(_rows=rows)
        return view

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
            The index has another type.
        """
        if isinstance(index, int):  # first: most are
            return self._item(index)
        if _picks_several(index):
            return self._chosen(index)
        if isinstance(index, str):
            step = "name one of the columns with .column(NAME): " + ", ".join(self.plain_columns)
            if index in self.plain_columns:
                step = f"write .column({index!r})"
            raise TypeError(f"{self.things} are chosen by number, and {index!r} is a text; next: {step}")
        return self._item(operator.index(index))

    def __getitems__(self, indices: Sequence[int]) -> list[T]:
        """Return the items of a batch; a ``DataLoader`` of torch calls it."""
        explain_batches()
        return [self[index] for index in indices]

    def _chosen(self, index: object) -> Self:
        """Return a view of the items that a slice, ints or a mask select."""
        return self._select(index if isinstance(index, slice) else positions(index, len(self)))

    def by_id(self, id: int | str) -> T:
        """Return the first item with an id; reads only the ids.

        Parameters
        ----------
        id : int or str
            The ``id`` of the item: a number for digits, scenes and other meshes, text for rounds and touches.

        Raises
        ------
        InputError
            No item has this id, or the items have no ids.
        """
        number = checked_fields.to_builtin_number(id)
        matches = np.flatnonzero(self.ids == number)
        if not len(matches):
            # Ids of items, because touches have other ids than their rounds.
            first = [repr(getattr(item, "id", None)) for item in self[:_SHOWN_IDS]]
            raise errors.InputError(
                f"{', '.join(self.description())}: there is no id {id!r}",
                next=f"give one such as {', '.join(first) or '(none, it is empty)'}",
            )
        return self._item(int(matches[0]))

    def select(self, indices: Iterable[int]) -> Self:
        """Return items at given positions, in the order given; same as indexing with a list.

        Raises
        ------
        IndexError
            An index is out of range.
        TypeError
            An index is not an integer.
        """
        return self._chosen(indices if _picks_several(indices) else list(indices))

    def filter(self, function: Callable[[T], object]) -> Self:
        """Return the items for which a function is true, in order.

        Only fields that the function accesses are read.
        """
        kept = np.zeros(len(self), bool)
        for position, item in self.each_record():
            kept[position] = bool(function(item))
        return self._select(np.flatnonzero(kept))

    def filter_labels(self, *labels: int | str | Iterable[int | str]) -> Self:
        """Return the items of some classes, given as numbers or names, or as sequences of them.

        Raises
        ------
        InputError
            A class is not one of :attr:`label_names`.
        """
        numbers = list(map(self._label_number, self._flattened(labels)))
        return self._select(np.flatnonzero(np.isin(self.labels, numbers)))

    @classmethod
    def _flattened(cls, values: Iterable[object]) -> Iterator[Any]:
        """Yield the values of nested collections."""
        for value in values:
            if isinstance(value, Iterable) and not isinstance(value, (str, bytes)):
                yield from cls._flattened(value)
            else:
                yield value

    def by_label(self) -> dict[str, Self]:
        """Return a view of each class, by class name."""
        labels = self.labels
        return {
            name: self._select(np.flatnonzero(labels == number))
            for number, name in enumerate(self.label_names)
        }

    def shuffle(self, seed: int) -> Self:
        """Return all items in random order, which depends on the seed and the length only.

        Parameters
        ----------
        seed : int
            Not negative.

        Raises
        ------
        InputError
            The seed is not an integer, or negative.
        """
        return self._select(order.random_order(seed, len(self)))

    def sample(self, n: int, seed: int) -> Self:
        """Return ``n`` items, drawn at random without repetition.

        These are the first ``n`` of :meth:`shuffle`, so a larger sample with the same seed contains a smaller
        one.

        Parameters
        ----------
        n : int
            Number of items, at most ``len``.
        seed : int
            Not negative.

        Raises
        ------
        InputError
            There are fewer items, or a number is negative or not an integer.
        """
        count = checked_fields.checked_integer(n, "n, the size of a sample,", 0, len(self))
        return self._select(order.random_order(seed, len(self))[:count])

    def split(self, *parts: float, seed: int, stratify: bool = False) -> tuple[Self, ...]:
        """Divide the items at random into disjoint parts.

        Classes are ignored by default, as in `datasets`, scikit-learn and torch.

        Parameters
        ----------
        *parts : float or int
            Size of each part: fractions as floats that add up to at most 1, or numbers of items as ints. The
            remaining items are one more part: ``train, test = digits.split(0.8, seed=0)``.
        seed : int
            Not negative.
        stratify : bool
            Divide each class in the same proportions, up to about one item.

        Returns
        -------
        tuple of views
            Each is in random order. Cumulative sizes are rounded, so the error of each part is below one
            item.

        Raises
        ------
        InputError
            Sizes add up to more than all items, are negative or of both types; or the seed is negative or
            not an integer.

        Notes
        -----
        Touches of one round, or rounds of one object, may be in several parts. Divide the objects instead if
        that matters.
        """
        labels = self.labels if stratify else None
        parts_of = order.random_parts(
            [checked_fields.to_builtin_number(part) for part in parts], len(self), seed, labels
        )
        return tuple(self._select(part) for part in parts_of)

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
            raise errors.InputError("nothing to concatenate; expected at least one data set")
        return reduce(operator.add, parts)

    def __add__(self, other: Self) -> Self:
        if type(other) is not type(self):
            return NotImplemented
        if other.label_names != self.label_names:
            raise errors.InputError(
                f"cannot join data sets with classes {self.label_names} and {other.label_names}"
            )
        return self._concat(other)

    def __iter__(self) -> Iterator[T]:
        for position in range(len(self)):
            yield self._item(position)

    def __eq__(self, other: object) -> bool:
        """Return whether both hold equal items in the same order, with the same class names."""
        if not isinstance(other, type(self)) or type(other) is not type(self):
            return NotImplemented
        if len(self) != len(other) or self.label_names != other.label_names:
            return False
        if self.identity == other.identity and np.array_equal(self.row_numbers, other.row_numbers):
            return True
        return all(own == theirs for own, theirs in zip(self, other, strict=True))

    def __hash__(self) -> int:
        # Equal sets have equal hashes; the content of rows is not read.
        return hash((type(self), len(self), self.label_names))

    def __repr__(self) -> str:
        return wording.printable(
            f"{type(self).__name__}({', '.join([*self.description(), self._classes_in_words()])})"
        )

    def _repr_html_(self) -> str:
        """Show a description, and small pictures of some items or their problems, in notebooks."""
        pictures: list[str] = []
        problems: dict[str, None] = {}
        for position in np.linspace(0, len(self) - 1, min(len(self), _SHOWN_PICTURES)).round().tolist():
            try:
                item: Any = self._item(int(position))
                pictures.append(item.tile_html())
            except (errors.ToolkitError, ValueError, OSError) as error:
                problems[f"<div>{html.escape(wording.printable(str(error)))}</div>"] = None  # each once
        tiles = f'<div style="display:flex;flex-wrap:wrap;gap:4px">{"".join(pictures)}</div>'
        return f"<div>{html.escape(repr(self))}{tiles * any(pictures)}{''.join(problems)}</div>"

    def _stored(self, row: int) -> T:
        record: T = self.record_class(self._row_at(row))
        return record

    def _concat(self, following: Self) -> Self:
        joined = self._view(np.concatenate([self.row_numbers, following.row_numbers + len(self.table)]))
        joined.table = sharded_table.ShardedTable((*self.table.shards, *following.table.shards))
        return joined

    def description(self) -> list[str]:
        """Return a description of the data set and its origin."""
        return self.table.described(wording.with_count(len(self), self.things))

    def each_record(self) -> Iterator[tuple[int, T]]:
        """Yield position and item, in the fastest order, for reading small fields."""
        return enumerate(self)

    def _label_number(self, label: int | str) -> int:
        known = self.label_names
        number = checked_fields.to_builtin_number(label)
        if number in known:
            return known.index(number)
        if checked_fields.is_integer(number) and 0 <= number < len(known):
            return int(number)
        if not known:
            raise errors.InputError(f"no class {label!r}; the data set has no labels")
        listed = ", ".join(known)
        raise errors.InputError(
            f"no class {label!r}; expected an integer below {len(known)} or one of {listed}"
        )

    def _class_counts(self) -> dict[str, int]:
        if "label" not in self.plain_columns:
            return {}
        known, (numbers, counts) = self.label_names, np.unique(self.labels, return_counts=True)
        names = (wording.class_name(known, label) for label in numbers.tolist())
        return dict.fromkeys(known, 0) | dict(zip(names, counts.tolist(), strict=True))

    def _classes_in_words(self) -> str:
        try:
            names = [name for name, count in self._class_counts().items() if count]
        except (errors.ToolkitError, ValueError, OSError):
            return "classes unreadable"
        if not names:
            return "no classes"
        further = len(names) - _MAX_NAMES
        shown = names if further <= 0 else [*names[:_MAX_NAMES], f"{further:,} more"]
        return f"{'class' if len(names) == 1 else 'classes'} {', '.join(shown)}"


def _picks_several(index: object) -> bool:
    """Return whether an index selects several items: a slice, sequence, array or tensor."""
    if isinstance(index, (slice, Sequence)) and not isinstance(index, (str, bytes)):
        return True
    return hasattr(index, "__array__") and np.ndim(index) > 0


def positions(index: object, length: int) -> Int64:
    """Convert a slice, ints or a boolean mask to positions, shape (n,), from 0 to below a length.

    Raises IndexError for a mask of another length and for ints out of range, and TypeError for other types.
    """
    if isinstance(index, slice):
        return np.arange(*index.indices(length))
    chosen = np.asarray(index)
    if chosen.ndim != 1 or (chosen.size and chosen.dtype.kind not in "iub"):
        raise TypeError(
            f"rows are chosen by a slice, ints or booleans, not {chosen.dtype} of shape {chosen.shape}"
        )
    indices: Int64 = np.arange(length)[chosen if chosen.size else np.zeros(0, np.int64)]
    return indices
