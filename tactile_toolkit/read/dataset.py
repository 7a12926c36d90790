"""Record data sets: lazy sequences of typed records over stored rows, and views of them."""

from __future__ import annotations

import html
import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import copy
from functools import reduce
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeAlias, TypeVar, overload

import numpy as np

from tactile_toolkit import checked_fields, wording
from tactile_toolkit.array_types import AnyArray, Int64
from tactile_toolkit.errors import InputError, ToolkitError
from tactile_toolkit.read import (
    indexing,
    random_parts,
    sharded_table,
)
from tactile_toolkit.read.record import Record
from tactile_toolkit.read.row_columns import RowColumns

if TYPE_CHECKING:
    pass

T = TypeVar("T")

_SHOWN_PICTURES = 8
_MAX_NAMES = 10
_SHOWN_IDS = 4


class RecordDataset(RowColumns, Sequence[T], Generic[T]):
    """A lazy sequence of records.

    Indexing with an int gives a record; a slice, a list or array of ints, or a boolean mask gives a view
    without copying data, and views of views compose. ``a + b`` joins data sets of one kind. Opening reads no
    row. Data sets can be shared between threads, forked and pickled. They are equal if they hold equal
    records in the same order. Random choices depend only on the seed and the number of items, not on earlier
    reads, the machine or the version of numpy.
    """

    record_class: ClassVar[Any] = Record

    things: ClassVar[str] = "rows"
    """Noun for the items, in the plural."""

    def _integers(self, name: str, unstored: Callable[[], Int64], stored: Callable[[T], int]) -> Int64:
        """Read a column of integers; ``unstored`` computes it for sets without it, ``stored`` for one row."""
        known = self._stores(name)
        if all(known):
            return self.int_column(name)
        # Joined sets may differ.
        return np.array([stored(each) for each in self], np.int64) if any(known) else unstored()

    def _item(self, position: int) -> T:
        """Return one item; IndexError out of range."""
        length = len(self._rows)
        # Not `checked_index`, which would take a tenth of the time of `touches[i]`.
        if not -length <= position < length:
            raise IndexError(
                f"index {position} is out of range for {wording.with_count(length, self.things)}"
            )
        return self._stored(int(self._rows[position]))

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
        if isinstance(index, int):
            return self._item(index)
        if isinstance(index, slice):
            return self._select(index)
        if indexing.picks_several(index):
            return self._select(indexing.positions(index, len(self)))
        return self._item(operator.index(index))

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
        places = np.flatnonzero(self.ids == number)
        if not len(places):
            # Ids of items, because touches have other ids than their rounds.
            first = [repr(getattr(item, "id", None)) for item in self[:_SHOWN_IDS]]
            raise InputError(
                f"{', '.join(self.description())}: there is no id {id!r}",
                next=f"give one such as {', '.join(first) or '(none, it is empty)'}",
            )
        return self._item(int(places[0]))

    def select(self, indices: Iterable[int]) -> Self:
        """Return items at given positions, in the order given; same as indexing with a list.

        Raises
        ------
        IndexError
            An index is out of range.
        TypeError
            An index is not an integer.
        """
        return self._select(
            indexing.positions(indices if indexing.picks_several(indices) else list(indices), len(self))
        )

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
        wanted = list(map(self._label_number, indexing.flattened(labels)))
        return self._select(np.flatnonzero(np.isin(self.labels, wanted)))

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
        return self._select(random_parts.random_order(seed, len(self)))

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
        return self._select(random_parts.random_order(seed, len(self))[:count])

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
        parts_of = random_parts.random_parts(
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
        """Return whether both hold equal items in the same order, with the same class names."""
        if not isinstance(other, type(self)) or type(other) is not type(self):
            return NotImplemented
        if len(self) != len(other) or self.label_names != other.label_names:
            return False
        if self.identity == other.identity and np.array_equal(self.row_numbers, other.row_numbers):
            return True
        return all(one == another for one, another in zip(self, other, strict=True))

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
            except (ToolkitError, ValueError, OSError) as error:
                problems[f"<div>{html.escape(wording.printable(str(error)))}</div>"] = None  # each once
        tiles = f'<div style="display:flex;flex-wrap:wrap;gap:4px">{"".join(pictures)}</div>'
        return f"<div>{html.escape(repr(self))}{tiles * any(pictures)}{''.join(problems)}</div>"

    def _stored(self, row: int) -> T:
        record: T = self.record_class(self._row_at(row))
        return record

    def _concat(self, other: Self) -> Self:
        joined = self._view(np.concatenate([self.row_numbers, other.row_numbers + len(self.table)]))
        joined.table = sharded_table.ShardedTable((*self.table.shards, *other.table.shards))
        return joined

    def description(self) -> list[str]:
        """Return a description of the data set and its origin."""
        return self.table.described(wording.with_count(len(self), self.things))

    def each_record(self) -> Iterator[tuple[int, T]]:
        """Yield position and item, in the fastest order, for reading small fields."""
        return enumerate(self)

    def _label_number(self, label: int | str) -> int:
        known, number = self.label_names, checked_fields.to_builtin_number(label)
        if number in known:
            return known.index(number)
        if checked_fields.is_integer(number) and 0 <= number < len(known):
            return int(number)
        if not known:
            raise InputError(f"no class {label!r}; the data set has no labels")
        listed = ", ".join(known)
        raise InputError(f"no class {label!r}; expected an integer below {len(known)} or one of {listed}")

    def _class_counts(self) -> dict[str, int]:
        if "label" not in self.plain_columns:
            return {}
        known, (numbers, counts) = self.label_names, np.unique(self.labels, return_counts=True)
        names = (wording.class_name(known, label) for label in numbers.tolist())
        return dict.fromkeys(known, 0) | dict(zip(names, counts.tolist(), strict=True))

    def _classes_in_words(self) -> str:
        try:
            names = [name for name, count in self._class_counts().items() if count]
        except (ToolkitError, ValueError, OSError):
            return "classes unreadable"
        if not names:
            return "no classes"
        further = len(names) - _MAX_NAMES
        shown = names if further <= 0 else [*names[:_MAX_NAMES], f"{further:,} more"]
        return f"{'class' if len(names) == 1 else 'classes'} {', '.join(shown)}"


AnyRecords: TypeAlias = RecordDataset[Any]
"""A data set of records of any class."""
