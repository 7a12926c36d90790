"""What data sets read rows from: files, rows that are made on the fly, some row groups of a file."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any, Protocol

from tactile_toolkit.read.columns import RowGroup, Rows

if TYPE_CHECKING:
    from tactile_toolkit.read.parquet import Shard


class RowSource(Protocol):
    """Rows under one numbering from 0, in row groups; picklable."""

    @property
    def path(self) -> str:
        """File in which the rows lie; empty where there is none."""
        ...

    @property
    def schema(self) -> Any:
        """Arrow schema of the rows."""
        ...

    @property
    def class_names(self) -> tuple[str, ...] | None:
        """Names of the classes, None where none are stated."""
        ...

    @property
    def identity(self) -> tuple[object, ...]:
        """What distinguishes the rows from all others, also from later ones of the same file."""
        ...

    @property
    def origin(self) -> tuple[str, str]:
        """Name of the data set, as it is shown, and its split, which may be empty."""
        ...

    @property
    def set_name(self) -> tuple[str, str]:
        """Folder and split: sources of which these are equal have one schema."""
        ...

    @property
    def small(self) -> tuple[Shard, str] | None:
        """File of small columns and what it must state that it was made of; None where there is none."""
        ...

    @property
    def group_starts(self) -> Sequence[int]:
        """First row of each row group, and the number of rows at the end."""
        ...

    @property
    def part_sizes(self) -> Sequence[int]:
        """Rows of the parts that training mixes."""
        ...

    def __len__(self) -> int: ...

    def locate(self, row: int) -> tuple[Rows, int]:
        """Return the rows among which a row lies, with all columns, and its index in them."""
        ...

    def all_blocks(self, columns: Sequence[str] | None = None) -> Iterator[RowGroup]:
        """Read all rows in blocks, one after another, keeping none; all columns or those named."""
        ...

    def column(self, name: str) -> Any:
        """Read one column of all rows as an Arrow array, by dotted name; KeyError when it is not there."""
        ...

    def unpack(self, index: int) -> int:
        """Put a row group where its rows are read at random; return its size in bytes, 0 where that fails."""
        ...


class ChosenGroups:
    """Some row groups of a file, such as those that can be read; the rows of the others are not there."""

    small = None

    def __init__(self, shard: Shard, groups: Sequence[int]) -> None:
        self.shard = shard
        self.groups = groups
        self.path, self.set_name, self.origin = shard.path, shard.set_name, shard.origin
        self.schema, self.class_names = shard.schema, shard.class_names
        self.identity = (*shard.identity, *groups)
        sizes = [stop - start for start, stop in pairwise(shard.group_starts)]
        self.group_starts = [0, *accumulate(sizes[group] for group in groups)]

    @property
    def part_sizes(self) -> Sequence[int]:
        """Rows of the parts that training mixes: all together."""
        return (len(self),)

    def __len__(self) -> int:
        return self.group_starts[-1]

    def locate(self, row: int) -> tuple[Rows, int]:
        """Return the rows of the file among which a row lies, and its index in them."""
        index = bisect_right(self.group_starts, row) - 1
        first = self.shard.group_starts[self.groups[index]]
        return self.shard.locate(first + row - self.group_starts[index])

    def all_blocks(self, columns: Sequence[str] | None = None) -> Iterator[RowGroup]:
        """Decode the blocks of the row groups one after another."""
        for group in self.groups:
            yield from self.shard.blocks(group, columns)

    def column(self, name: str) -> Any:
        """Read one column as an Arrow array."""
        return RowGroup(self.shard.read([name], self.groups), self.path).arrow(name)

    def unpack(self, index: int) -> int:
        """Unpack a row group into the cache."""
        return self.shard.unpack(self.groups[index])
