"""The interface of data set folders, on a local file system or in an object store."""

from __future__ import annotations

import contextlib
import errno
import os
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import IO, ClassVar, Protocol, TypeVar

from tactile_toolkit import run
from tactile_toolkit.errors import IntegrityError, StorageError
from tactile_toolkit.json_types import JsonObject
from tactile_toolkit.store.names import leads_elsewhere

PENDING_FOLDER = ".pending"
"""Holds the records and report rows of finished shards until the manifest has them."""

NEXT_FOLDER = ".next"
"""Holds the data set that will replace the one in the folder."""

TEMPORARY = "tmp-[0-9a-f]{32}(?s:/.*)?"
"""Names of unfinished files in :data:`PENDING_FOLDER`, and of sub-folders of them, as a pattern."""

VERSION_KEYS = ("size", "ETag", "etag", "blob_id", "mtime", "created", "LastModified", "inode")
"""Names of the facts about a file that change whenever it is replaced."""

# Small files that are read at a time: a network file system or store answers many requests as fast as one.
_READ_AT_ONCE = 16

T = TypeVar("T")


class DataFolder(Protocol):
    """A data set folder: local (:class:`~tactile_toolkit.store.LocalFolder`) or in a store of objects.

    :func:`tactile_toolkit.store.open_folder` returns the one for an address. Paths are relative to the
    folder, with slashes; nothing is written or removed through symbolic links in it. A file appears under its
    name complete or not at all. Pickles as its address only, so tasks carry it to other processes and
    machines. Methods raise StorageError where a file system refuses, RemoteError where a store refuses or
    does not answer, and InputError if the package of a store is not installed.
    """

    root: str
    """Absolute path of the folder, or its address."""

    is_local: ClassVar[bool]
    """Whether the folder is on a local file system."""

    def address(self, path: str = "") -> str:
        """Return the full address of a file of the folder, for messages and readers.

        Every operation on a file starts here. Raises StorageError for a path that leads out of the folder:
        names from outside are refused where they are read (:mod:`tactile_toolkit.store.names`), and the check
        here is the last one.
        """
        if not path:
            return self.root
        if leads_elsewhere(path):
            raise StorageError(f"{path!r} leads out of {self.root!r} or is not a path; nothing was done")
        return f"{self.root}/{path}"

    @abstractmethod
    def problem(self) -> str:
        """Return why the folder cannot hold files, or ``""`` if it can."""

    def missing_message(self, what: str) -> str:
        """Return the message for a missing file: the problem of the folder, or else ``no what in folder``."""
        return self.problem() or f"no {what} in {self.root!r}"

    @abstractmethod
    def info(self, path: str) -> JsonObject | None:
        """Return type and size of a file or folder, and values that change with it; None if there is none."""

    def exists(self, path: str = "") -> bool:
        """Return whether a file (or, without an argument, the folder) exists."""
        return self.info(path) is not None

    def version(self, path: str) -> tuple[object, ...] | None:
        """Return a value that changes whenever a file is replaced; None if there is no file."""
        found = self.info(path)
        if found is None:
            return None
        return tuple(str(found.get(key)) for key in VERSION_KEYS)

    def size_bytes(self, path: str) -> int:
        """Return the size of a file; raises FileNotFoundError."""
        found = self.info(path)
        if found is None:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), self.address(path))
        return int(found["size"])

    @abstractmethod
    def entries(self, folder: str = "") -> dict[str, int | None]:
        """List names directly in a sub-folder, sorted, with sizes in bytes, None for anything but a file.

        An absent sub-folder is empty.
        """

    def names(self, folder: str = "") -> list[str]:
        """List the names directly in a sub-folder, sorted."""
        return list(self.entries(folder))

    def sizes(self, folder: str = "") -> dict[str, int]:
        """List the files directly in a sub-folder with their sizes in bytes, sorted by name."""
        return {name: size for name, size in self.entries(folder).items() if size is not None}

    @abstractmethod
    def walk(self, folder: str = "") -> Iterator[str]:
        """Yield the paths of all files in a sub-folder and below it, in order of their names."""

    @abstractmethod
    def open(self, path: str) -> IO[bytes]:
        """Open a file for reading; IntegrityError for anything else, such as a pipe or a device."""

    @abstractmethod
    def read_bytes(self, path: str) -> bytes:
        """Read a whole (small) file; IntegrityError when it is missing or cannot be read."""

    def read_many(self, paths: Sequence[str]) -> Iterator[bytes | None]:
        """Read many small files, in their order; None for one that cannot be read."""

        def read(path: str) -> bytes | None:
            with contextlib.suppress(IntegrityError):
                return self.read_bytes(path)
            return None

        return run.in_threads(read, paths, _READ_AT_ONCE)

    @abstractmethod
    def write(self, path: str, fill: Callable[[IO[bytes]], T]) -> T:
        """Write a file in pieces, which appears when all is written, or never; return what ``fill`` returns.

        ``fill`` writes to a stream, and may be called again. Raises StorageError for a path that leads out of
        the folder, and where the file system refuses; then no partial file remains.
        """

    @abstractmethod
    def write_bytes(self, path: str, content: bytes) -> None:
        """Write a file in one step, so that readers see all of it or nothing; raises as :meth:`write`."""

    @abstractmethod
    def create_bytes(self, path: str, content: bytes) -> None:
        """Write a file in one step unless there is one of that name; raises as :meth:`write`.

        If several writers create it at once, on any machines, one wins; in a store, this requires conditional
        writes, as S3 and gs have them.
        """

    @abstractmethod
    def upload(self, path: str, source: Path) -> None:
        """Write a copy of a file of this machine in pieces; raises as :meth:`write`."""

    @abstractmethod
    def download(self, path: str, target: Path) -> None:
        """Copy a file to a local one; FileNotFoundError where there is none."""

    @abstractmethod
    def remove(self, path: str) -> None:
        """Remove a file, if it exists."""

    @abstractmethod
    def remove_empty(self, folder: str) -> None:
        """Remove a sub-folder if it is empty; in a store, it vanished with its last file."""

    @abstractmethod
    def remove_temporaries(self) -> None:
        """Remove unfinished files of writers; a writer that is still at work writes again."""

    @abstractmethod
    def require_folder(self) -> None:
        """Create the folder, and prove that it can be written to; a bucket must exist.

        Raises InputError if there is a file of that name, or if the bucket does not exist.
        """

    @abstractmethod
    def refresh(self, folder: str) -> None:
        """Make a network file system drop what it cached of a sub-folder; stores cache nothing."""

    @abstractmethod
    def locked(
        self, *, shared: bool = False, patience_s: float | None = None, is_patient: bool = False
    ) -> AbstractContextManager[None]:
        """Lock the folder against other runs, where this is possible; stores have no locks.

        A run changes files of the folder under the lock, its shards under a ``shared`` one. Raises BusyError
        as :func:`tactile_toolkit.store.locked` does, which explains the arguments.
        """
