"""Rows read without their images or clips, which are opened when somebody asks after all."""

from __future__ import annotations

from functools import cached_property
from typing import Any

from tactile_toolkit.read.columns import column_names
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import RowGroup, Shard

__all__ = ["LightGroup", "LightRow", "whole_row"]


class LightGroup(RowGroup):
    """Rows without some of their columns.

    Parameters
    ----------
    group : RowGroup
        The columns that were read.
    shard : Shard
        Where the others are.
    index, block : int
        Row group of the shard, and block of it.
    """

    def __init__(self, group: RowGroup, shard: Shard, index: int, block: int) -> None:
        super().__init__(group.table, group.path, group.first_row)
        object.__setattr__(self, "_home", (shard, index, block))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Columns by dotted name, those not read yet included."""
        return column_names(self._home[0].schema)  # type: ignore[attr-defined]

    def arrow(self, name: str) -> Any:
        """Return a column, opening the whole rows where it was left out."""
        try:
            return super().arrow(name)
        except KeyError:
            return self.whole().arrow(name)

    def whole(self) -> RowGroup:
        """Return the same rows with all their columns."""
        shard, index, block = self._home  # type: ignore[attr-defined]
        group: RowGroup = shard.block(index, block)
        return group


class LightRow(Row):
    """A row of a :class:`LightGroup`; pickles with all its columns."""

    __slots__ = ()

    def __reduce__(self) -> tuple[Any, ...]:
        return whole_row(self).__reduce__()


def whole_row(row: Row) -> Row:
    """Return a row of which all columns are in its table."""
    return Row(row.group.whole(), row.index) if isinstance(row.group, LightGroup) else row
