"""Rows read without their images or clips, which are opened when somebody asks after all."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from tactile_toolkit.read.columns import column_names
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import RowGroup, Shard

__all__ = ["GroupWithoutMedia", "RowWithoutMedia", "whole_row"]


@dataclass(frozen=True, eq=False)
class GroupWithoutMedia(RowGroup):
    """Rows of which some columns were not read; ``shard``, ``index`` and ``block`` say where those are."""

    shard: Shard = field(kw_only=True)
    index: int = field(kw_only=True)
    block: int = field(kw_only=True)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Columns by dotted name, those not read yet included."""
        return column_names(self.shard.schema)

    def arrow(self, name: str) -> Any:
        """Return a column, opening the whole rows where it was left out."""
        try:
            return super().arrow(name)
        except KeyError:
            return self.whole().arrow(name)

    def whole(self) -> RowGroup:
        """Return the same rows with all their columns."""
        return self.shard.block(self.index, self.block)


class RowWithoutMedia(Row):
    """A row of a :class:`GroupWithoutMedia`; pickles with all its columns."""

    __slots__ = ()

    def __reduce__(self) -> tuple[Any, ...]:
        return whole_row(self).__reduce__()


def whole_row(row: Row) -> Row:
    """Return a row of which all columns are in its table."""
    return Row(row.group.whole(), row.index) if isinstance(row.group, GroupWithoutMedia) else row
