"""Unpacked blocks in the memory of one process: what takes the place of a cache that cannot be written.

The blocks used last are kept, up to a limit. A row group that fits is decoded once; of a larger one, a pass
from front to back still decodes each block once, because decoding goes on where it stopped, and a jump back
decodes from the row group's beginning.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from threading import RLock

from dataset_store.rowgroup import RowGroup

__all__ = ["MEMORY", "MemoryBlocks"]


@dataclass(eq=False)
class MemoryBlocks:
    """Blocks by name of their row group and number; safe to share between threads.

    Parameters
    ----------
    limit_bytes : int
        How much is kept. The block asked for last is kept even where it alone is larger.

    Attributes
    ----------
    size_bytes : int
        How much is kept now.
    """

    limit_bytes: int
    size_bytes: int = field(default=0, init=False)
    _kept: OrderedDict[tuple[str, int], RowGroup] = field(default_factory=OrderedDict, repr=False)
    _under_way: tuple[str, int, Iterator[RowGroup]] | None = field(default=None, repr=False)
    _lock: RLock = field(default_factory=RLock, repr=False)

    def forget(self) -> None:
        """Drop everything; for a process that was just forked, which may have copied a held lock."""
        self._lock = RLock()
        self._kept = OrderedDict()
        self._under_way, self.size_bytes = None, 0

    def find(self, name: str, number: int) -> RowGroup | None:
        """Return a block when it is kept."""
        if not self._kept:
            return None
        with self._lock:
            group = self._kept.get((name, number))
            if group is not None:
                self._kept.move_to_end((name, number))
            return group

    def block(self, name: str, number: int, decode: Callable[[], Iterator[RowGroup]]) -> RowGroup:
        """Return a block, decoding no more of its row group than it takes.

        Parameters
        ----------
        name : str
            Name of the row group.
        number : int
            Number of the block in it.
        decode : callable
            Starts decoding the blocks of the row group from the first one on.

        Raises
        ------
        IndexError
            The row group has fewer blocks.
        IntegrityError
            As ``decode``.
        """
        with self._lock:
            return self.find(name, number) or self._decoded(name, number, decode)

    def _decoded(self, name: str, number: int, decode: Callable[[], Iterator[RowGroup]]) -> RowGroup:
        place, groups = self._start(name, number, decode)
        for group in groups:
            self._keep((name, place), group)
            place += 1
            if place > number:
                self._under_way = (name, place, groups)
                return group
        message = f"block {number} of {name!r}; the row group has {place}"
        raise IndexError(message)

    def _start(
        self, name: str, number: int, decode: Callable[[], Iterator[RowGroup]]
    ) -> tuple[int, Iterator[RowGroup]]:
        """Go on where decoding stopped, or begin anew."""
        under_way, self._under_way = self._under_way, None
        if under_way is not None and under_way[0] == name and under_way[1] <= number:
            return under_way[1:]
        return 0, decode()

    def _keep(self, key: tuple[str, int], group: RowGroup) -> None:
        self._drop(key)
        self._kept[key] = group
        self.size_bytes += _size_bytes(group)
        while self.size_bytes > self.limit_bytes and len(self._kept) > 1:
            self._drop(next(iter(self._kept)))

    def _drop(self, key: tuple[str, int]) -> None:
        group = self._kept.pop(key, None)
        if group is not None:
            self.size_bytes -= _size_bytes(group)


def _size_bytes(group: RowGroup) -> int:
    return int(group.table.nbytes)


MEMORY = MemoryBlocks(512 << 20)
"""The blocks of this process: eight blocks of the usual size, 64 MB each."""

if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=MEMORY.forget)
