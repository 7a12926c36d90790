"""Some row groups of a file."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from itertools import accumulate, pairwise

import pyarrow as pa

from tactile_toolkit.read.row_group import RowGroup, Rows
from tactile_toolkit.read.shard import Shard


class ChosenGroups:
    """Some row groups of a file, such as those that can be read; the rows of the others are not there."""

    def __init__(self, shard: Shard, groups: Sequence[int]) -> None:
        self.shard = shard
        self.groups = groups
        self.path, self.set_name, self.origin = shard.path, shard.set_name, shard.origin
        self.schema, self.class_names = shard.schema, shard.class_names
        self.identity = (*shard.identity, *groups)
        sizes = [stop - start for start, stop in pairwise(shard.group_starts)]
        self.group_starts = [0, *accumulate(sizes[group] for group in groups)]
        self.part_sizes = (len(self),)

    def __len__(self) -> int:
        return self.group_starts[-1]

    def locate(self, row: int) -> tuple[Rows, int]:
        """Return the rows of the file among which a row lies, and its index in them."""
        index = bisect_right(self.group_starts, row) - 1
        first = self.shard.group_starts[self.groups[index]]
        return self.shard.locate(first + row - self.group_starts[index])

    def blocks(self, index: int, columns: Sequence[str] | None = None) -> Iterator[RowGroup]:
        """Decode the blocks of a row group one after another."""
        return self.shard.blocks(self.groups[index], columns)

    def column(self, name: str) -> pa.Array:
        """Read one column as an Arrow array."""
        return RowGroup(self.shard.read([name], self.groups), self.path).arrow(name)

    def unpack(self, index: int) -> int:
        """Unpack a row group into the cache."""
        return self.shard.unpack(self.groups[index])
