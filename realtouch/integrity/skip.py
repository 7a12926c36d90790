"""Finding what is damaged in files before they are read: rows that cannot be read, rounds and touches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realtouch.damage import Damage, unreadable_rows
from realtouch.integrity.agreement import stated_class_names
from realtouch.integrity.check_round import check_round
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.read.columns import RowGroup
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import Shard


@dataclass(frozen=True)
class PartialShard(Shard):
    """A Parquet file whose unreadable row groups count as rows without values when columns are read.

    Rows keep their numbers, so that the others are found and named as in the entire file. A user of one
    asks for no row of the groups in ``lost`` by itself.
    """

    lost: frozenset[int] = frozenset()

    def read(self, columns: Sequence[str] | None = None, groups: Sequence[int] | None = None) -> Any:
        """Decode row groups, all columns or those named; nulls stand for those that cannot be read."""
        import pyarrow as pa

        wanted = range(self.metadata.num_row_groups) if groups is None else groups
        return pa.concat_tables([super().read(columns, []), *(self._group(each, columns) for each in wanted)])

    def blocks(self, index: int, columns: Sequence[str] | None = None) -> Iterator[RowGroup]:
        """Decode the blocks of a row group; one of nulls where it cannot be read."""
        if index in self.lost:
            yield RowGroup(self._group(index, columns), self.path, self.group_starts[index])
        else:
            yield from super().blocks(index, columns)

    def _group(self, index: int, columns: Sequence[str] | None) -> Any:
        import pyarrow as pa

        if index not in self.lost:
            return super().read(columns, [index])
        schema = super().read(columns, []).schema
        rows = self.metadata.row_group(index).num_rows
        return pa.table([pa.nulls(rows, field.type) for field in schema], schema=schema)


def find_damage(
    shards: Sequence[Shard], expected_touches: int | None
) -> tuple[list[Shard], NDArray[np.int64], list[tuple[int | None, Damage]]]:
    """Check every round of some files, of which each must have ``expected_touches``, where that is said.

    Returns the files, those with row groups that cannot be read as :class:`PartialShard`; the rows of all
    files that are not lost; and all damage, each with the number of its row. A row is lost when it cannot be
    read or something is wrong with the round as a whole (a column, its number of touches); a round with
    damaged touches stays.
    """
    found: list[tuple[int | None, Damage]] = []
    whole: list[Shard] = []
    lost = np.zeros(sum(map(len, shards)), bool)
    names = stated_class_names(shards)
    start = 0
    for shard in shards:
        unreadable = set()
        for index, first in enumerate(shard.group_starts[:-1]):
            try:
                damage: list[Damage] = []
                rows = shard.metadata.row_group(index).num_rows
                for block in range(-(-rows // shard.block_rows[index])):
                    group = shard.block(index, block)  # unpacked into the cache, where it is read from later
                    for row in range(len(group.table)):
                        damage += check_round(Row(group, row), expected_touches, class_names=names)
            except IntegrityError as error:
                unreadable.add(index)
                found.append((start + first, unreadable_rows(shard, index, error)))
                lost[start + first : start + shard.group_starts[index + 1]] = True
                continue
            for each in damage:
                row_number = start + int(each.row or 0)
                found.append((row_number, each))
                lost[row_number] |= each.touch is None
        if unreadable:
            shard = PartialShard(shard.path, shard.rows, shard.failures, lost=frozenset(unreadable))
        whole.append(shard)
        start += len(shard)
    return whole, np.flatnonzero(~lost), found
