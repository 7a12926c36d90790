"""Data sets and streams of rounds: lazy, with random access or one after another."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial
from typing import Any, ClassVar

import numpy as np
import pyarrow as pa

from realtouch import contact, integrity, rounds, schema, stored_round
from realtouch.touches import AnyTouches, R, Touches
from tactile_toolkit import errors, read, touch, wording
from tactile_toolkit.array_types import Float64, Int64


class RowsWithoutMedia(read.Rows):
    """A block of rows without images or clips, which are read on first use.

    ``number`` is the number of the first row in the source.
    """

    def __init__(self, block: read.RowGroup, source: read.RowSource, number: int) -> None:
        super().__init__(block.path, block.first_row)
        self._block = block
        self._source = source
        self._number = number

    @cached_property
    def table(self) -> pa.Table:
        """The rows with all columns; reads the whole block."""
        return self._source.locate(self._number)[0].table

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Columns by dotted name, including those not read yet."""
        return read.column_names(self._source.schema)

    def arrow(self, name: str) -> pa.Array:
        """Return a column; reads the complete rows if it was left out."""
        try:
            return self._block.arrow(name)
        except KeyError:
            return super().arrow(name)


class TouchDataset(read.RecordDataset[R]):
    """A lazy sequence of rounds; see :class:`tactile_toolkit.read.RecordDataset`.

    Parameters
    ----------
    table, rows, label_names
        As for :class:`tactile_toolkit.read.RecordDataset`.
    """

    things = "rounds"
    kind: touch.Kind

    def touches(self) -> Touches[R]:
        """Return the flat view: every touch of every round, in order, with random access."""
        return Touches(self)

    @property
    def labels(self) -> Int64:
        """Label of each round, shape (len,), int64, -1 without labels; reads the label column only."""
        return self._integers("label", lambda: np.full(len(self), -1), lambda each: each.label)

    @property
    def pose_column(self) -> str:
        """Column of the positions of the gel."""
        return f"{schema.POSE_COLUMN[self.kind]}.position"

    def _row_at(self, number: int) -> stored_round.StoredRound:
        return stored_round.StoredRound(*self.table.locate(number))

    @property
    def object_ids(self) -> Int64:
        """Id of the touched object of each round, shape (len,), int64, -1 without one."""
        return self._integers("object_id", lambda: np.full(len(self), -1), lambda each: each.object_id)

    @property
    def touch_counts(self) -> Int64:
        """T of each round, shape (len,), int64; reads at most the column of intended positions."""
        return self._stored_counts[self.row_numbers]

    @property
    def _stored_counts(self) -> Int64:
        return self.table.per_shard("touches", lambda source: [stored_round.stored_touch_counts(source)])

    @property
    def touch_starts(self) -> Int64:
        """Number of the first touch of each stored row, shape (stored rows + 1,), int64."""
        return np.concatenate([[0], np.cumsum(self._stored_counts)])

    def known_heights_m(self, recalibrate_z: bool = True) -> Float64:
        """Read the height of every stored touch; see :func:`realtouch.contact.contact_heights_m`.

        Shape (touches of all stored rows,), metres above the plate, NaN where it cannot be read. Where the
        height of the plate is known, it is always taken.
        """

        def heights_m(row: stored_round.StoredRound, rule: contact.ContactHeight) -> Float64:
            z_m = row.readable(partial(row.contact_z_m, self.kind))
            if rule.plate == "known":
                return contact.contact_heights_m(z_m, True, row.rendered_plate_z_m())
            return contact.contact_heights_m(z_m, recalibrate_z, row.stored_plate_z_m())

        columns = [
            contact.PLATE_COLUMN,
            "pos_in_cell",
            "video_length_frames",
            self.pose_column,
        ]
        return self._per_touch(f"heights {recalibrate_z}", columns, heights_m)

    def known_positions_m(self) -> Float64:
        """Read the intended position of every stored touch; NaN if it cannot be read.

        Shape (touches of all stored rows, 2), metres, cell frame; reads that column only.
        """

        def positions_m(row: stored_round.StoredRound, _rule: contact.ContactHeight) -> Float64:
            return row.readable(row.intended_positions, (2,))

        return self._per_touch("positions", ["pos_in_cell"], positions_m)

    def _per_touch(
        self,
        key: str,
        columns: Sequence[str],
        known: Callable[[stored_round.StoredRound, contact.ContactHeight], Float64],
    ) -> Float64:
        """Join the values of the touches of each stored row; reads a few columns."""

        def of_source(source: read.RowSource) -> list[Float64]:
            rule = contact.ContactHeight.of(read.column_types(source.schema))
            return [known(row, rule) for row in stored_round.stored_rows([source], columns)]

        values = self.table.per_shard(key, of_source)
        if len(values) != self.touch_starts[-1]:
            raise errors.IntegrityError(
                f"{wording.with_count(len(values), 'poses')} of touches for {self.touch_starts[-1]:,} "
                "touches; expected one each",
                next="run `realtouch verify`, which names the rounds",
            )
        return values

    def contact_rules(self) -> list[contact.ContactHeight]:
        """Return the rule by which touches of each round count as contact; joined sets may have several."""
        rules = [
            (contact.ContactHeight.of(read.column_types(each.schema)), len(each))
            for each in self.table.shards
        ]
        of_rows = [rule for rule, count in rules for _ in range(count)]
        return [of_rows[row] for row in self.row_numbers.tolist()]

    def rounds_without_media(self) -> Iterator[tuple[int, R]]:
        """Yield stored row number and round, row by row, and open images or clips only on access."""
        number = 0
        # In stored order, so that each block is read once, whatever the order of the view.
        wanted = set(self.row_numbers.tolist())
        media = touch.MEDIA_COLUMN[self.kind]
        for source in self.table.shards:
            columns, start = [name for name in source.schema.names if name != media], number
            for block in read.all_blocks([source], columns):
                rows = RowsWithoutMedia(block, source, number - start)
                for row in range(len(block.table)):
                    if number + row in wanted:
                        yield number + row, self.record_class(stored_round.StoredRound(rows, row))
                number += len(block.table)

    def each_record(self) -> Iterator[tuple[int, R]]:
        """Yield position and round, in the fastest order; images and clips are not read."""
        places: dict[int, list[int]] = {}
        for place, row in enumerate(self.row_numbers.tolist()):
            places.setdefault(row, []).append(place)
        # A view may hold a round several times, at several places.
        for row, record in self.rounds_without_media():
            for place in places[row]:
                yield place, record


class TouchSingleDataset(TouchDataset[rounds.TouchSingleRound]):
    """Rounds with one image per touch."""

    record_class: ClassVar[type[Any]] = rounds.TouchSingleRound
    kind = "single"


class TouchSeqDataset(TouchDataset[rounds.TouchSeqRound]):
    """Rounds with one clip per touch."""

    record_class: ClassVar[type[Any]] = rounds.TouchSeqRound
    kind = "seq"


AnyDataset = TouchDataset[Any]
"""Rounds of either kind."""


def dataset_of(shards: Sequence[read.RowSource]) -> TouchSeqDataset | TouchSingleDataset:
    """Return the data set of some shards of one kind."""
    dataset = _DATASETS[schema.media_kind(shards[0].schema, shards[0].path)]
    return dataset(read.ShardedTable(tuple(shards)), None, integrity.class_names_of(shards))


_DATASETS: dict[touch.Kind, type[TouchSingleDataset | TouchSeqDataset]] = {
    "seq": TouchSeqDataset,
    "single": TouchSingleDataset,
}


class TouchStream(read.RowStream[read.Shard]):
    """Rounds one after another; see :class:`tactile_toolkit.read.RowStream`.

    Parameters
    ----------
    shards : tuple of Shard
        Shards to read in turn.
    kind : "seq" or "single"
        Media of the rounds.
    """

    def __init__(self, shards: tuple[read.Shard, ...], kind: touch.Kind) -> None:
        super().__init__(shards)
        self.kind = kind

    @property
    def label_names(self) -> tuple[str, ...]:
        """Name of each class."""
        return integrity.class_names_of(self.shards)

    def touches(self) -> AnyTouches:
        """Return the flat view: every touch of every round, in order, with random access.

        A row group is read from its address when one of its rows is first accessed, and kept in the cache.
        """
        return dataset_of(self.shards).touches()

    def __iter__(self) -> Iterator[rounds.TouchRound]:
        """Yield rounds; a bounded block of rows is in memory at a time."""
        blocks = (block for shard, index in self.row_groups() for block in shard.blocks(index))
        return map(_DATASETS[self.kind].record_class, stored_round.rows_of(blocks))

    def __repr__(self) -> str:
        return self._described(self.kind)
