"""The one seam through which data set folders are read and written.

Local folders and every fsspec address (``s3://...``, ``memory://...``) go through :class:`DataFolder`. Its
protocol has two implementations (:mod:`tactile_toolkit.store.local`, :mod:`tactile_toolkit.store.remote`):
``entries, read, put`` (whole), ``create`` (if absent), ``move, remove, lock``. A file appears under its name
complete or not at all.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import IO, Any

from tactile_toolkit.errors import IntegrityError, StorageError
from tactile_toolkit.store.address import is_remote, place_of_data
from tactile_toolkit.store.files import expanded, named_failures, readable, scratch_folder
from tactile_toolkit.store.local import PENDING_FOLDER, TEMPORARY, LocalFiles
from tactile_toolkit.store.remote import StoreFiles

__all__ = ["DataFolder", "file_at"]

_READ_AT_ONCE = 16
"""Small files that are asked for at a time: a network file system or store answers many as fast as one."""
_READ_AHEAD = 512


@dataclass(frozen=True)
class DataFolder:
    """A data set folder, by its path or any fsspec address.

    Pickles as its address alone, so that tasks carry it to other processes and machines.
    """

    url: str
    _root: str = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        place = place_of_data(self.url)
        root = place if is_remote(place) else str(expanded(place).absolute())
        object.__setattr__(self, "_root", root)

    @property
    def is_local(self) -> bool:
        """Whether the folder is on a local file system."""
        return not is_remote(self._root)

    @cached_property
    def _store(self) -> StoreFiles:
        return StoreFiles(self._root)

    @cached_property
    def _files(self) -> LocalFiles | StoreFiles:
        return LocalFiles(self._root) if self.is_local else self._store

    def __getstate__(self) -> dict[str, str]:
        """Leave open connections behind."""
        return {"url": self.url, "_root": self._root}

    def __setstate__(self, state: dict[str, str]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, value)

    def address(self, path: str = "") -> str:
        """Return the full address of a file of the folder, for messages and readers.

        Everything that is done with a file starts here. Raises StorageError for a path that leads out of the
        folder: names from outside are refused where they are read (:mod:`tactile_toolkit.store.names`), and
        nothing is done even with one that was forgotten there.
        """
        if not path:
            return self._root
        # Most paths have no such dots: their parts are not looked at, which takes a while for 50,000 of them.
        if path.startswith("/") or "\0" in path or (".." in path and ".." in PurePosixPath(path).parts):
            message = (
                f"{path!r} leads out of {self._root!r} or is not a path; expected a path inside; nothing was "
                "done"
            )
            raise StorageError(message)
        return f"{self._root}/{path}"

    def _inside(self, path: str) -> str:
        """Return a path that was looked at by :meth:`address`."""
        self.address(path)
        return path

    def place(self, path: str) -> Path:
        """Return where a local file is written; InputError where it is, or lies behind, a link."""
        return LocalFiles(self._root).place(self._inside(path))

    def exists(self, path: str = "") -> bool:
        """Return whether a file (or, without an argument, the folder) is there."""
        return self._files.exists(self._inside(path))

    def lacks(self, what: str) -> str:
        """Say what is wrong with a folder in which something was not found: it, or what was looked for."""
        address = self.address()
        if self.is_local and not Path(address).exists():
            return f"{address!r} does not exist"
        if self.is_local and not Path(address).is_dir():
            return f"{address!r} is a file, a folder was expected"
        if not self.is_local and not self._store.has_bucket():
            return f"the bucket of {address!r} does not exist"
        return f"no {what} in {address!r}"

    def names(self, folder: str = "") -> list[str]:
        """List the names directly in a sub-folder, sorted; an absent sub-folder is empty."""
        return list(self._files.entries(self._inside(folder)))

    def sizes(self, folder: str = "") -> dict[str, int]:
        """List the files directly in a sub-folder with their sizes in bytes, sorted by name, in one look."""
        entries = self._files.entries(self._inside(folder))
        return {name: size for name, size in entries.items() if size is not None}

    def walk(self, folder: str = "") -> Iterator[str]:
        """Yield the paths of all files in a sub-folder and below it, in order of their names."""
        for name, size in self._files.entries(self._inside(folder)).items():
            path = f"{folder}/{name}" if folder else name
            if size is None and not (self.is_local and Path(self.address(path)).is_symlink()):
                yield from self.walk(path)
            else:
                yield path

    def size_bytes(self, path: str) -> int:
        """Return the size of a file."""
        if self.is_local:
            with readable(self.address(path)):
                return Path(self.address(path)).stat().st_size
        return int(self.facts(path)["size"])

    def open(self, path: str) -> IO[bytes]:
        """Open a file for reading; IntegrityError for what is not a file, such as a pipe or a device."""
        return self._files.open(self._inside(path))

    def facts(self, path: str) -> Mapping[str, Any]:
        """Return what a remote store says of a file; raises FileNotFoundError."""
        found = self._store.info(self._inside(path))
        if found is None:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), self.address(path))
        return found

    def version(self, path: str) -> tuple[object, ...] | None:
        """Return what changes whenever a file is replaced; None where there is none."""
        return self._files.version(self._inside(path))

    def read_bytes(self, path: str) -> bytes:
        """Read a whole (small) file; IntegrityError when it is not there or cannot be read."""
        try:
            return self._files.read(self._inside(path))
        except OSError as error:
            message = f"cannot read {self.address(path)!r}: {error.strerror or error}"
            raise IntegrityError(message) from error

    def read_many(self, paths: Sequence[str]) -> Iterator[bytes | None]:
        """Read many small files, in their order; None for one that cannot be read."""

        def read(path: str) -> bytes | None:
            with contextlib.suppress(IntegrityError):
                return self.read_bytes(path)
            return None

        with ThreadPoolExecutor(_READ_AT_ONCE) as threads:
            for start in range(0, len(paths), _READ_AHEAD):
                yield from threads.map(read, paths[start : start + _READ_AHEAD])

    def create_bytes(self, path: str, content: bytes) -> bool:
        """Write a whole file unless there is one of that name; return whether this call did.

        Of several writers at once, on any machines, one wins. Raises as :meth:`write_bytes`.
        """
        return self._files.create(self._inside(path), content)

    def write_bytes(self, path: str, content: bytes) -> None:
        """Write a whole file so that readers see all of it or nothing.

        Raises StorageError for a path that leads out of the folder, and where the file system refuses; then
        nothing is left behind under any name.
        """
        self._files.put(self._inside(path), content)

    @contextlib.contextmanager
    def writing(self, path: str) -> Iterator[IO[bytes]]:
        """Open a file to be written in pieces, which appears whole when all is written, or never.

        What goes to a store is put together in ``$TMPDIR`` first. Raises as :meth:`write_bytes`.
        """
        if self.is_local:
            with LocalFiles(self._root).writing(self._inside(path)) as stream:
                yield stream
            return
        with scratch_folder() as scratch:
            file = scratch / "file"
            with named_failures(str(file)), file.open("wb") as stream:
                yield stream
            self.copy_in(path, file)

    def copy_in(self, path: str, source: Path) -> None:
        """Write a whole file of another place of this machine, as :meth:`write_bytes` does, in pieces."""
        self._files.put(self._inside(path), source)

    def copy_out(self, path: str, target: Path) -> None:
        """Copy a file to a local one; FileNotFoundError where there is none."""
        target.parent.mkdir(parents=True, exist_ok=True)
        self._files.download(self._inside(path), target)

    def move(self, path: str, target: str) -> None:
        """Move a file of a local folder inside it, in place of any other."""
        self._files.move(self._inside(path), self._inside(target))

    def remove(self, path: str) -> None:
        """Remove a file, if it is there."""
        self._files.remove(self._inside(path))

    def remove_empty(self, folder: str) -> None:
        """Remove a sub-folder when nothing is left in it; in object stores it has gone with its last file."""
        self._files.remove_empty(self._inside(folder))

    def remove_tree(self, folder: str) -> None:
        """Remove a sub-folder, if it is there, with all that it holds; raises InputError for a link."""
        for name, size in self._files.entries(self._inside(folder)).items():
            if size is None:
                self.remove_tree(f"{folder}/{name}")
            else:
                self.remove(f"{folder}/{name}")
        self.remove_empty(folder)

    def remove_temporaries(self) -> None:
        """Remove what writers left half-written; one that is still at work writes again."""
        for name in self.names(PENDING_FOLDER):
            if name.startswith(TEMPORARY):
                self.remove(f"{PENDING_FOLDER}/{name}")
        self.remove_empty(PENDING_FOLDER)

    def require_folder(self) -> None:
        """Create the folder, and prove that it can be written to; a bucket must be there.

        Raises StorageError where it cannot, RemoteError where a store refuses or does not answer, and
        InputError when a file stands in its place or there is no such bucket.
        """
        self._files.make()

    def refresh(self, folder: str) -> None:
        """Have a network file system forget what it knows of a sub-folder."""
        self._files.refresh(self._inside(folder))

    def locked(
        self, *, shared: bool = False, patience_s: float = math.inf
    ) -> contextlib.AbstractContextManager[None]:
        """Hold a local folder against other runs; stores have no locks.

        What a run changes there it changes under the lock, its shards under a ``shared`` one. Raises
        InputError when other runs have held it for so long.
        """
        return self._files.lock(shared=shared, patience_s=patience_s)


def file_at(place: str) -> tuple[DataFolder, str]:
    """Return the folder of a file, local or at an address, and its name there."""
    if is_remote(place):
        parent, _, name = place_of_data(place).rpartition("/")
        return DataFolder(parent), name
    path = Path(place_of_data(place))
    return DataFolder(str(path.parent)), path.name
