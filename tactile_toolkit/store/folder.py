"""The only way in which data set folders are read and written.

Local folders and every fsspec address (``s3://...``, ``memory://...``) are a :class:`DataFolder`: it lists,
reads, writes files in one step or creates them if absent, moves, removes, and locks. Its methods are those
of a local folder; a private class does the same in stores. A file appears under its name complete or not at
all.

What is written locally lies in ``.pending/tmp-...`` until it is complete. Who finishes a data set removes all
such files, of any process; a writer whose file has gone writes it again.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
import stat
import tempfile
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import IO, Any, ClassVar, TypeVar

from tactile_toolkit import run
from tactile_toolkit.errors import InputError, IntegrityError, StorageError
from tactile_toolkit.store.files import (
    expanded,
    make_folder,
    named_failures,
    open_regular,
    readable,
    scratch_folder,
    sync_folder,
    write_file,
)
from tactile_toolkit.store.locks import locked
from tactile_toolkit.store.names import is_remote, normalize_uri, scheme_of
from tactile_toolkit.store.remote import ask_store, client_of, has_buckets, open_in_store
from tactile_toolkit.system import working_folder

PENDING_FOLDER = ".pending"
"""Holds the records and report rows of finished shards until the manifest has them."""

NEXT_FOLDER = ".next"
"""Holds the data set that is to take the place of the one around it."""

TEMPORARY = "tmp-[0-9a-f]{32}"
"""Names of unfinished files in :data:`PENDING_FOLDER`, as a pattern."""

VERSION_KEYS = ("size", "ETag", "etag", "blob_id", "mtime", "created", "LastModified", "inode")
"""What is known of a file, under which name each, that changes whenever it is replaced."""

# Small files that are asked for at a time: a network file system or store answers many as fast as one.
_READ_AT_ONCE = 16

T = TypeVar("T")


@dataclass(frozen=True)
class DataFolder:
    """A data set folder, by its path or any fsspec address.

    Paths are relative to it, with slashes; nothing is written, moved or removed through symbolic links in it.
    Pickles as its address alone, so that tasks carry it to other processes and machines. Methods raise
    StorageError where a file system refuses, RemoteError where a store refuses or does not answer, and
    InputError where the package of a store is not installed.
    """

    url: str
    root: str = field(init=False, repr=False, compare=False)
    is_local: ClassVar[bool] = True
    """Whether the folder is on a local file system."""

    def __new__(cls, url: str) -> DataFolder:
        """Return a folder of the kind that the address is of."""
        return super().__new__(_StoreFolder if is_remote(url) else DataFolder)

    def __post_init__(self) -> None:
        place = normalize_uri(self.url)
        # Joined to what is absolute, the working folder does not count, and need not be there.
        if self.is_local and not (path := expanded(place)).is_absolute():
            path = working_folder() / path
        object.__setattr__(self, "root", str(path) if self.is_local else place)

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the address alone, without open connections."""
        return DataFolder, (self.root,)

    def address(self, path: str = "") -> str:
        """Return the full address of a file of the folder, for messages and readers.

        Everything that is done with a file starts here. Raises StorageError for a path that leads out of the
        folder: names from outside are refused where they are read (:mod:`tactile_toolkit.store.names`), and
        the check here is the last one.
        """
        if not path:
            return self.root
        # Most paths have no such dots: their parts are not looked at, which takes a while for 50,000 of them.
        if path.startswith("/") or "\0" in path or (".." in path and ".." in PurePosixPath(path).parts):
            raise StorageError(f"{path!r} leads out of {self.root!r} or is not a path; nothing was done")
        return f"{self.root}/{path}"

    def place(self, path: str) -> Path:
        """Return where a file is written, moved or removed.

        Raises InputError where the file, or a folder on the way to it, is a symbolic link: what that leads to
        does not belong to this folder, which may be reached through a link itself.
        """
        place, root = Path(self.address(path)), Path(self.root)
        for step in (place, *place.parents):
            if step == root:
                break
            if step.is_symlink():
                raise InputError(
                    f"{str(step)!r} is a symbolic link; nothing is written, moved or removed through a link",
                    next="put what it leads to in its place, or choose another folder (--out or OUT)",
                )
        return place

    def missing_message(self, what: str) -> str:
        """State what is wrong with a folder in which something was not found: it, or what was looked for."""
        return self._problem() or f"no {what} in {self.root!r}"

    def _problem(self) -> str:
        """Return why nothing can be in the folder; empty where something can."""
        found = self.info("")
        if found is None:
            return f"{self.root!r} does not exist"
        return "" if found["type"] == "directory" else f"{self.root!r} is a file, a folder was expected"

    def info(self, path: str) -> Mapping[str, Any] | None:
        """Return type and size of a file or folder, and what changes with it; None where there is none."""
        with readable(self.address(path)):
            try:
                found = Path(self.address(path)).stat()
            except (OSError, ValueError) as error:  # a circle of links, or a null byte: no file
                if getattr(error, "errno", None) in (errno.EACCES, errno.EPERM, errno.ENAMETOOLONG):
                    raise
                return None
        kind = "directory" if stat.S_ISDIR(found.st_mode) else "file"
        return {"type": kind, "size": found.st_size, "mtime": found.st_mtime_ns, "inode": found.st_ino}

    def exists(self, path: str = "") -> bool:
        """Return whether a file (or, without an argument, the folder) exists."""
        return self.info(path) is not None

    def version(self, path: str) -> tuple[object, ...] | None:
        """Return what changes whenever a file is replaced; None where there is none."""
        found = self.info(path)
        return None if found is None else tuple(str(found.get(key)) for key in VERSION_KEYS)

    def size_bytes(self, path: str) -> int:
        """Return the size of a file; raises FileNotFoundError."""
        found = self.info(path)
        if found is None:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), self.address(path))
        return int(found["size"])

    def entries(self, folder: str = "") -> dict[str, int | None]:
        """List names directly in a sub-folder, sorted, with sizes in bytes, None for what is not a file.

        An absent sub-folder is empty.
        """
        path = self.address(folder)
        sizes: dict[str, int | None] = {}
        with (
            readable(path),
            contextlib.suppress(FileNotFoundError, NotADirectoryError),
            os.scandir(path) as found,
        ):
            for entry in found:
                try:
                    sizes[entry.name] = entry.stat().st_size if entry.is_file() else None
                except FileNotFoundError:  # removed since it was listed, or a broken link
                    if entry.is_symlink():
                        sizes[entry.name] = None
        return dict(sorted(sizes.items()))

    def names(self, folder: str = "") -> list[str]:
        """List the names directly in a sub-folder, sorted."""
        return list(self.entries(folder))

    def sizes(self, folder: str = "") -> dict[str, int]:
        """List the files directly in a sub-folder with their sizes in bytes, sorted by name, in one look."""
        return {name: size for name, size in self.entries(folder).items() if size is not None}

    def walk(self, folder: str = "") -> Iterator[str]:
        """Yield the paths of all files in a sub-folder and below it, in order of their names."""
        for name, size in self.entries(folder).items():
            path = f"{folder}/{name}" if folder else name
            if size is None and not (self.is_local and Path(self.address(path)).is_symlink()):
                yield from self.walk(path)
            else:
                yield path

    def open(self, path: str) -> IO[bytes]:
        """Open a file for reading; IntegrityError for what is not a file, such as a pipe or a device."""
        with readable(self.address(path)):
            return open_regular(Path(self.address(path)))

    def read_bytes(self, path: str) -> bytes:
        """Read a whole (small) file; IntegrityError when it is missing or cannot be read."""
        try:
            return self._read(path)
        except OSError as error:
            raise IntegrityError(f"cannot read {self.address(path)!r}: {error.strerror or error}") from error

    def _read(self, path: str) -> bytes:
        with self.open(path) as stream:
            return stream.read()

    def read_many(self, paths: Sequence[str]) -> Iterator[bytes | None]:
        """Read many small files, in their order; None for one that cannot be read."""

        def read(path: str) -> bytes | None:
            with contextlib.suppress(IntegrityError):
                return self.read_bytes(path)
            return None

        return run.in_threads(read, paths, _READ_AT_ONCE)

    def write(self, path: str, fill: Callable[[IO[bytes]], T]) -> T:
        """Write a file in pieces, which appears when all is written, or never; return what ``fill`` returns.

        ``fill`` writes to a stream, and is called again where a run that finished a data set here has removed
        the temporary file. What goes to a store is put together in ``$TMPDIR`` first. Raises StorageError for
        a path that leads out of the folder, and where the file system refuses; then nothing is left behind.
        """
        return self._write(path, fill, Path.replace)

    def _write(self, path: str, fill: Callable[[IO[bytes]], T], publish: Callable[[Path, Path], object]) -> T:
        place = self.place(path)
        draft = self.place(f"{PENDING_FOLDER}/tmp-{uuid.uuid4().hex}")
        try:
            with named_failures(self.address(path)):
                return write_file(place, fill, draft, publish=publish)
        finally:
            with contextlib.suppress(OSError):  # something else is in it
                draft.parent.rmdir()

    def write_bytes(self, path: str, content: bytes) -> None:
        """Write a file in one step, so that readers see all of it or nothing; raises as :meth:`write`."""
        self.write(path, lambda stream: stream.write(content))

    def upload(self, path: str, source: Path) -> None:
        """Write a copy of a file of this machine in pieces; raises as :meth:`write`."""

        def copy(stream: IO[bytes]) -> None:
            with source.open("rb") as content:
                shutil.copyfileobj(content, stream, 1 << 20)

        self.write(path, copy)

    def create_bytes(self, path: str, content: bytes) -> None:
        """Write a file in one step unless there is one of that name.

        Of several writers at once, on any machines, one wins (in stores, where they know conditional writes;
        S3 and gs do). Raises as :meth:`write`.
        """

        def link(temporary: Path, target: Path) -> None:
            try:
                # The one step that is all or nothing on network file systems too.
                os.link(temporary, target)
            except OSError:
                if not target.exists():
                    temporary.replace(target)  # a file system without links

        self._write(path, lambda stream: stream.write(content), link)

    def download(self, path: str, target: Path) -> None:
        """Copy a file to a local one; FileNotFoundError where there is none."""
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(self.address(path), target)

    def move(self, path: str, target: str) -> None:
        """Move a file of a local folder inside it, in place of any other."""
        with named_failures(self.address(target)):
            place = self.place(target)
            make_folder(place.parent)
            self.place(path).replace(place)
            sync_folder(place.parent)

    def remove(self, path: str) -> None:
        """Remove a file, if it exists."""
        with named_failures(self.address(path)):
            self.place(path).unlink(missing_ok=True)

    def remove_empty(self, folder: str) -> None:
        """Remove a sub-folder when nothing is left in it; in object stores it has gone with its last file."""
        with contextlib.suppress(OSError):
            Path(self.address(folder)).rmdir()

    def remove_tree(self, folder: str, is_ours: Callable[[str], object]) -> None:
        """Remove the files in a sub-folder whose paths are ours, and folders that are empty then.

        Raises InputError for a link to a folder, whose content is not ours.
        """
        for name, size in self.entries(folder).items():
            path = f"{folder}/{name}"
            if size is None:
                self.place(path)
                self.remove_tree(path, is_ours)
            elif is_ours(path):
                self.remove(path)
        self.remove_empty(folder)

    def remove_temporaries(self) -> None:
        """Remove what writers left half-written; one that is still at work writes again."""
        self.remove_tree(PENDING_FOLDER, re.compile(f"{PENDING_FOLDER}/{TEMPORARY}").fullmatch)

    def require_folder(self) -> None:
        """Create the folder, and prove that it can be written to; a bucket must exist.

        Raises InputError when a file stands in its place or the bucket does not exist.
        """
        with named_failures(self.root):
            if self.exists() and self._problem():
                raise InputError(self._problem(), next="choose another path (--out or OUT)")
            make_folder(Path(self.root))
            with tempfile.TemporaryFile(dir=self.root):
                pass

    def refresh(self, folder: str) -> None:
        """Make a network file system drop what it cached of a sub-folder; stores cache nothing."""
        # Its time changes.
        with contextlib.suppress(OSError):
            os.utime(self.place(folder))

    @contextlib.contextmanager
    def locked(
        self, *, shared: bool = False, patience_s: float | None = None, is_patient: bool = False
    ) -> Iterator[None]:
        """Hold a local folder against other runs; stores have no locks.

        What a run changes there it changes under the lock, its shards under a ``shared`` one. Raises
        BusyError as :func:`tactile_toolkit.store.locks.locked` does, which explains the arguments.
        """
        # Together with the data set that is to take its place.
        home = Path(self.root)
        home = home.parent if home.name == NEXT_FOLDER else home
        with contextlib.ExitStack() as stack:
            while True:
                try:
                    stack.enter_context(
                        locked(home, shared=shared, patience_s=patience_s, is_patient=is_patient)
                    )
                    break
                except FileNotFoundError:  # a run that failed has removed it, empty as it was
                    with named_failures(str(home)):
                        make_folder(home)
            yield


class _StoreFolder(DataFolder):
    """A folder in a store: objects appear whole, nothing is moved or locked, and no bucket is ever made."""

    is_local = False

    @cached_property
    def _client(self) -> Any:
        return client_of(self.root)

    def _ask(self, action: Callable[[], T], doing: str, path: str, size_bytes: int = 0) -> T:
        return ask_store(action, doing, self.address(path), size_bytes)

    def _key(self, path: str = "") -> str:
        """Return how the client calls a file."""
        return str(self._client._strip_protocol(self.address(path))).rstrip("/")

    def _problem(self) -> str:
        bucket = self._key().partition("/")[0]
        if has_buckets(self.root) and self._info(bucket, "") is None:
            return f"the bucket {bucket!r} of {self.root!r} does not exist"
        return ""

    def info(self, path: str) -> Mapping[str, Any] | None:
        return self._info(self._key(path), path)

    def _info(self, key: str, path: str) -> Mapping[str, Any] | None:
        with contextlib.suppress(FileNotFoundError):
            found: Mapping[str, Any] = self._ask(lambda: self._client.info(key), "reading", path)
            return found
        return None

    def entries(self, folder: str = "") -> dict[str, int | None]:
        key, sizes = self._key(folder), {}
        with contextlib.suppress(FileNotFoundError):
            found = self._ask(lambda: self._client.ls(key, detail=True), "listing", folder)
            for entry in found:
                name = entry["name"].strip("/")
                # A file, and the mark of an empty folder, are listed in themselves.
                if name != key.strip("/"):
                    is_folder = entry["type"] == "directory"
                    sizes[name.rpartition("/")[2]] = None if is_folder else int(entry["size"])
        return dict(sorted(sizes.items()))

    def open(self, path: str) -> IO[bytes]:
        # Its `details` are those of the store; a file that is replaced is not read on.
        return open_in_store(self._client, self._key(path), self.address(path))

    def _read(self, path: str) -> bytes:
        key = self._key(path)
        return bytes(self._ask(lambda: self._client.cat_file(key), "reading", path))

    def write_bytes(self, path: str, content: bytes) -> None:
        options = self._in_one_request(content)
        self._put(path, len(content), lambda key: self._client.pipe_file(key, content, **options))

    def create_bytes(self, path: str, content: bytes) -> None:
        options = self._in_one_request(content) | {"mode": "create"}
        with contextlib.suppress(FileExistsError):
            self._put(path, len(content), lambda key: self._client.pipe_file(key, content, **options))

    def _in_one_request(self, content: bytes) -> dict[str, Any]:
        """Return what keeps a killed writer from leaving pieces, which cost money and are not listed."""
        return {"chunksize": len(content) + 1} if scheme_of(self.root) == "s3" else {}

    def upload(self, path: str, source: Path) -> None:
        options = {"max_concurrency": 2} if scheme_of(self.root) == "s3" else {}
        size_bytes = source.stat().st_size
        self._put(path, size_bytes, lambda key: self._client.put_file(str(source), key, **options))

    def write(self, path: str, fill: Callable[[IO[bytes]], T]) -> T:
        with scratch_folder() as scratch:
            file = scratch / "file"
            with named_failures(str(file)), file.open("wb") as stream:
                filled = fill(stream)
            self.upload(path, file)
        return filled

    def _put(self, path: str, size_bytes: int, put: Callable[[str], object]) -> None:
        self._require_writable(path)
        key = self._key(path)
        try:
            self._ask(lambda: put(key), "writing", path, size_bytes)
        except FileNotFoundError as error:
            if has_buckets(self.root):
                raise self._no_bucket() from error
            parent = key.rpartition("/")[0]
            self._ask(lambda: self._client.makedirs(parent, exist_ok=True), "writing", path)
            self._ask(lambda: put(key), "writing", path, size_bytes)

    def download(self, path: str, target: Path) -> None:
        target.parent.mkdir(parents=True, exist_ok=True)
        key, size_bytes = self._key(path), self.size_bytes(path)
        self._ask(lambda: self._client.get_file(key, str(target)), "reading", path, size_bytes)

    def remove(self, path: str) -> None:
        self._require_writable(path)
        with contextlib.suppress(FileNotFoundError):
            self._ask(lambda: self._client.rm_file(self._key(path)), "removing", path)

    def require_folder(self) -> None:
        self._require_writable("")
        found = self.info("")
        if found is not None and found["type"] == "file":
            raise InputError(
                f"{self.root!r} is a file, a folder was expected", next="choose another path (--out or OUT)"
            )
        if found is None and self._problem():
            raise self._no_bucket()

    # What only a file system has: a store has no stale listings, no empty folders, and no locks.

    def place(self, path: str) -> Path:
        raise InputError(
            f"{self.address(path)!r} is in a store, where files cannot be moved; nothing was done",
            next="choose a local folder",
        )

    def remove_empty(self, folder: str) -> None:
        self.address(folder)  # refuses a path that leads out of the folder

    def refresh(self, folder: str) -> None:
        pass

    @contextlib.contextmanager
    def locked(
        self, *, shared: bool = False, patience_s: float | None = None, is_patient: bool = False
    ) -> Iterator[None]:
        yield

    def _no_bucket(self) -> InputError:
        return InputError(
            f"{self._problem()}; nothing was written, and no bucket was made",
            next="check its name, or make it with the store's own tools",
        )

    def _require_writable(self, path: str) -> None:
        if scheme_of(self.root) == "hf":
            raise InputError(
                f"{self.address(path)!r} cannot be written to: the Hub takes whole commits",
                next="write to a folder or to s3://BUCKET/FOLDER, then send it with the command `upload`",
            )


def split_uri(place: str) -> tuple[DataFolder, str]:
    """Return the folder of a file, local or at an address, and its name in it."""
    if is_remote(place):
        parent, _, name = normalize_uri(place).rpartition("/")
        return DataFolder(parent), name
    path = Path(normalize_uri(place))
    return DataFolder(str(path.parent)), path.name


def local_folder(place: str) -> Path:
    """Return the path of a folder, which need not be there; InputError where it is a file or not local."""
    folder = DataFolder(place)
    path = Path(folder.root)
    if not folder.is_local or path.is_file():
        found = "is a file, a folder was expected" if folder.is_local else "is not a local folder"
        raise InputError(f"{place!r} {found}; nothing was changed", next="a local folder as --out")
    return path
