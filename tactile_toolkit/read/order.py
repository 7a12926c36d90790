"""The order in which a training job meets the items of a data set, the same whatever the job runs on.

An epoch is one sequence of all items: shards in random order, and the items of a few shards at a time, a
window, in random order among them. It follows from the seed, the number of the epoch and the sizes of the
shards alone. Ranks take turns in it, and the workers of a rank take turns in its batches. Where a pass goes
on is one number: how many items all ranks together have been given.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from threading import Event, Thread
from typing import Any

import numpy as np

from tactile_toolkit.array_types import Int64
from tactile_toolkit.bounds import cache_limit_bytes
from tactile_toolkit.errors import ToolkitError

_KEPT_WINDOWS = 2  # a batch may reach over the end of one


@dataclass(frozen=True, eq=False)
class StoredParts:
    """Which items of a data set lie together, such as in one shard.

    ``starts``, shape (parts + 1,), rising, says where each part begins when all items are laid in the order
    in which they are stored; ``order`` are their positions in that order, None where they are in it already.
    """

    starts: Int64
    order: Int64 | None = None

    def __len__(self) -> int:
        return len(self.starts) - 1

    def positions(self, part: int) -> Int64:
        """Return the items of a part, as stored."""
        start, stop = self.starts[part : part + 2].tolist()
        return np.arange(start, stop) if self.order is None else self.order[start:stop]


@dataclass(frozen=True, eq=False)
class GlobalOrder:
    """The order of one epoch: numbers of all items from 0, and which item has which.

    Without a seed, it is that in which items are stored.
    """

    parts: StoredParts
    seed: int | None
    window: int
    number: int = 0

    def epoch(self, number: int) -> GlobalOrder:
        """Return the order of another epoch."""
        return replace(self, number=number)

    def __len__(self) -> int:
        return int(self.parts.starts[-1])

    @cached_property
    def fingerprint(self) -> str:
        """By what the orders of all epochs differ from others: a checksum of all that they follow from."""
        order = self.parts.order
        parts = [repr((self.seed, self.window)).encode(), self.parts.starts.astype("<i8").tobytes()]
        parts += [] if order is None else [order.astype("<i8").tobytes()]
        return hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]

    @cached_property
    def _shards(self) -> Int64:
        return self._shuffled(np.arange(len(self.parts)), 0)

    @cached_property
    def _starts(self) -> Int64:
        sizes = np.diff(self.parts.starts)[self._shards]
        first = np.arange(0, len(sizes) + 1, self.window)
        ends = np.concatenate([[0], np.cumsum(sizes)])
        return np.asarray(ends[np.append(first, len(sizes))])

    @cached_property
    def _window(self) -> Callable[[int], Int64]:
        return lru_cache(_KEPT_WINDOWS)(lambda window: self._shuffled(self.stored(window), 1 + window))

    def window_of(self, number: int) -> int:
        """Return the window in which an item lies."""
        return int(np.searchsorted(self._starts, number, "right")) - 1

    def stored(self, window: int) -> Int64:
        """Return the positions of the items of a window, shard by shard as stored; none after the last."""
        shards = self._shards[window * self.window : (window + 1) * self.window].tolist()
        parts = [self.parts.positions(shard) for shard in shards]
        return np.concatenate(parts or [np.zeros(0, np.int64)])

    def positions(self, numbers: Int64) -> Int64:
        """Return the position in the data set of items by their numbers; shape as given, int64."""
        windows = np.searchsorted(self._starts, numbers, "right") - 1
        found = np.empty(len(numbers), np.int64)
        for window in np.unique(windows).tolist():
            here = windows == window
            found[here] = self._window(window)[numbers[here] - self._starts[window]]
        return found

    def _shuffled(self, values: Int64, stream: int) -> Int64:
        """Shuffle by the stream of PCG64, which numpy promises to keep, unlike its own shuffles."""
        if self.seed is None:
            return values
        # A stream for each window: it is shuffled without those before it, wherever a job begins.
        bits = np.random.PCG64([self.seed, self.number, stream]).random_raw(len(values))
        return values[np.argsort(bits, kind="stable")]


@dataclass(frozen=True)
class RankSampler:
    """What one rank of several is given of the items from ``start`` on, in batches; all get equally many.

    Rank r gets every ``ranks``-th item. Where they do not come out even, the first items of the epoch are
    given again, one each to the ranks that would get one less; with ``drop_last``, what makes no whole batch
    for every rank is left out instead.
    """

    total: int
    start: int
    rank: int
    ranks: int
    batch_size: int
    drop_last: bool

    @property
    def items(self) -> int:
        """Items of each rank."""
        left = max(self.total - self.start, 0)
        if self.drop_last:
            return left // (self.ranks * self.batch_size) * self.batch_size
        return -(-left // self.ranks)

    def __len__(self) -> int:
        """Batches of each rank."""
        return -(-self.items // self.batch_size)

    def batch(self, index: int) -> Int64:
        """Return the numbers of the items of one batch."""
        first = index * self.batch_size
        turns = np.arange(first, min(first + self.batch_size, self.items))
        return (self.start + self.rank + self.ranks * turns) % self.total


class Prefetcher:
    """Sees to it that the row groups of a window lie unpacked in the cache, and then those of the next.

    All processes of a machine share the work: ``turn``, from 0 to below 1, says where among the row groups
    this one begins, and what another has done or is doing is not done again. Damage is left for whoever asks
    for the item.
    """

    def __init__(self, data: Any, order: GlobalOrder, turn: float) -> None:
        self._data = data
        self._order = order
        self._turn = turn
        self._window = -1
        self._closed = Event()
        self._thread: Thread | None = None

    def enter(self, window: int) -> None:
        """Wait until a window is unpacked, and begin with the next one; earlier ones are gone."""
        if window <= self._window:
            return
        self._window = window
        size_bytes = self._unpack(window)
        if 2 * size_bytes <= cache_limit_bytes():  # the next one must not drive this one out
            # A job that ends in the middle of an epoch does not wait for row groups that are not needed.
            self._thread = Thread(target=self._unpack, args=(window + 1,), daemon=True)
            self._thread.start()

    def close(self) -> None:
        """Stop after the row group that is being unpacked."""
        self._closed.set()
        if self._thread is not None:
            self._thread.join()

    def _unpack(self, window: int) -> int:
        """Return about how much a window takes; nothing where the cache cannot be written."""
        size_bytes = 0
        with suppress(ToolkitError, OSError):
            groups = self._data._row_groups(self._order.stored(window))
            first = int(self._turn * len(groups))
            for shard, index in (*groups[first:], *groups[:first]):
                more_bytes = 0 if self._closed.is_set() else shard.unpack(index)
                if not more_bytes:
                    return 0
                size_bytes += more_bytes
        return size_bytes
