"""Data sets of rounds: lazy sequences of typed records, with the flat view of their touches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property, partial
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from dataset_store.records import RecordDataset, Row
from dataset_store.rowgroups import RowGroup, Shard, ShardedTable
from realtouch.damage import Damage
from realtouch.fields import contact_z_m
from realtouch.nested import nested_column
from realtouch.rounds import TouchRound, TouchSeqRound, TouchSingleRound
from realtouch.schema import MEDIA_COLUMN, Kind, class_names, column_type
from realtouch.touches import Touches

__all__ = ["TouchDataset", "TouchSeqDataset", "TouchSingleDataset", "TouchStream", "stored_touch_counts"]

R = TypeVar("R", bound=TouchRound)


class TouchDataset(RecordDataset[R]):
    """A lazy sequence of rounds; see :class:`dataset_store.records.RecordDataset`.

    Parameters
    ----------
    tables, rows, label_names
        As for :class:`dataset_store.records.RecordDataset`.
    skipped : sequence of (int, Damage)
        Damage that was found and is left out, each with the number of its row in the joined tables: rounds by
        the data set itself, single touches by :meth:`touches`.
    """

    kind: Kind

    def __init__(
        self,
        tables: Sequence[ShardedTable],
        rows: range | NDArray[np.int64] | None = None,
        label_names: Sequence[str] = (),
        skipped: Sequence[tuple[int, Damage]] = (),
    ) -> None:
        super().__init__(tables, rows, label_names)
        self._skipped = tuple(skipped)

    @property
    def skipped(self) -> tuple[Damage, ...]:
        """What was left out as damaged, in a data set loaded with ``on_error="skip"``."""
        return tuple(damage for _, damage in self._skipped)

    def touches(self) -> Touches[R]:
        """Return the flat view: every touch of every round, in order, with random access.

        Touches found to be damaged on loading with ``on_error="skip"`` are left out.
        """
        view = Touches(self)
        lost = {(row, damage.touch) for row, damage in self._skipped if damage.touch is not None}
        return view if not lost else view.without(lost)

    @cached_property
    def touch_counts(self) -> NDArray[np.int64]:
        """T of each round, shape (len,), int64; reads at most the column of intended positions."""
        return self._joined_counts[self.row_numbers]

    @property
    def row_numbers(self) -> NDArray[np.int64]:
        """Place of each round in the stored tables, shape (len,), int64."""
        return np.asarray(self._rows, np.int64)

    def contact_z_m(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Read the height of the gel at the deepest press of every stored touch; opens no image or clip.

        Returns
        -------
        z_m : ndarray, shape (touches of all stored rows,), float64
            Metres, cell frame, not recalibrated.
        starts : ndarray of int64, shape (stored rows + 1,)
            Where the touches of each stored row begin in ``z_m``.
        """
        suffix = "gel_pose_cell_frame" if self.kind == "single" else "gel_pose_cell_frame_seq"
        columns = ["pos_in_cell", "video_length_frames", f"{suffix}.position"]
        compute = partial(_contact_z_m, self.kind)
        parts = [table.derive("contact z", columns, compute) for table in self._tables]
        return np.concatenate(parts or [np.zeros(0)]), np.concatenate([[0], np.cumsum(self._joined_counts)])

    def light_rounds(self) -> Iterator[tuple[int, R]]:
        """Yield stored row number and round, row by row, without opening images or clips until asked for."""
        number = 0
        wanted = set(self.row_numbers.tolist())
        media = MEDIA_COLUMN[self.kind]
        for shard in (shard for table in self._tables for shard in table.shards):
            columns = [name for name in shard.schema.names if name != media]
            for index in range(shard.metadata.num_row_groups):
                for block, group in enumerate(shard.blocks(index, columns)):
                    light = _LightGroup(group, shard, index, block)
                    for row in range(len(group.table)):
                        if number + row in wanted:
                            yield number + row, self._make(Row(light, row))
                    number += len(group.table)

    @cached_property
    def _joined_counts(self) -> NDArray[np.int64]:
        parts = [stored_touch_counts(table, MEDIA_COLUMN[self.kind]) for table in self._tables]
        return np.concatenate(parts or [np.zeros(0, np.int64)])

    def __add__(self, other: Self) -> Self:
        joined = super().__add__(other)
        offset = int(self._starts[-1])
        moved = [(row + offset, damage) for row, damage in other._skipped]
        return type(self)(joined._tables, joined._rows, self._label_names, (*self._skipped, *moved))

    def _view(self, tables: Sequence[ShardedTable], rows: range | NDArray[np.int64]) -> Self:
        return type(self)(tables, rows, self._label_names, self._skipped)


class TouchSingleDataset(TouchDataset[TouchSingleRound]):
    """Rounds with one image per touch."""

    record: ClassVar[type[Any]] = TouchSingleRound
    kind = "single"


class TouchSeqDataset(TouchDataset[TouchSeqRound]):
    """Rounds with one clip per touch."""

    record: ClassVar[type[Any]] = TouchSeqRound
    kind = "seq"


class TouchStream:
    """Rounds one after another, read from their address piece by piece; nothing is stored locally.

    Parameters
    ----------
    shards : tuple of Shard
        Shards to read in turn.
    kind : "seq" or "single"
        What they hold.
    skip_damage : bool
        Check each round before it is given: leave out damaged rounds, and damaged touches of the others.

    Attributes
    ----------
    skipped : list of Damage
        What was left out so far.
    """

    def __init__(self, shards: tuple[Shard, ...], kind: Kind, *, skip_damage: bool = False) -> None:
        self.shards = shards
        self.kind = kind
        self.skip_damage = skip_damage
        self.skipped: list[Damage] = []

    @property
    def label_names(self) -> tuple[str, ...]:
        """Name of each class."""
        return class_names(self.shards[0].schema)

    def part(self, index: int, count: int) -> TouchStream:
        """Return every ``count``-th shard from ``index`` on, for workers that share the work."""
        return TouchStream(self.shards[index::count], self.kind, skip_damage=self.skip_damage)

    def __iter__(self) -> Iterator[TouchRound]:
        """Yield rounds; a bounded block of rows is in memory at a time."""
        home = TouchSingleRound if self.kind == "single" else TouchSeqRound
        for shard in self.shards:
            for index in range(shard.metadata.num_row_groups):
                for group in shard.blocks(index):
                    for row in range(len(group.table)):
                        yield from self._whole(home(Row(group, row)))

    def _whole(self, record: TouchRound) -> Iterator[TouchRound]:
        """Yield a round, or what is whole of it."""
        if not self.skip_damage:
            yield record
            return
        from realtouch.checks import check_round

        found = check_round(record._row)
        self.skipped += found
        lost = {damage.touch for damage in found}
        if None not in lost:
            kept = [touch for touch in range(record.touch_count) if touch not in lost]
            yield record.with_touches(kept) if lost else record

    def __repr__(self) -> str:
        return f"TouchStream({self.kind}, {len(self.shards)} shards)"


class _LightGroup(RowGroup):
    """Rows without their images or clips, which are opened when somebody asks after all."""

    def __init__(self, group: RowGroup, shard: Shard, index: int, block: int) -> None:
        super().__init__(group.table, group.path, group.first_row)
        object.__setattr__(self, "_home", (shard, index, block))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Columns by dotted name, those not read yet included."""
        from dataset_store.columns import column_names

        return column_names(self._home[0].schema)  # type: ignore[attr-defined]

    def arrow(self, name: str) -> Any:
        """Return a column, opening the whole rows where it was left out."""
        try:
            return super().arrow(name)
        except KeyError:
            shard, index, block = self._home  # type: ignore[attr-defined]
            return shard.block(index, block).arrow(name)


def stored_touch_counts(table: ShardedTable, media: str) -> NDArray[np.int64]:
    """Return T of every row of a table, shape (rows,); reads nothing where the schema fixes it."""
    parts = []
    for shard in table.shards:
        name = "pos_in_cell" if column_type(shard.schema, "pos_in_cell") is not None else media
        parts.append(_shard_counts(shard, name))
    return np.concatenate(parts) if parts else np.zeros(0, np.int64)


def _shard_counts(shard: Shard, name: str) -> NDArray[np.int64]:
    import pyarrow as pa

    data_type = column_type(shard.schema, name)
    if pa.types.is_fixed_size_list(data_type):
        return np.full(len(shard), data_type.list_size, np.int64)
    alone = ShardedTable((shard,))
    return alone.derive(f"touches by {name}", [name], lambda group: nested_column(group, name).lengths(0))


def _contact_z_m(kind: Kind, group: RowGroup) -> NDArray[np.float64]:
    rows = [contact_z_m(Row(group, index), kind) for index in range(len(group.table))]
    return np.concatenate(rows) if rows else np.zeros(0)
