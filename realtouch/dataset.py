"""Data sets of rounds: lazy sequences of typed records, with the flat view of their touches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property, partial
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from realtouch.columns.light import LightGroup, LightRow
from realtouch.columns.poses import known_contact_z_m, touch_contact_z_m
from realtouch.integrity.agreement import class_names_of, stored_touch_counts
from realtouch.integrity.damage import Damage
from realtouch.rounds import TouchRound, TouchSeqRound, TouchSingleRound
from realtouch.stream import TouchStream
from realtouch.touches import Touches
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read.dataset import RecordDataset, Row
from tactile_toolkit.read.parquet import RowGroup, Shard, ShardedTable
from tactile_toolkit.touch.schema import MEDIA_COLUMN, PLATE_COLUMN, Kind, column_type

__all__ = ["TouchDataset", "TouchSeqDataset", "TouchSingleDataset", "TouchStream", "dataset_of"]

R = TypeVar("R", bound=TouchRound)


class TouchDataset(RecordDataset[R]):
    """A lazy sequence of rounds; see :class:`tactile_toolkit.read.dataset.RecordDataset`.

    Parameters
    ----------
    tables, rows, label_names
        As for :class:`tactile_toolkit.read.dataset.RecordDataset`.
    skipped : sequence of (int or None, Damage)
        Damage that was found and is left out, each with the number of its row in the joined tables: rounds by
        the data set itself, single touches by :meth:`touches`. None stands for a file left out as a whole.
    """

    kind: Kind

    def __init__(
        self,
        tables: Sequence[ShardedTable],
        rows: range | NDArray[np.int64] | None = None,
        label_names: Sequence[str] = (),
        skipped: Sequence[tuple[int | None, Damage]] = (),
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
        return view.without(self._lost_touches) if self._lost_touches else view

    @cached_property
    def touch_counts(self) -> NDArray[np.int64]:
        """T of each round, shape (len,), int64; reads at most the column of intended positions."""
        return self._joined_counts[self.row_numbers]

    @cached_property
    def _lost_touches(self) -> frozenset[tuple[int, int]]:
        """Stored row and number in the round of each touch that was left out."""
        return frozenset(
            (row, damage.touch)
            for row, damage in self._skipped
            if row is not None and damage.touch is not None
        )

    @property
    def row_numbers(self) -> NDArray[np.int64]:
        """Place of each round in the stored tables, shape (len,), int64."""
        return np.asarray(self._rows, np.int64)

    def contact_z_m(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Read the height of the gel at the deepest press of every stored touch.

        Opens no image or clip, but where a set states no lengths of padded clips: those are counted then.

        Returns
        -------
        z_m : ndarray, shape (touches of all stored rows,), float64
            Metres, cell frame, not recalibrated. Not a number for touches that were left out on loading, and
            in rows that are not in this view, where it cannot be read.
        starts : ndarray of int64, shape (stored rows + 1,)
            Where the touches of each stored row begin in ``z_m``.

        Raises
        ------
        IntegrityError
            The height of a touch of this view cannot be read; names file, row and touch.
        """
        z_m, starts = self.known_contact_z_m()
        unknown = np.flatnonzero(np.isnan(z_m))
        rows = np.searchsorted(starts, unknown, side="right") - 1
        left_out = self._lost_touches
        for row, touch in zip(rows.tolist(), (unknown - starts[rows]).tolist(), strict=True):
            for position in np.flatnonzero(self.row_numbers == row)[:1].tolist():
                if (row, touch) not in left_out:
                    touch_contact_z_m(self[position]._row, self.kind, touch)
        return z_m, starts

    def known_contact_z_m(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return what :meth:`contact_z_m` does; not a number wherever a height cannot be read."""
        suffix = "gel_pose_cell_frame" if self.kind == "single" else "gel_pose_cell_frame_seq"
        columns = ["pos_in_cell", "video_length_frames", f"{suffix}.position"]
        compute = partial(_contact_z_m, self.kind)
        try:
            parts = [table.derive("contact z", columns, compute) for table in self._tables]
        except InputError:
            if any(column_type(table.schema, columns[-1]) is None for table in self._tables):
                raise
            # Without stated lengths only clips tell padding from frames; without positions, pictures tell T.
            columns.append(MEDIA_COLUMN[self.kind])
            parts = [table.derive("contact z", columns, compute) for table in self._tables]
        z_m, starts = (
            np.concatenate(parts or [np.zeros(0)]),
            np.concatenate([[0], np.cumsum(self._joined_counts)]),
        )
        if len(z_m) != starts[-1]:
            message = (
                f"{len(z_m):,} poses of touches for {starts[-1]:,} touches; expected one each; next: run "
                "`realtouch verify`, which names the rounds"
            )
            raise IntegrityError(message)
        return z_m, starts

    def plates_z_m(self) -> NDArray[np.float64]:
        """Read the stored height of the plate of every stored row, shape (stored rows,), metres, cell frame.

        Not a number where none is stored, as in the published sets: the deepest touch shows it there.
        """
        parts = [_plates_z_m(shard) for table in self._tables for shard in table.shards]
        return np.concatenate(parts or [np.zeros(0)])

    def light_rounds(self) -> Iterator[tuple[int, R]]:
        """Yield stored row number and round, row by row, without opening images or clips until asked for."""
        number = 0
        wanted = set(self.row_numbers.tolist())
        media = MEDIA_COLUMN[self.kind]
        for shard in (shard for table in self._tables for shard in table.shards):
            columns = [name for name in shard.schema.names if name != media]
            for index in range(shard.metadata.num_row_groups):
                for block, group in enumerate(shard.blocks(index, columns)):
                    light = LightGroup(group, shard, index, block)
                    for row in range(len(group.table)):
                        if number + row in wanted:
                            yield number + row, self._make(LightRow(light, row))
                    number += len(group.table)

    @cached_property
    def _joined_counts(self) -> NDArray[np.int64]:
        parts = [_touch_counts(table) for table in self._tables]
        return np.concatenate(parts or [np.zeros(0, np.int64)])

    def __add__(self, other: Self) -> Self:
        if type(other) is not type(self):
            return NotImplemented
        joined = super().__add__(other)
        offset = int(self._starts[-1])
        moved = [(None if row is None else row + offset, damage) for row, damage in other._skipped]
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


def _touch_counts(table: ShardedTable) -> NDArray[np.int64]:
    return table.per_shard(
        "touches",
        lambda shard: [stored_touch_counts(shard, each) for each in range(shard.metadata.num_row_groups)],
    )


def _plates_z_m(shard: Shard) -> NDArray[np.float64]:
    if column_type(shard.schema, PLATE_COLUMN) is None:
        return np.full(len(shard), np.nan)
    return np.asarray(ShardedTable((shard,)).column(PLATE_COLUMN), np.float64)


def _contact_z_m(kind: Kind, group: RowGroup) -> NDArray[np.float64]:
    rows = [known_contact_z_m(Row(group, index), kind) for index in range(len(group.table))]
    return np.concatenate(rows) if rows else np.zeros(0)


def dataset_of(shards: tuple[Shard, ...], kind: Kind) -> TouchSeqDataset | TouchSingleDataset:
    """Return the data set of some shards of one kind."""
    names = class_names_of(shards)
    if kind == "seq":
        return TouchSeqDataset([ShardedTable(shards)], label_names=names)
    return TouchSingleDataset([ShardedTable(shards)], label_names=names)
