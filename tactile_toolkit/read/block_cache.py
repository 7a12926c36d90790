"""The cache folder: Arrow files of unpacked row groups, mapped into memory by every process on a machine."""

from __future__ import annotations

import contextlib
import os
import warnings
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from threading import RLock
from typing import Any

from tactile_toolkit.cache import CACHE_VARIABLE, cache_folder
from tactile_toolkit.read.columns import RowGroup
from tactile_toolkit.store.folder import atomic_file, leavings

__all__ = ["MEMORY", "MemoryBlocks", "mapped_batch", "store_batches"]


_CACHE_LIMIT_BYTES = 32 << 30
_unwritable: set[Path] = set()  # cache folders that this process has given up on


def mapped_batch(name: str, number: int) -> Any:
    """Map one record batch of a file of the cache.

    Returns
    -------
    pyarrow.RecordBatch or None
        None when the file is not there, or was damaged (it is then removed).
    """
    import pyarrow as pa

    path = _place(name)
    try:
        # From the map's own buffer, still without a copy: from the map, Arrow would read in its own threads.
        batch = pa.ipc.open_file(pa.memory_map(str(path)).read_buffer()).get_batch(number)
    except FileNotFoundError:
        return None
    except (pa.ArrowInvalid, IndexError, OSError):
        with contextlib.suppress(OSError):  # a cache that cannot be written must not stop a reader
            path.unlink(missing_ok=True)
        return None
    with contextlib.suppress(OSError):
        os.utime(path)  # the time of last use decides what leaves a full cache first
    return batch


def store_batches(name: str, schema: Any, size_bytes: int, tables: Iterable[Any]) -> bool:
    """Write tables as the record batches of a file of the cache, making room for it first.

    A folder that cannot be written is told once and not tried again by this process: trying costs decoding.

    Parameters
    ----------
    name : str
        Name of the file in the cache.
    schema : pyarrow.Schema
        Schema of the tables.
    size_bytes : int
        How large they are, about.
    tables : iterable of pyarrow.Table
        Each becomes one batch; nothing is taken from it when the folder is known to be unwritable.

    Returns
    -------
    bool
        Whether the file is there now.
    """
    place = _place(name)
    if place.parent in _unwritable:
        return False
    try:
        _make_room(place.parent, size_bytes)
        _write_arrow(place, schema, tables)
    except OSError as error:
        _give_up(place.parent, error)
        return False
    return True


def _place(name: str) -> Path:
    return cache_folder() / "blocks" / f"{name}.arrow"


def _give_up(folder: Path, error: OSError) -> None:
    _unwritable.add(folder)
    message = (
        f"row groups cannot be kept unpacked, {str(folder)!r} cannot be written: {error.strerror or error}; "
        "what was used last stays in the memory of this process, all else is decoded again; next: make room "
        f"there, or let {CACHE_VARIABLE} name another folder"
    )
    warnings.warn(message, RuntimeWarning, stacklevel=2)


def _write_arrow(place: Path, schema: Any, tables: Iterable[Any]) -> None:
    import pyarrow as pa

    with atomic_file(place) as stream, pa.ipc.new_file(stream, schema) as writer:
        for table in tables:
            writer.write_table(table)


def _make_room(folder: Path, needed_bytes: int) -> None:
    """Drop the files used longest ago when the cache would pass its limit; open maps stay valid."""
    for left in leavings(folder):
        left.unlink(missing_ok=True)
    files = sorted(_cached_files(folder))
    excess = sum(size for _, size, _ in files) + needed_bytes - _CACHE_LIMIT_BYTES
    for _, size, file in files:
        if excess <= 0:
            return
        file.unlink(missing_ok=True)
        excess -= size


def _cached_files(folder: Path) -> Iterator[tuple[int, int, Path]]:
    """Yield time of last use, size and place of finished files; other processes may remove some meanwhile."""
    for file in folder.glob("[!.]*.arrow"):
        with contextlib.suppress(FileNotFoundError):
            facts = file.stat()
            yield facts.st_mtime_ns, facts.st_size, file


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
