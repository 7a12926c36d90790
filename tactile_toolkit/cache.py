"""Bounded caches: files on disk and objects in memory, all of which can be made again.

Least recently used entries are evicted first. A folder may exceed its limit for a while, by about a tenth. A
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
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from threading import RLock
from typing import IO, Generic, TypeVar

from tactile_toolkit import errors, store
from tactile_toolkit.store.files import DRAFT, write_file

LOCKS = "locks"
"""Folder of the cache with files that processes lock while they write others."""

# Patterns of the files in each folder that may be removed; the folders of locks and links hold no data.
_NAMES = {
    "blocks": "[0-9a-f]{32}-[0-9]{5}-[0-9]{5}[.]arrow",
    "environments": "(?:meshes|base-depth)-[0-9a-f]{32}",
}
CACHE_VARIABLE = "TACTILE_TOOLKIT_CACHE"
"""Environment variable that names the cache folder."""

# A folder is scanned at random: on average once while 1/32 of its limit is written, by any process. So
# processes need not know of one another, nor scan all files for each that they write.
_SCANS_PER_LIMIT = 32

# Other generators repeat numbers in forked processes, or disturb a user who has seeded them.
_CHANCE = random.SystemRandom()

# Eviction frees at least 1/16 of the limit, so that not every scan evicts files.
_ROOM_MADE = 16
UNPACKED_VARIABLE = "TACTILE_TOOLKIT_UNPACKED_MIB"
"""Environment variable that raises the limit, in MiB."""
CACHE_LIMIT_VARIABLE = "TACTILE_TOOLKIT_CACHE_MIB"
"""Environment variable that limits the size of unpacked row groups in the cache, in MiB."""
_UNPACKED_MIB = 512  # ten times the largest row of the published data sets, eleven times all MNIST
_CACHE_MIB = 32 << 10

# While they are read, meshes and tables take 5 to 30 times the size of their files in memory.
_USUAL_EXPANSION = 32

_unwritable: set[Path] = set()  # folders that this process no longer tries
K = TypeVar("K", bound=Hashable)
V = TypeVar("V")

# Held while a memory cache changes.
_LOCK = RLock()
if hasattr(os, "register_at_fork"):  # not on Windows, which cannot fork
    # In the child, a lock that another thread held at the fork would never be released.
    os.register_at_fork(before=_LOCK.acquire, after_in_parent=_LOCK.release, after_in_child=_LOCK.release)


def cache_folder() -> Path:
    """Return ``$TACTILE_TOOLKIT_CACHE``, or ``tactile-toolkit`` in the user's cache folder."""
    named = os.environ.get(CACHE_VARIABLE)
    if named:
        return store.expanded(named, CACHE_VARIABLE)
    of_system = os.environ.get("XDG_CACHE_HOME")
    if of_system:
        return store.expanded(of_system, "XDG_CACHE_HOME") / "tactile-toolkit"
    try:
        return store.expanded("~/.cache") / "tactile-toolkit"
    except errors.InputError:  # a user without a home, as in some containers
        return _temporary_cache()


@cache
def _temporary_cache() -> Path:
    """Return a private cache folder in the system's temporary folder, and warn once."""
    # Windows has no numeric user ids; its temporary folder belongs to one user.
    user = getattr(os, "getuid", lambda: 0)()
    path = Path(tempfile.gettempdir()) / f"tactile-toolkit-{user}"
    path.mkdir(mode=0o700, exist_ok=True)
    status = path.lstat()
    # Files of another user would be read as data, and a link may point anywhere.
    is_open_to_others = os.name != "nt" and bool(status.st_mode & 0o077)
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != user or is_open_to_others:
        path = Path(tempfile.mkdtemp(prefix="tactile-toolkit-"))
    warnings.warn(
        f"no home folder is known: the cache is {str(path)!r}; next: set {CACHE_VARIABLE} to another folder",
        RuntimeWarning,
        stacklevel=2,
    )
    return path


@contextlib.contextmanager
def held(name: str, patience_s: float | None = None) -> Iterator[Exception | None]:
    """Let one process at a time do some work whose result the others find in the cache.

    ``name`` is that of a file in the folder of locks. Yields None, or why the lock is not held: then several
    processes may do the same work. That is a BusyError after ``patience_s``; by default, it waits as long as
    the holder is at work.
    """
    reason = None
    with contextlib.ExitStack() as stack:
        try:
            path = cache_folder() / LOCKS / name
            path.parent.mkdir(parents=True, exist_ok=True)
            is_patient = patience_s is None
            stack.enter_context(store.locked(path, patience_s=patience_s, is_patient=is_patient))
        except (OSError, errors.ToolkitError) as error:
            reason = error
        yield reason


@dataclass
class DiskCache:
    """Files in one folder, shared by threads and processes; each appears whole or not at all.

    ``folder`` is a path, or a name inside the cache folder, which may change while a process runs. ``names``
    is a pattern of the names of its files, known for folders of the cache. With ``durable``, a file is
    flushed before it gets its name; otherwise readers must detect what a power cut has damaged. ``warning``,
    which contains ``{problem}``, is given once if nothing can be written.
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
        return cache_folder() / self.folder / name  # an absolute ``folder`` stays

    def mark_used(self, path: Path) -> None:
        """Record that a file was used now; ignored for a removed file or a read-only folder."""
        with contextlib.suppress(OSError):
            # The modification time stays: it shows whether the content was changed.
            os.utime(path, ns=(time.time_ns(), path.stat().st_mtime_ns))

    def drop(self, path: Path) -> None:
        """Remove a file, if possible."""
        with contextlib.suppress(OSError):
            if not path.parent.is_symlink():
                path.unlink(missing_ok=True)

    def drop_unreadable(self, path: Path, error: Exception) -> None:
        """Remove a file that could not be read, unless this process only lacked memory or file handles."""
        if errors.resource_shortage(error) is None:
            self.drop(path)

    @property
    def is_given_up(self) -> bool:
        """Whether this process failed to write into the folder."""
        return self.path("") in _unwritable

    def write(self, name: str, size_bytes: int, fill: Callable[[IO[bytes]], object]) -> bool:
        """Write a file of about that size after making room for it; return whether it was written.

        After a failure this process does not try the folder again, because ``fill`` may be slow. A temporary
        shortage of this process, such as of file handles, does not count.
        """
        path = self.path(name)
        if path.parent in _unwritable:
            return False
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.parent.is_symlink():  # nothing could be removed there
                raise OSError(errno.ELOOP, "it is a symbolic link")
            if _CHANCE.random() * self.limit_bytes < size_bytes * _SCANS_PER_LIMIT:
                self._make_room(path.parent, size_bytes)
            write_file(path, fill, durable=self.durable)
        except OSError as error:
            if errors.resource_shortage(error) is not None:
                return False
            _unwritable.add(path.parent)
            if self.warning:
                problem = f"{str(path.parent)!r} cannot be written: {error.strerror or error}"
                advice = f"make room there, or set {CACHE_VARIABLE} to another folder"
                message = errors.ToolkitError(self.warning.format(problem=problem), next=advice).message
                warnings.warn(message, RuntimeWarning, stacklevel=2)
            return False
        return True

    def _make_room(self, folder: Path, needed_bytes: int) -> None:
        """Evict the least recently used files if the limit is exceeded.

        Open memory maps stay valid, and unfinished files are written again.
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
    """Return the files of a cache, least recently used first: seconds since the epoch, bytes, path."""
    files = []
    paths = list[Path]()
    ours = re.compile(f"(?:{DRAFT})?(?:{names})")
    with contextlib.suppress(OSError):
        paths += [] if folder.is_symlink() else folder.iterdir()
    for path in paths:
        with contextlib.suppress(OSError):  # other processes may remove some meanwhile
            status = path.lstat()
            if ours.fullmatch(path.name) and stat.S_ISREG(status.st_mode):
                # mark_used sets the access time, because file systems may not; a file that was never used
                # again has that of its writing.
                files.append((max(status.st_atime, status.st_mtime), status.st_size, path))
    return sorted(files)


@dataclass(frozen=True, slots=True)
class CacheContents:
    """The files of the cache folder: for each folder in it, the time of last use in seconds, bytes, path."""

    folder: Path
    files: dict[str, list[tuple[float, int, Path]]]

    @classmethod
    def now(cls) -> CacheContents:
        """Return the files that the cache holds at this moment."""
        folder = cache_folder()
        folders = {name: folder / name for name in _NAMES}
        return cls(folder, {name: _files(at, _NAMES[name]) for name, at in folders.items() if at.is_dir()})

    def prune(self, unused_days: float = 0.0) -> list[Path]:
        """Remove the files that have not been used for ``unused_days``, and return their paths.

        All of them can be made again. Open memory maps stay valid, and unfinished files are written again.
        """
        removed = []
        latest_s = time.time() - unused_days * 86_400
        for used_s, _, path in (file for files in self.files.values() for file in files):
            if used_s <= latest_s:
                with contextlib.suppress(OSError):
                    path.unlink()
                    removed.append(path)
        return removed


class MemoryCache(Generic[K, V]):
    """Values by key, bounded by the sum of their sizes; without ``size_of`` each counts 1.

    The most recent value stays even if it alone exceeds the limit; a limit of 0 keeps none. Threads may share
    it. It is pickled without its values.
    """

    def __init__(self, limit: int, size_of: Callable[[V], int] | None = None) -> None:
        self.limit = limit
        self.size = 0
        self._size_of = size_of
        self._kept: OrderedDict[K, tuple[V, int]] = OrderedDict()

    def __len__(self) -> int:
        return len(self._kept)

    def get(self, key: K) -> V | None:
        """Return the value of a key, or None."""
        # Without the lock, which takes a third of the time of a mesh: both calls are atomic, and the value
        # may be evicted between them.
        try:
            self._kept.move_to_end(key)
            return self._kept[key][0]
        except KeyError:
            return None

    def put(self, key: K, value: V) -> V:
        """Keep a value, evict the least recently used ones above the limit, and return the value."""
        with _LOCK:
            size = 1 if self._size_of is None else self._size_of(value)
            self.size += size - self._kept.pop(key, (None, 0))[1]
            self._kept[key] = value, size
            while self.size > self.limit and len(self._kept) > min(self.limit, 1):
                self.size -= self._kept.popitem(last=False)[1][1]
        return value

    def get_or_make(self, key: K, make: Callable[[], V]) -> V:
        """Return the value of a key, or make and keep it; if two threads make it, the first one wins."""
        value = self.get(key)
        if value is not None:
            return value
        made = make()  # outside the lock, so that no other thread waits
        with _LOCK:
            value = self.get(key)
            if value is None:
                return self.put(key, made)
            return value

    def clear(self) -> None:
        """Remove all values."""
        with _LOCK:
            self._kept.clear()
            self.size = 0

    def __reduce__(self) -> tuple[object, ...]:
        return (type(self), (self.limit, self._size_of))


def cache_limit_bytes() -> int:
    """Return the limit of the cache of row groups; InputError unless the variable holds an integer."""
    return _limit_bytes(CACHE_LIMIT_VARIABLE, _CACHE_MIB)


def _limit_bytes(variable: str, default_mib: int) -> int:
    named = os.environ.get(variable) or str(default_mib)
    # Eleven digits of MiB are less than 2^63 bytes, the limit of Arrow and file systems.
    if not (named.isascii() and named.isdigit() and len(named) < 12):
        raise errors.InputError(
            f"{variable} is {named[:40]!r}; expected an integer of MiB, such as {default_mib}"
        )
    return int(named) << 20


def require_unpackable(size_bytes: int, what: str, file_bytes: int = 0) -> None:
    """Raise InputError, which begins with ``what``, if something would unpack to more than the limit.

    ``file_bytes`` is the size of the file, if known: a large file may unpack to 32 times its size.
    """
    limit = max(_limit_bytes(UNPACKED_VARIABLE, _UNPACKED_MIB), _USUAL_EXPANSION * file_bytes)
    if size_bytes > limit:
        needed_mib = -(-size_bytes // (1 << 20))
        raise errors.InputError(
            f"{what} unpacks to {size_bytes:,} bytes; expected at most {limit:,}; nothing was unpacked",
            next=f"if it is meant to be that large, set {UNPACKED_VARIABLE}={needed_mib}",
        )


def require_plain_archive(archive: zipfile.ZipFile) -> None:
    """Raise ValueError unless all files are stored or deflated; others unpack to any size at once."""
    for entry in archive.infolist():
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError(
                f"{entry.filename[:80]!r} is packed by method {entry.compress_type}; expected Deflate"
            )
