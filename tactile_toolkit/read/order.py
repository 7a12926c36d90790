"""The order in which a training job meets the items of a data set, the same whatever the job runs on.

An epoch is one sequence of all items: shards in random order, and the items of a few shards at a time, a
window, in random order among them. It follows from the seed, the number of the epoch and the sizes of the
shards alone. Ranks take turns in it, and the workers of a rank take turns in its batches. Where a pass goes
on is one number: how many items all ranks together have been given.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

_KEPT_WINDOWS = 2  # a batch may reach over the end of one


@dataclass(frozen=True, eq=False)
class StoredParts:
    """Which items of a data set lie together, such as in one shard.

    ``starts``, shape (parts + 1,), says where each part begins when all items are laid in the order in which
    they are stored; ``order`` are their positions in that order, None where they are in it already.
    """

    starts: NDArray[np.int64]
    order: NDArray[np.int64] | None = None

    @classmethod
    def of(cls, starts: NDArray[np.int64], order: NDArray[np.int64] | None = None) -> StoredParts:
        """Return the parts that hold anything."""
        # A part without items begins where the next one does.
        return cls(np.unique(starts), order)

    def __len__(self) -> int:
        return len(self.starts) - 1

    def positions(self, part: int) -> NDArray[np.int64]:
        """Return the items of a part, as stored."""
        start, stop = self.starts[part : part + 2].tolist()
        return np.arange(start, stop) if self.order is None else self.order[start:stop]


@dataclass(frozen=True, eq=False)
class GlobalOrder:
    """The order of every epoch; without a seed, that in which items are stored."""

    parts: StoredParts
    seed: int | None
    window: int

    def __len__(self) -> int:
        return int(self.parts.starts[-1])

    @cached_property
    def fingerprint(self) -> str:
        """What tells this order from others: a checksum of all that it follows from."""
        order = self.parts.order
        parts = [repr((self.seed, self.window)).encode(), self.parts.starts.astype("<i8").tobytes()]
        parts += [] if order is None else [order.astype("<i8").tobytes()]
        return hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]

    def epoch(self, number: int) -> EpochOrder:
        """Return the order of one epoch."""
        return EpochOrder(self, number)


class EpochOrder:
    """The order of one epoch: numbers of all items from 0, and which item has which."""

    def __init__(self, order: GlobalOrder, number: int) -> None:
        self._order = order
        self._number = number
        self._shards = self._shuffled(np.arange(len(order.parts)), 0)
        sizes = np.diff(order.parts.starts)[self._shards]
        first = np.arange(0, len(sizes) + 1, order.window)
        self._starts = np.concatenate([[0], np.cumsum(sizes)])[np.append(first, len(sizes))]
        self._window = lru_cache(_KEPT_WINDOWS)(self._shuffled_window)

    def window_of(self, number: int) -> int:
        """Return the window in which an item lies."""
        return int(np.searchsorted(self._starts, number, "right")) - 1

    def stored(self, window: int) -> NDArray[np.int64]:
        """Return the positions of the items of a window, shard by shard as stored; none after the last."""
        shards = self._shards[window * self._order.window : (window + 1) * self._order.window].tolist()
        parts = [self._order.parts.positions(shard) for shard in shards]
        return np.concatenate(parts or [np.zeros(0, np.int64)])

    def positions(self, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the position in the data set of items by their numbers; shape as given, int64."""
        windows = np.searchsorted(self._starts, numbers, "right") - 1
        found = np.empty(len(numbers), np.int64)
        for window in np.unique(windows).tolist():
            here = windows == window
            found[here] = self._window(window)[numbers[here] - self._starts[window]]
        return found

    def _shuffled_window(self, window: int) -> NDArray[np.int64]:
        return self._shuffled(self.stored(window), 1 + window)

    def _shuffled(self, values: NDArray[np.int64], stream: int) -> NDArray[np.int64]:
        """Shuffle by the stream of PCG64, which numpy promises to keep, unlike its own shuffles."""
        if self._order.seed is None:
            return values
        # A stream for each window: it is shuffled without those before it, wherever a job begins.
        bits = np.random.PCG64([self._order.seed, self._number, stream]).random_raw(len(values))
        return values[np.argsort(bits, kind="stable")]


@dataclass(frozen=True)
class Share:
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

    def batch(self, index: int) -> NDArray[np.int64]:
        """Return the numbers of the items of one batch."""
        first = index * self.batch_size
        turns = np.arange(first, min(first + self.batch_size, self.items))
        return (self.start + self.rank + self.ranks * turns) % self.total

    def reached(self, batches: int) -> int:
        """Return how many items of the epoch all ranks have been given after so many batches each."""
        return min(self.start + self.ranks * min(batches * self.batch_size, self.items), self.total)
