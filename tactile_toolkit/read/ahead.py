"""Unpacking what a training job needs next while it is at work on what it has."""

from __future__ import annotations

import warnings
from contextlib import suppress
from threading import Event, Thread
from typing import Any

from tactile_toolkit.bounds import CACHE_LIMIT_VARIABLE, cache_limit_bytes
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.read.order import EpochOrder
from tactile_toolkit.read.sequence import LazySequence


class UnpackingAhead:
    """Sees to it that the row groups of a window lie unpacked in the cache, and then those of the next.

    All processes of a machine share the work: ``turn``, from 0 to below 1, says where among the row groups
    this one begins, and what another has done or is doing is not done again. Damage is left for whoever asks
    for the item.
    """

    def __init__(self, data: LazySequence[Any], order: EpochOrder, turn: float) -> None:
        self._data = data
        self._order = order
        self._turn = turn
        self._window = -1
        self._closed = Event()
        self._thread: Thread | None = None

    def enter(self, window: int) -> None:
        """Wait until a window is unpacked, and begin with the next one; there is no way back."""
        if window <= self._window:
            return
        self._window = window
        size_bytes = self._unpack(window)
        limit_bytes = cache_limit_bytes()
        if size_bytes > limit_bytes:
            message = (
                f"shards of one window unpack to {size_bytes:,} bytes; the cache keeps {limit_bytes:,}, so "
                "that row groups are unpacked again and again; next: take a smaller window, or set "
                f"{CACHE_LIMIT_VARIABLE}={2 * size_bytes >> 20}"
            )
            warnings.warn(message, RuntimeWarning, stacklevel=2)
        if 2 * size_bytes <= limit_bytes:  # the next one must not drive this one out
            # A job that ends in the middle of an epoch does not wait for row groups that nobody asks for any
            # more.
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
                if self._closed.is_set() or not shard.unpack(index):
                    return 0
                size_bytes += shard.unpacked_bytes(index)
        return size_bytes
