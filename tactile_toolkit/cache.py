"""What can be made again and is kept to save time: files on disk, objects in memory, both bounded.

Least recently used entries are evicted first. A folder may pass its limit for a while, by a tenth or so. A
cache that cannot be written costs speed, never data. Only files with names that a cache gives are listed or
removed, and none through a symbolic link: all other files are the user's.
"""

from __future__ import annotations

import contextlib
import errno
import os
import random
import re
import stat
import tempfile
import time
import warnings
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from threading import RLock
from typing import IO, Any, Generic, TypeVar

from tactile_toolkit import store
from tactile_toolkit.errors import InputError, ToolkitError

LOCKS = "locks"
"""Folder of the cache whose files processes hold while they write others."""

# The names of the files in each folder that may be removed; the folders of locks and links hold no data.
_NAMES = {
    "blocks": "[0-9a-f]{32}-[0-9]{5}-[0-9]{5}[.]arrow",
    "environments": "meshes-[0-9a-f]{32}",
}

CACHE_VARIABLE = "TACTILE_TOOLKIT_CACHE"
"""Environment variable that names the cache folder."""


def cache_folder() -> Path:
    """Return the cache folder: ``$TACTILE_TOOLKIT_CACHE``, or ours in the user's cache folder."""
    named = os.environ.get(CACHE_VARIABLE)
    if named:
        return store.expanded(named, CACHE_VARIABLE)
    of_system = os.environ.get("XDG_CACHE_HOME")
    if of_system:
        return store.expanded(of_system, "XDG_CACHE_HOME") / "tactile-toolkit"
    try:
        return store.expanded("~/.cache") / "tactile-toolkit"
    except InputError:  # a user without a home, as in some containers
        return _temporary_cache()


@cache
def _temporary_cache() -> Path:
    """Return a cache folder of this user alone in the system's temporary folder, and say so once."""
    path = Path(tempfile.gettempdir()) / f"tactile-toolkit-{os.getuid()}"
    path.mkdir(mode=0o700, exist_ok=True)
    found = path.lstat()
    # Of another user, its files would be read as data; a link leads anywhere.
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        path = Path(tempfile.mkdtemp(prefix="tactile-toolkit-"))
    warnings.warn(
        f"no home folder is known: the cache is {str(path)!r}; next: let {CACHE_VARIABLE} "
        "name another folder",
        RuntimeWarning,
        stacklevel=2,
    )
    return path


# A folder is looked through by chance, once in the mean for so small a part of its limit that is written,
# whichever process writes: none has to know of the others, nor to look at every file for each that it writes.
_LOOKED_THROUGH_AFTER = 32
# Another generator would draw alike in forked processes, or take numbers from whoever has seeded it.
_CHANCE = random.SystemRandom()

# What leaves makes room for one part in so many of the limit: files would leave at each look.
_ROOM_MADE = 16

_unwritable: set[Path] = set()  # folders that this process has given up on


@dataclass
class DiskCache:
    """Files in one folder, shared by threads and processes; each appears whole or not at all.

    ``folder`` is a path, or a name inside the cache folder, which may change while a process runs. ``names``
    is a pattern of the names of its files; the folders of the cache have theirs. With ``durable``, a file is
    on the disk before it gets its name; without, readers must notice themselves what a power cut has spoiled.
    ``warning``, with ``{problem}`` in it, is given once where nothing can be written.
    """

    folder: Path | str
    limit_bytes: int
    durable: bool = True
    warning: str = ""
    names: str = ""

    def __post_init__(self) -> None:
        self.names = self.names or _NAMES[str(self.folder)]

    def path(self, name: str) -> Path:
        """Return where a file of that name is, or would be."""
        return cache_folder() / self.folder / name  # what is a full path already stays as it is

    def mark_used(self, path: Path) -> None:
        """Note that a file was used now; one that is gone, or in a read-only folder, is passed over."""
        with contextlib.suppress(OSError):
            # The other time stays that of the content: it shows whether that was changed.
            os.utime(path, ns=(time.time_ns(), path.stat().st_mtime_ns))

    def drop(self, path: Path) -> None:
        """Remove a file, such as a damaged one, where that is possible."""
        with contextlib.suppress(OSError):
            if not path.parent.is_symlink():
                path.unlink(missing_ok=True)

    @property
    def is_given_up(self) -> bool:
        """Whether this process could not write into the folder."""
        return self.path("") in _unwritable

    def write(self, name: str, size_bytes: int, fill: Callable[[IO[bytes]], object]) -> bool:
        """Write a file of about that size, making room first; return whether it is there now.

        A folder that could not be written once is not tried again by this process, for filling may be slow.
        What the process itself has too few of for a moment, such as file handles, does not end its use.
        """
        path = self.path(name)
        if path.parent in _unwritable:
            return False
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.parent.is_symlink():  # nothing could be removed there again
                raise OSError(errno.ELOOP, "it is a symbolic link")
            if _CHANCE.random() * self.limit_bytes < size_bytes * _LOOKED_THROUGH_AFTER:
                self._make_room(path.parent, size_bytes)
            store.write_file(path, fill, durable=self.durable)
        except OSError as error:
            if store.resource_shortage(error) is not None:
                return False
            _unwritable.add(path.parent)
            if self.warning:
                problem = f"{str(path.parent)!r} cannot be written: {error.strerror or error}"
                advice = f"make room there, or let {CACHE_VARIABLE} name another folder"
                message = ToolkitError(self.warning.format(problem=problem), next=advice).message
                warnings.warn(message, RuntimeWarning, stacklevel=2)
            return False
        return True

    def _make_room(self, folder: Path, needed_bytes: int) -> None:
        """Remove what was used longest ago where the limit is passed.

        Open maps stay valid, and what is being written, by whom it may be, is written again.
        """
        files = _files(folder, self.names)
        excess = sum(size for _, size, _ in files) + needed_bytes - self.limit_bytes
        if excess > 0:
            excess += max(0, self.limit_bytes // _ROOM_MADE - needed_bytes)
        for _, size, path in files:
            if excess > 0:
                self.drop(path)
                excess -= size


def _files(folder: Path, names: str) -> list[tuple[float, int, Path]]:
    """Return the files of a cache by their last use: seconds since the epoch, bytes, path."""
    files, paths, ours = [], list[Path](), re.compile(f"(?:{store.DRAFT})?(?:{names})")
    with contextlib.suppress(OSError):
        paths += [] if folder.is_symlink() else folder.iterdir()
    for path in paths:
        with contextlib.suppress(OSError):  # other processes may remove some meanwhile
            found = path.lstat()
            if ours.fullmatch(path.name) and stat.S_ISREG(found.st_mode):
                # File systems are mounted without access times: mark_used sets them, and a file never used
                # again has that of its writing.
                files.append((max(found.st_atime, found.st_mtime), found.st_size, path))
    return sorted(files)


def cached_files() -> dict[str, list[tuple[float, int, Path]]]:
    """Return the files of each folder in the cache folder: seconds of their last use, bytes, path."""
    folders = {name: cache_folder() / name for name in _NAMES}
    return {name: _files(folder, _NAMES[name]) for name, folder in folders.items() if folder.is_dir()}


def prune_cache(unused_days: float = 0.0) -> list[Path]:
    """Remove cached files that were not used for so many days, and return them.

    All of them can be made again. Open maps stay valid, and what is being written is written again.
    """
    removed, latest_s = [], time.time() - unused_days * 86_400
    for used_s, _, path in (file for files in cached_files().values() for file in files):
        if used_s <= latest_s:
            with contextlib.suppress(OSError):
                path.unlink()
                removed.append(path)
    return removed


K = TypeVar("K", bound=Hashable)
V = TypeVar("V")

# Held while a memory cache changes.
_LOCK = RLock()

if hasattr(os, "register_at_fork"):  # not on Windows, which cannot fork
    # What another thread held at the fork would never be let go of in the child.
    os.register_at_fork(before=_LOCK.acquire, after_in_parent=_LOCK.release, after_in_child=_LOCK.release)


class MemoryCache(Generic[K, V]):
    """Values by key, bounded by the sum of their sizes; without ``size_of`` each counts 1.

    The value kept last stays even where it alone is larger than the limit; a limit of 0 keeps none. Safe to
    share between threads. A process that received it pickled starts with an empty cache.
    """

    def __init__(self, limit: int, size_of: Callable[[V], int] | None = None) -> None:
        self.limit = limit
        self.size = 0
        self._size_of = size_of
        self._kept: OrderedDict[K, tuple[V, int]] = OrderedDict()

    def __len__(self) -> int:
        return len(self._kept)

    def get(self, key: K) -> V | None:
        """Return what is kept under a key, or None."""
        # Without the lock, which takes a third of the time of a mesh: each of the two calls is one step for
        # other threads, and between them the value may leave.
        try:
            self._kept.move_to_end(key)
            return self._kept[key][0]
        except KeyError:
            return None

    def put(self, key: K, value: V) -> V:
        """Keep a value, and let go of those used longest ago while there are too many; returns it."""
        with _LOCK:
            size = 1 if self._size_of is None else self._size_of(value)
            self.size += size - self._kept.pop(key, (None, 0))[1]
            self._kept[key] = value, size
            while self.size > self.limit and len(self._kept) > min(self.limit, 1):
                self.size -= self._kept.popitem(last=False)[1][1]
        return value

    def get_or_make(self, key: K, make: Callable[[], V]) -> V:
        """Return what is kept under a key, or make it and keep it; of values made at once the first stays."""
        found = self.get(key)
        if found is not None:
            return found
        made = make()  # outside the lock: threads wait for nothing but their own
        with _LOCK:
            found = self.get(key)
            return self.put(key, made) if found is None else found

    def clear(self) -> None:
        """Let go of all values."""
        with _LOCK:
            self._kept.clear()
            self.size = 0

    def __reduce__(self) -> tuple[Any, ...]:
        return (type(self), (self.limit, self._size_of))
