"""Files of which some row groups cannot be read: the rows that can, under their own numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from dataset_store.rowgroups import RowGroup, Shard

__all__ = ["PartialShard"]


@dataclass(frozen=True)
class PartialShard(Shard):
    """A Parquet file whose unreadable row groups count as rows without values when columns are read.

    Rows keep their numbers, so that the others are found and named as in the whole file. Whoever holds one
    asks for no unreadable row by itself.

    Parameters
    ----------
    path, rows
        As for :class:`dataset_store.rowgroups.Shard`.
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
