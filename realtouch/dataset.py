"""Data sets and streams of rounds: lazy sequences of typed records, with the flat view of their touches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from realtouch.columns.poses import touch_contact_z_m
from realtouch.damage import Damage, unreadable_rows
from realtouch.integrity.agreement import stated_class_names
from realtouch.integrity.check_round import check_round
from realtouch.rounds import TouchRound, TouchSeqRound, TouchSingleRound
from realtouch.touches import Rounds, Touches
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read.dataset import RecordDataset, Row, with_origins
from tactile_toolkit.read.parquet import Shard, ShardedTable
from tactile_toolkit.touch.schema import CLASS_NAMES, Kind
from tactile_toolkit.wording import counted

R = TypeVar("R", bound=TouchRound)


class TouchDataset(Rounds[R]):
    """A lazy sequence of rounds; see :class:`tactile_toolkit.read.dataset.RecordDataset`.

    Parameters
    ----------
    tables, rows, label_names
        As for :class:`tactile_toolkit.read.dataset.RecordDataset`.
    skipped : sequence of (int or None, Damage)
        Damage that was found and is left out, each with the number of its row in the joined tables: rounds by
        the data set itself, single touches by :meth:`touches`. None stands for a file left out as a whole.
    """

    things = "rounds"

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

    @property
    def _lost_touches(self) -> frozenset[tuple[int, int]]:
        """Stored row and number in the round of each touch that was left out."""
        lost = set()
        for row, damage in self._skipped:
            if row is not None and damage.touch is not None:
                lost.add((row, damage.touch))
        return frozenset(lost)

    def contact_z_m(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Read the height of the gel at the deepest press of every stored touch.

        Opens no image or clip, but where a set states no lengths of padded clips: those are counted then.

        Returns
        -------
        z_m : ndarray, shape (touches of all stored rows,), float64
            Metres, cell frame, not recalibrated. NaN for touches that were left out on loading, and in rows
            that are not in this view, where it cannot be read.
        starts : ndarray of int64, shape (stored rows + 1,)
            Where the touches of each stored row begin in ``z_m``.

        Raises
        ------
        IntegrityError
            The height of a touch of this view cannot be read; names file, row and touch.
        """
        z_m, starts = self.known_contact_z_m()
        unknown, lost = np.isnan(z_m), self._lost_touches
        for position, row in enumerate(self.row_numbers.tolist() if unknown.any() else ()):
            for touch in np.flatnonzero(unknown[starts[row] : starts[row + 1]]).tolist():
                if (row, touch) not in lost:
                    touch_contact_z_m(self[position]._row, self.kind, touch)  # says what is wrong
        return z_m, starts

    def __eq__(self, other: object) -> bool:
        """Return whether both hold equal rounds in the same order, and left out the same touches of them."""
        equal = super().__eq__(other)
        if not isinstance(other, TouchDataset) or equal is NotImplemented:
            return NotImplemented
        return equal and self._lost_places() == other._lost_places()

    __hash__ = RecordDataset.__hash__

    def _lost_places(self) -> set[tuple[int, int]]:
        lost: dict[int, list[int]] = {}
        for row, touch in self._lost_touches:
            lost.setdefault(row, []).append(touch)
        rows = enumerate(self.row_numbers.tolist()) if lost else ()
        return {(place, touch) for place, row in rows for touch in lost.get(row, ())}

    def _joined(self, other: Self) -> Self:
        joined, offset = super()._joined(other), int(self._starts[-1])
        moved = [(None if row is None else row + offset, damage) for row, damage in other._skipped]
        joined._skipped = (*self._skipped, *moved)
        return joined


class TouchSingleDataset(TouchDataset[TouchSingleRound]):
    """Rounds with one image per touch."""

    record_class: ClassVar[type[Any]] = TouchSingleRound
    kind = "single"


class TouchSeqDataset(TouchDataset[TouchSeqRound]):
    """Rounds with one clip per touch."""

    record_class: ClassVar[type[Any]] = TouchSeqRound
    kind = "seq"


def dataset_of(
    shards: Sequence[Shard],
    kind: Kind,
    rows: NDArray[np.int64] | None = None,
    skipped: Sequence[tuple[int | None, Damage]] = (),
) -> TouchSeqDataset | TouchSingleDataset:
    """Return the data set of some shards of one kind: of all rows, or those that are not skipped."""
    stated = stated_class_names(shards)
    names = CLASS_NAMES if stated is None else stated
    if kind == "seq":
        return TouchSeqDataset([ShardedTable(tuple(shards))], rows, names, skipped)
    return TouchSingleDataset([ShardedTable(tuple(shards))], rows, names, skipped)


class TouchStream:
    """Rounds one after another, read from their address piece by piece; nothing is stored locally.

    Parameters
    ----------
    shards : tuple of Shard
        Shards to read in turn.
    kind : "seq" or "single"
        What they hold.
    skip_damage : bool
        Check each round before it is given: leave out damaged rounds, and damaged touches of the others, and
        rows that cannot be read.
    expected_touches : int, optional
        T that each round must have to pass that check.
    left_out : sequence of Damage
        Files that were left out beforehand.

    Attributes
    ----------
    skipped : list of Damage
        What was left out so far, since the stream was last begun.
    """

    def __init__(
        self,
        shards: tuple[Shard, ...],
        kind: Kind,
        *,
        skip_damage: bool = False,
        expected_touches: int | None = None,
        left_out: Sequence[Damage] = (),
    ) -> None:
        self.shards = shards
        self.kind = kind
        self.skip_damage = skip_damage
        self.skipped = list(left_out)
        self._expected_touches = expected_touches
        self._left_out = tuple(left_out)
        self._stated_names = stated_class_names(shards)

    @property
    def label_names(self) -> tuple[str, ...]:
        """Name of each class."""
        return CLASS_NAMES if self._stated_names is None else self._stated_names

    def part(self, index: int, count: int) -> TouchStream:
        """Return every ``count``-th shard from ``index`` on, for workers that share the work."""
        part = TouchStream(
            self.shards[index::count],
            self.kind,
            skip_damage=self.skip_damage,
            expected_touches=self._expected_touches,
            left_out=self._left_out[index::count],
        )
        part._stated_names = self._stated_names
        return part

    def touches(self) -> Touches[Any]:
        """Return the flat view: every touch of every round, in order, with random access.

        A row group is read from its address when one of its rows is first asked for, and kept in the cache.

        Raises
        ------
        InputError
            The stream leaves out what is damaged, which is known only when all of it was read.
        """
        if self.skip_damage:
            raise InputError(
                "a stream that skips damage has no numbered touches", next="load it without streaming"
            )
        return dataset_of(self.shards, self.kind).touches()

    def __iter__(self) -> Iterator[TouchRound]:
        """Yield rounds; a bounded block of rows is in memory at a time."""
        # In place: who holds the list sees what this pass leaves out.
        self.skipped[:] = self._left_out
        record = TouchSingleRound if self.kind == "single" else TouchSeqRound
        for shard in self.shards:
            for index in range(shard.metadata.num_row_groups):
                try:
                    for group in shard.blocks(index):
                        for row in range(len(group.table)):
                            yield from self._undamaged(record(Row(group, row)))
                except IntegrityError as error:
                    if not self.skip_damage:
                        raise
                    self.skipped.append(unreadable_rows(shard, index, error))

    def _undamaged(self, record: TouchRound) -> Iterator[TouchRound]:
        """Yield a round, or what is intact of it; nothing where it is damaged as a whole."""
        if not self.skip_damage:
            yield record
            return
        found = check_round(record._row, self._expected_touches, class_names=self._stated_names)
        self.skipped += found
        lost = {damage.touch for damage in found}
        if None not in lost:
            kept = [touch for touch in range(record.touch_count) if touch not in lost]
            yield record.with_touches(kept) if lost else record

    def __repr__(self) -> str:
        words = with_origins(counted(len(self.shards), "shards"), [ShardedTable(self.shards)])
        return f"TouchStream({self.kind}, {', '.join(words)})"
