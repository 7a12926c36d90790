"""Leaving out what is damaged: files, rows that cannot be read, rounds and touches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from realtouch.dataset import TouchDataset, TouchSeqDataset, TouchSingleDataset, TouchStream, dataset_of
from realtouch.integrity.agreement import require_alike, sort_out, stated_class_names, usual_touch_count
from realtouch.integrity.check_round import check_round
from realtouch.integrity.damage import Damage, unreadable_rows
from realtouch.names import Place
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import RowGroup, Shard, ShardedTable
from tactile_toolkit.touch.schema import kind_of

__all__ = ["PartialShard", "load_undamaged", "without_damage"]


@dataclass(frozen=True)
class PartialShard(Shard):
    """A Parquet file whose unreadable row groups count as rows without values when columns are read.

    Rows keep their numbers, so that the others are found and named as in the whole file. Whoever holds one
    asks for no unreadable row by itself.

    Parameters
    ----------
    path, rows, failures
        As for :class:`tactile_toolkit.read.parquet.Shard`.
    lost : frozenset of int
        Row groups that cannot be read.
    """

    lost: frozenset[int] = frozenset()

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "lost": self.lost}

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


D = TypeVar("D", bound=TouchDataset[Any])


def load_undamaged(
    shards: Sequence[Shard], place: Place, *, streaming: bool
) -> TouchSeqDataset | TouchSingleDataset | TouchStream:
    """Open what is not damaged of some files; see ``on_error`` of :func:`realtouch.load`.

    Raises
    ------
    InputError
        They are no data set of touches.
    IntegrityError
        No file is left.
    """
    readable, left_out = sort_out(shards, str(place))
    if not readable:
        require_alike(shards, str(place))
    kind = kind_of(readable[0].schema, readable[0].path)
    expected = usual_touch_count(readable, place)
    if streaming:
        return TouchStream(readable, kind, skip_damage=True, expected_touches=expected, left_out=left_out)
    return without_damage(dataset_of(readable, kind), expected, left_out)


def without_damage(dataset: D, expected_touches: int | None, left_out: Sequence[Damage] = ()) -> D:
    """Return a data set without its damaged rounds; its ``touches()`` lack the damaged touches too.

    A round is left out when it cannot be read or something is wrong with it as a whole (a column, its number
    of touches); one with damaged touches stays. All damage is listed in ``skipped``.

    Parameters
    ----------
    dataset : TouchDataset
        All rounds of its files.
    expected_touches : int or None
        T that each round must have; None where rounds are meant to differ.
    left_out : sequence of Damage
        Files that were left out beforehand.
    """
    found: list[tuple[int | None, Damage]] = [(None, damage) for damage in left_out]
    tables = []
    lost = np.zeros(len(dataset), bool)
    names = stated_class_names(shard for table in dataset._tables for shard in table.shards)
    start = 0
    for table in dataset._tables:
        whole: list[Shard] = []
        for shard in table.shards:
            unreadable = set()
            for index, first in enumerate(shard.group_starts[:-1]):
                try:
                    damage = [
                        each
                        for row in _unpacked(shard, index)
                        for each in check_round(row, expected_touches, class_names=names)
                    ]
                except IntegrityError as error:
                    unreadable.add(index)
                    found.append((start + first, unreadable_rows(shard, index, error)))
                    lost[start + first : start + shard.group_starts[index + 1]] = True
                    continue
                found += [(start + int(each.row or 0), each) for each in damage]
                lost[[start + int(each.row or 0) for each in damage if each.touch is None]] = True
            lacking = PartialShard(shard.path, shard.rows, shard.failures, frozenset(unreadable))
            whole.append(lacking if unreadable else shard)
            start += len(shard)
        tables.append(ShardedTable(tuple(whole)))
    return type(dataset)(tables, np.flatnonzero(~lost), dataset.label_names, found)


def _unpacked(shard: Shard, index: int) -> Iterator[Row]:
    """Yield the rows of a row group, unpacked into the cache, where they are read from later."""
    rows = shard.metadata.row_group(index).num_rows
    for block in range(-(-rows // shard.block_rows[index])):
        group = shard.block(index, block)
        yield from (Row(group, place) for place in range(len(group.table)))
