"""Rounds one after another, from wherever they lie."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from realtouch.integrity.agreement import stated_class_names
from realtouch.integrity.damage import Damage, unreadable_rows
from realtouch.rounds import TouchRound, TouchSeqRound, TouchSingleRound
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.touch.schema import CLASS_NAMES, Kind

__all__ = ["TouchStream"]


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

    def __iter__(self) -> Iterator[TouchRound]:
        """Yield rounds; a bounded block of rows is in memory at a time."""
        self.skipped[:] = self._left_out
        for shard in self.shards:
            for index in range(shard.metadata.num_row_groups):
                try:
                    yield from self._group(shard, index)
                except IntegrityError as error:
                    if not self.skip_damage:
                        raise
                    self.skipped.append(unreadable_rows(shard, index, error))

    def _group(self, shard: Shard, index: int) -> Iterator[TouchRound]:
        home = TouchSingleRound if self.kind == "single" else TouchSeqRound
        for group in shard.blocks(index):
            for row in range(len(group.table)):
                yield from self._whole(home(Row(group, row)))

    def _whole(self, record: TouchRound) -> Iterator[TouchRound]:
        """Yield a round, or what is whole of it."""
        if not self.skip_damage:
            yield record
            return
        from realtouch.integrity.check_round import check_round

        found = check_round(record._row, self._expected_touches, class_names=self._stated_names)
        self.skipped += found
        lost = {damage.touch for damage in found}
        if None not in lost:
            kept = [touch for touch in range(record.touch_count) if touch not in lost]
            yield record.with_touches(kept) if lost else record

    def __repr__(self) -> str:
        return f"TouchStream({self.kind}, {len(self.shards)} shards)"
