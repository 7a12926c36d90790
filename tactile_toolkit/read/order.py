"""The order of items in a training job, independent of the number of ranks and workers.

An epoch is one sequence of all items: shards in random order, and the items of a window of a few shards in
random order. It depends only on the seed, the number of the epoch and the sizes of the shards. Ranks take
turns in it, and the workers of a rank take turns in its batches. The state of a pass is one number: the items
that all ranks together have received.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from threading import Event, Thread
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit import cache, checked_fields, errors, wording
from tactile_toolkit.value_types import Int64

_KEPT_WINDOWS = 2  # a batch may extend over the end of one
_ROUNDING = 1e-9  # 0.7 + 0.2 + 0.1 is 0.9999999999999999


@dataclass(frozen=True, eq=False)
class StoredParts:
    """Parts of a data set that are stored together, such as shards.

    ``starts``, shape (parts + 1,), ascending, are the first items of the parts in stored order. ``order`` are
    the positions of items in stored order; None if they are in this order.
    """

    starts: Int64
    order: Int64 | None = None

    def __len__(self) -> int:
        return len(self.starts) - 1

    def positions(self, part: int) -> Int64:
        """Return the items of a part, in stored order."""
        start, stop = self.starts[part : part + 2].tolist()
        return np.arange(start, stop) if self.order is None else self.order[start:stop]


@dataclass(frozen=True, eq=False)
class GlobalOrder:
    """The order of the items of one epoch; without a seed, the stored order."""

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
        """Digest of everything that determines the orders of all epochs."""
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
        """Return the window of an item."""
        return int(np.searchsorted(self._starts, number, "right")) - 1

    def stored(self, window: int) -> Int64:
        """Return the positions of the items of a window in stored order; empty after the last window."""
        shards = self._shards[window * self.window : (window + 1) * self.window].tolist()
        parts = [self.parts.positions(shard) for shard in shards]
        return np.concatenate(parts or [np.zeros(0, np.int64)])

    def positions(self, numbers: Int64) -> Int64:
        """Return the positions in the data set of items by their numbers in the epoch; same shape, int64."""
        windows = np.searchsorted(self._starts, numbers, "right") - 1
        items = np.empty(len(numbers), np.int64)
        for window in np.unique(windows).tolist():
            here = windows == window
            items[here] = self._window(window)[numbers[here] - self._starts[window]]
        return items

    def _shuffled(self, values: Int64, stream: int) -> Int64:
        """Shuffle by the stream of PCG64, which numpy guarantees, unlike its shuffles."""
        if self.seed is None:
            return values
        # One stream for each window, so that a job can start anywhere.
        bits = np.random.PCG64([self.seed, self.number, stream]).random_raw(len(values))
        return values[np.argsort(bits, kind="stable")]


@dataclass(frozen=True)
class RankSampler:
    """The items from ``start`` on of one rank of several, in batches; all ranks get equally many.

    Rank r gets every ``ranks``-th item. If the number of items is not a multiple, the first items of the
    epoch are repeated, one for each rank that would get one less; with ``drop_last``, items that do not make
    a complete batch for every rank are left out instead.
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
    """Unpacks the row groups of a window into the cache, and those of the next window in the background.

    The processes of a machine share the work: ``turn``, from 0 to below 1, is where this process starts among
    the row groups, and no row group is unpacked twice. Errors are raised when the item is requested.
    """

    def __init__(self, data: Any, order: GlobalOrder, turn: float) -> None:
        self._data = data
        self._order = order
        self._turn = turn
        self._window = -1
        self._closed = Event()
        self._thread: Thread | None = None

    def enter(self, window: int) -> None:
        """Wait until a window is unpacked, and start with the next one; earlier windows may be evicted."""
        if window <= self._window:
            return
        self._window = window
        size_bytes = self._unpack(window)
        if 2 * size_bytes <= cache.cache_limit_bytes():  # the next one must not evict this one
            # A daemon, so that a job that ends within an epoch does not wait for it.
            self._thread = Thread(target=self._unpack, args=(window + 1,), daemon=True)
            self._thread.start()

    def close(self) -> None:
        """Stop after the current row group."""
        self._closed.set()
        if self._thread is not None:
            self._thread.join()

    def _unpack(self, window: int) -> int:
        """Return the approximate size of a window in bytes; 0 where the cache cannot be written."""
        size_bytes = 0
        with suppress(errors.ToolkitError, OSError):
            groups = self._data.row_groups(self._order.stored(window))
            first = int(self._turn * len(groups))
            for shard, index in (*groups[first:], *groups[:first]):
                more_bytes = 0 if self._closed.is_set() else shard.unpack(index)
                if not more_bytes:
                    return 0
                size_bytes += more_bytes
        return size_bytes


def random_order(seed: int, length: int) -> Int64:
    """Return the numbers from 0 to below a length in random order."""
    return np.argsort(_random_bits(seed, length), kind="stable")


def random_parts(parts: Sequence[float], length: int, seed: int, labels: Int64 | None = None) -> list[Int64]:
    """Divide items at random; returns the numbers of the items of each part, in random order.

    With ``labels``, shape (length,), each class is divided in the same proportions, up to about one item.
    Raises InputError for impossible sizes.
    """
    ends = _part_ends(parts, length)
    order = random_order(seed, length)
    if labels is None:
        return np.split(order, ends)[: len(ends)]
    # Each class is spread evenly over 0 to 1, with its own offset, so that a cut anywhere divides all classes
    # in the same proportions, up to one item.
    labels = labels[order]
    classes, counts = np.unique(labels, return_counts=True)
    # Bits after those of the order, which does not depend on whether classes are used.
    starts = _random_bits(seed, length + len(classes))[length:] / 2.0**64
    spread = np.empty(length)
    for label, count, start in zip(classes, counts, starts, strict=True):
        spread[labels == label] = (np.arange(count) + start) / count
    part_of = np.empty(length, np.int64)
    part_of[np.argsort(spread, kind="stable")] = np.searchsorted(ends, np.arange(length), "right")
    return [order[part_of == part] for part in range(len(ends))]


def _random_bits(seed: int, count: int) -> NDArray[np.uint64]:
    """Return random bits of the stream of PCG64, which numpy guarantees, unlike its shuffles."""
    return np.asarray(
        np.random.PCG64(checked_fields.checked_integer(seed, "seed")).random_raw(count), np.uint64
    )


def _part_ends(parts: Sequence[float], length: int) -> list[int]:
    """Return the end of each part, including the remaining one; InputError for impossible sizes."""
    numbers = checked_fields.is_integer(*parts)
    shares = all(isinstance(part, float) and 0 <= part <= 1 for part in parts)
    total, whole = (sum(parts), length) if numbers or shares else (0, 0)
    whole = whole if numbers else 1
    if not parts or not (numbers or shares) or total > whole + _ROUNDING or min(parts) < 0:
        asked = ", ".join(map(repr, parts)) or "nothing"
        raise errors.InputError(
            f"a split into {asked} was asked for; expected shares such as 0.8, 0.2 that add up to at most 1, "
            f"or integers that add up to at most {wording.with_count(length, 'rows')}"
        )
    if numbers:
        ends = np.cumsum(parts).tolist()
    else:
        ends = np.minimum(np.round(np.cumsum(parts) * length), length).astype(int).tolist()
    return ends if total >= whole - _ROUNDING else [*ends, length]
