"""Data set folders: what all of them do, and those on local and network file systems.

An unfinished local file lies in ``.pending/tmp-...``. A run that finishes a data set removes all such files,
of any process; a writer whose file was removed writes it again.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import io
import os
import re
import stat
import tempfile
import uuid
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from operator import methodcaller
from pathlib import Path
from typing import IO, ClassVar, Protocol, TypeVar

from tactile_toolkit import errors, run
from tactile_toolkit.store.files import (
    expanded,
    leads_elsewhere,
    make_folder,
    named_failures,
    open_regular,
    problem_of_name,
    readable,
    sync_folder,
    write_file,
)
from tactile_toolkit.store.locks import locked
from tactile_toolkit.value_types import JsonObject

PENDING_FOLDER = ".pending"
"""Holds the records and report rows of finished shards until the manifest has them."""

NEXT_FOLDER = ".next"
"""Holds the data set that will replace the one in the folder."""

TEMPORARY = "tmp-[0-9a-f]{32}(?s:/.*)?"
"""Names of unfinished files in :data:`PENDING_FOLDER`, and of sub-folders of them, as a pattern."""

VERSION_KEYS = ("size", "ETag", "etag", "blob_id", "mtime", "created", "LastModified", "inode")
"""Names of the facts about a file that change whenever it is replaced."""

T = TypeVar("T")

# Small files that are read at a time: a network file system or store answers many requests as fast as one.
_READ_AT_ONCE = 16
# Characters of the longest usual path in a data set folder, such as that of a report of a shard in `.next`.
_LONGEST_INSIDE = 100
# For a path longer than MAX_PATH (260 characters), Windows reports a missing folder or a long name.
_TOO_LONG = (3, 206)
_PARQUET_MARK = b"PAR1"
# Errors that are reported when a file is looked up; all others mean that there is no such file.
_REFUSALS = (errno.EACCES, errno.EPERM, errno.ENAMETOOLONG)


class DataFolder(Protocol):
    """A data set folder: local (:class:`LocalFolder`) or in a store of objects (``remote.FsspecFolder``).

    :func:`tactile_toolkit.store.open_folder` returns the one for an address. Paths are relative to the
    folder, with slashes; nothing is written or removed through symbolic links in it. A file appears under its
    name complete or not at all. Pickles as its address only, so tasks carry it to other processes and
    machines. Methods raise StorageError where a file system refuses, RemoteError where a store refuses or
    does not answer, and InputError if the package of a store is not installed.

    Attributes
    ----------
    root : str
        Absolute path of the folder, or its address.
    is_local : bool
        Whether the folder is on a local file system.
    """

    root: str
    is_local: ClassVar[bool]

    def address(self, path: str = "") -> str:
        """Return the full address of a file of the folder, for messages and readers.

        Every operation on a file starts here. Raises StorageError for a path that leads out of the folder:
        names from outside are refused where they are read, and the check here is the last one.
        """
        if not path:
            return self.root
        if leads_elsewhere(path):
            raise errors.StorageError(
                f"{path!r} leads out of {self.root!r} or is not a path; nothing was done"
            )
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
        facts = self.info(path)
        if facts is None:
            return None
        return tuple(str(facts.get(key)) for key in VERSION_KEYS)

    def size_bytes(self, path: str) -> int:
        """Return the size of a file; raises FileNotFoundError."""
        facts = self.info(path)
        if facts is None:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), self.address(path))
        return int(facts["size"])

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

    def walk(self, folder: str = "") -> Iterator[str]:
        """Yield the paths of all files and links in a sub-folder and below it, in order of their names."""
        for name, size in self.entries(folder).items():
            path = f"{folder}/{name}".lstrip("/")
            if size is None and not (self.is_local and Path(self.address(path)).is_symlink()):
                yield from self.walk(path)
            else:
                yield path

    @abstractmethod
    def open(self, path: str) -> IO[bytes]:
        """Open a file for reading; IntegrityError for anything else, such as a pipe or a device."""

    @abstractmethod
    def read_bytes(self, path: str) -> bytes:
        """Read a whole (small) file; IntegrityError when it is missing or cannot be read."""

    def read_many(self, paths: Sequence[str]) -> Iterator[bytes | None]:
        """Read many small files, in their order; None for one that cannot be read."""

        def read(path: str) -> bytes | None:
            with contextlib.suppress(errors.IntegrityError):
                return self.read_bytes(path)
            return None

        return run.in_threads(read, paths, _READ_AT_ONCE)

    def sha256(self, path: str) -> str:
        """Return the SHA-256 of a file in hexadecimal, read in pieces."""
        with self.open(path) as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()  # type: ignore[arg-type]

    def has_sha256(self, path: str, sha256: str) -> bool:
        """Return whether a file exists and has this checksum."""
        return self.exists(path) and self.sha256(path) == sha256

    def open_inside(self, path: str, known: set[str] | None = None) -> IO[bytes]:
        """Open a regular file of a folder of unknown origin; every importer opens files here.

        A table, a tar or a Zarr group names files of its folder. A link may lead to any file of this machine,
        whose bytes would then be stored as a picture and published. Reading a pipe would wait, and a device
        has no end.

        Parameters
        ----------
        path : str
            Relative path, with slashes. The folder itself may be reached through a link.
        known : set of str, optional
            Sub-folders that lie inside, for a caller that opens many files in a row: each is checked once.

        Raises
        ------
        ItemError
            The file does not exist or is not a regular one, or a link leads out of the folder.
        InputError
            This user may not read it.
        """
        self._require_inside(path, known)
        try:
            return self.open(path)
        except (FileNotFoundError, NotADirectoryError) as error:
            raise errors.ItemError("missing", "the file does not exist") from error
        except (OSError, errors.IntegrityError) as error:
            raise errors.ItemError("file", "it is not a regular file, or cannot be read") from error

    def read_inside(self, path: str, size: int, known: set[str]) -> bytes:
        """Return the beginning of a small regular file; arguments and errors of :meth:`open_inside`."""
        with self.open_inside(path, known) as stream:
            return stream.read(size)

    def size_inside(self, path: str) -> int:
        """Return the size of a regular file of a folder of unknown origin; raises as :meth:`open_inside`."""
        problem = problem_of_name(path)
        if problem:
            raise errors.ItemError("name", f"the name {problem}; expected a path below the folder")
        with self.open_inside(path) as stream:
            return stream.seek(0, io.SEEK_END)

    def is_parquet(self, path: str) -> bool:
        """Return whether a file is a Parquet file by its name or its first bytes."""
        if path.endswith(".parquet"):
            return True
        with self.open(path) as stream:
            return stream.read(len(_PARQUET_MARK)) == _PARQUET_MARK

    def refuse_source(self, name: str, files: Iterable[str]) -> None:
        """Raise InputError if this folder, to be written, holds or lies in a source, also through links.

        ``name`` is the source as the user gave it; ``files`` are the paths or addresses of its files.
        """
        if not self.is_local:
            inside = f"{self.root}/"
            holds = any(file.startswith(inside) for file in files)
            lies_in = inside.startswith(f"{name.rstrip('/')}/")
        else:
            out = Path(self.root).resolve()
            home = expanded(name).resolve()
            # By both paths: files of the Hub's cache are links into another folder.
            named = [Path(file).absolute() for file in files]
            real = [file.resolve() for file in named]
            holds = any(file.is_relative_to(out) for file in real)
            ours = home.is_dir() and out.is_relative_to(home)
            lies_in = ours and any(file.is_relative_to(home) for file in [*real, *named])
        if holds or lies_in:
            raise errors.InputError(
                f"{self.root!r}, the folder to write, {'holds' if holds else 'lies in'} the source {name!r}; "
                "nothing was changed",
                next="choose a folder outside it",
            )

    def problem_of_file(self, path: str) -> str:
        """Return why a path is not a file of the folder itself; empty if it is."""
        if not self.exists(path):
            return "is missing"
        outside = self._target_outside(path)
        if outside is not None:
            return f"is a link that leads out of the folder, to {outside!r}; next: put the file there itself"
        if self.is_local and not Path(self.address(path)).is_file():
            return "is not a file (it is a folder, a pipe or a device)"
        return ""

    def _require_inside(self, path: str, known: set[str] | None = None) -> None:
        if self._target_outside(path) is not None:
            problem = "a link leads out of the folder; expected a file below it, such as a copy"
            raise errors.ItemError("name", problem)
        parent = path.rpartition("/")[0]
        if known is not None and parent not in known and self._target_outside(parent) is None:
            known.add(parent)

    def _target_outside(self, path: str) -> str | None:
        """Return the target of a path on which links lead out of the folder; None for any other.

        A link may lead to another file of the folder, or from a snapshot of the Hub's cache to its contents.
        No other file is read, because the folder is untrusted. Stores have no links.
        """
        if not self.is_local:
            return None
        # Not `Path.resolve`, which fails for circular links.
        root, target = (Path(os.path.realpath(self.address(name))) for name in ("", path))
        is_of_cache = root.parent.name == "snapshots" and target.parent == root.parent.parent / "blobs"
        return None if target.is_relative_to(root) or is_of_cache else str(target)

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
    def remove(self, path: str) -> None:
        """Remove a file, if it exists."""

    def remove_empty(self, folder: str) -> None:
        """Remove a sub-folder if it is empty; in a store, it vanished with its last file."""
        self.address(folder)  # refuses a path that leads out of the folder

    @abstractmethod
    def remove_temporaries(self) -> None:
        """Remove unfinished files of writers, which write them again."""

    @abstractmethod
    def require_folder(self) -> None:
        """Create the folder, and prove that it can be written to; a bucket must exist.

        Raises InputError if there is a file of that name, or if the bucket does not exist.
        """

    @abstractmethod
    def refresh(self, folder: str) -> None:
        """Make a network file system drop what it cached of a sub-folder."""

    @contextlib.contextmanager
    def locked(
        self, *, shared: bool = False, patience_s: float | None = None, is_patient: bool = False
    ) -> Iterator[None]:
        """Lock the folder against other runs, where this is possible; stores have no locks.

        A run changes files of the folder under the lock, its shards under a ``shared`` one. Raises BusyError
        as :func:`tactile_toolkit.store.locked` does, which explains the arguments.
        """
        yield


@dataclass(frozen=True)
class LocalFolder(DataFolder):
    """A data set folder on a local or network file system, by its absolute path."""

    root: str
    is_local: ClassVar[bool] = True

    def local_path(self, path: str) -> Path:
        """Return the path of a file that may be written, moved or removed.

        Raises InputError if the file, or a folder between it and this folder, is a symbolic link: the target
        of a link does not belong to this folder. The folder itself may be reached through a link.
        """
        target = Path(self.address(path))
        root = Path(self.root)
        for step in (target, *target.parents):
            if step == root:
                break
            if step.is_symlink():
                raise errors.InputError(
                    f"{str(step)!r} is a symbolic link; nothing is written, moved or removed through a link",
                    next="replace the link by a copy of its target, or choose another folder (--out or OUT)",
                )
        return target

    def problem(self) -> str:
        """Return why the folder cannot hold files, or ``""`` if it can."""
        facts = self.info("")
        if facts is None:
            return f"{self.root!r} does not exist"
        if facts["type"] == "directory":
            return ""
        return f"{self.root!r} is a file; expected a folder"

    def info(self, path: str) -> JsonObject | None:
        """Return type, size, time and inode of a file or folder; None if it does not exist."""
        address = self.address(path)
        try:
            status = Path(address).stat()
        except (OSError, ValueError) as error:  # a circle of links, or a null byte: no file
            if getattr(error, "errno", None) not in _REFUSALS:
                return None
            with readable(address):
                raise
        kind = "directory" if stat.S_ISDIR(status.st_mode) else "file"
        return {"type": kind, "size": status.st_size, "mtime": status.st_mtime_ns, "inode": status.st_ino}

    def entries(self, folder: str = "") -> dict[str, int | None]:
        """List the names in a sub-folder, sorted, with sizes in bytes; None for anything but a file."""
        address = self.address(folder)
        sizes: dict[str, int | None] = {}
        try:
            with os.scandir(address) as listed:
                for entry in listed:
                    try:
                        sizes[entry.name] = entry.stat().st_size if entry.is_file() else None
                    except FileNotFoundError:  # removed since it was listed, or a broken link
                        if entry.is_symlink():
                            sizes[entry.name] = None
        except (FileNotFoundError, NotADirectoryError):
            return {}
        except OSError:
            with readable(address):
                raise
        return dict(sorted(sizes.items()))

    def open(self, path: str) -> IO[bytes]:
        """Open a file for reading; IntegrityError for what is not a file, such as a pipe or a device."""
        address = self.address(path)
        try:
            return open_regular(address)
        except OSError:
            with readable(address):  # only then: this runs for each image of an import
                raise

    def read_bytes(self, path: str) -> bytes:
        """Read a whole (small) file; IntegrityError when it is missing or cannot be read."""
        try:
            with self.open(path) as stream:
                return stream.read()
        except OSError as error:
            raise errors.IntegrityError(
                f"cannot read {self.address(path)!r}: {error.strerror or error}"
            ) from error

    def read_inside(self, path: str, size: int, known: set[str]) -> bytes:
        """Return the beginning of a small regular file; arguments and errors of :meth:`open_inside`.

        This runs for each image. On systems that can refuse to open a link, it takes less than half of the
        time of :meth:`open_inside`.
        """
        no_link = getattr(os, "O_NOFOLLOW", 0)
        parent = path.rpartition("/")[0]
        if no_link and parent in known:
            with contextlib.suppress(OSError):  # a link, or not a file: `open_inside` says what it is
                flags = os.O_RDONLY | no_link | getattr(os, "O_NONBLOCK", 0)
                handle = os.open(self.address(path), flags)
                try:
                    content = os.read(handle, size) if stat.S_ISREG(os.fstat(handle).st_mode) else b""
                finally:
                    os.close(handle)
                if len(content) == size > 0:
                    return content
        return super().read_inside(path, size, known)

    def write(self, path: str, fill: Callable[[IO[bytes]], T]) -> T:
        """Write a file in pieces; it appears when it is complete, or never. Return the result of ``fill``.

        ``fill`` is called again if a run that finished a data set here has removed the temporary file.
        """
        return self._write(path, fill, Path.replace)

    def _write(self, path: str, fill: Callable[[IO[bytes]], T], publish: Callable[[Path, Path], object]) -> T:
        target = self.local_path(path)
        draft = self.local_path(f"{PENDING_FOLDER}/tmp-{uuid.uuid4().hex}")
        try:
            with named_failures(str(target)):
                return write_file(target, fill, draft, publish=publish)
        finally:
            with contextlib.suppress(OSError):  # the folder is not empty
                draft.parent.rmdir()

    def write_bytes(self, path: str, content: bytes) -> None:
        """Write a file in one step, so that readers see all of it or nothing."""
        self.write(path, methodcaller("write", content))

    def create_bytes(self, path: str, content: bytes) -> None:
        """Write a file in one step unless there is one of that name; if several try, one of them wins."""

        def link(temporary: Path, target: Path) -> None:
            try:
                # Making a link is atomic on network file systems, too.
                os.link(temporary, target)
            except OSError:
                if not target.exists():
                    temporary.replace(target)  # a file system without links

        self._write(path, methodcaller("write", content), link)

    def move(self, path: str, target: str) -> None:
        """Move a file inside the folder, in place of any other."""
        with named_failures(self.address(target)):
            to = self.local_path(target)
            make_folder(to.parent)
            self.local_path(path).replace(to)
            sync_folder(to.parent)

    def remove(self, path: str) -> None:
        """Remove a file, if it exists."""
        with named_failures(self.address(path)):
            self.local_path(path).unlink(missing_ok=True)

    def remove_empty(self, folder: str) -> None:
        """Remove a sub-folder if it is empty."""
        with contextlib.suppress(OSError):
            Path(self.address(folder)).rmdir()

    def remove_tree(self, folder: str, is_ours: Callable[[str], object]) -> None:
        """Remove the files in a sub-folder whose paths are ours, and folders that become empty.

        Raises InputError for a link to a folder, whose content is not ours.
        """
        for name, size in self.entries(folder).items():
            path = f"{folder}/{name}"
            if size is None:
                self.local_path(path)
                self.remove_tree(path, is_ours)
            elif is_ours(path):
                self.remove(path)
        self.remove_empty(folder)

    @contextlib.contextmanager
    def stage(self) -> Iterator[str]:
        """Yield the path of a new sub-folder for files that :meth:`move` takes; all others are removed."""
        path = f"{PENDING_FOLDER}/tmp-{uuid.uuid4().hex}"
        make_folder(self.local_path(path))
        try:
            yield path
        finally:
            # Windows removes no file that is open: the next run does.
            with contextlib.suppress(errors.StorageError):
                self.remove_temporaries()

    def remove_temporaries(self) -> None:
        """Remove unfinished files of writers; a writer that is still at work writes again."""
        self.remove_tree(PENDING_FOLDER, re.compile(f"{PENDING_FOLDER}/{TEMPORARY}").fullmatch)

    def require_folder(self) -> None:
        """Create the folder, and check that it can be written to; InputError for a file in its place."""
        with named_failures(self.root):
            problem = self.problem()
            if problem and self.exists():
                raise errors.InputError(problem, next="choose another path (--out or OUT)")
            make_folder(Path(self.root))
            with tempfile.TemporaryFile(dir=self.root):
                pass
        try:
            Path(self.root, "x" * _LONGEST_INSIDE).lstat()
        except OSError as error:
            if error.errno == errno.ENAMETOOLONG or getattr(error, "winerror", None) in _TOO_LONG:
                raise errors.InputError(
                    f"{self.root!r} has {len(self.root)} characters, so that the system refuses the names "
                    "of files in it",
                    next="choose a folder with a shorter path (--out or OUT), or enable long paths in "
                    "Windows",
                ) from error

    def refresh(self, folder: str) -> None:
        """Change the time of a sub-folder, so that a network file system drops its cached listing."""
        with contextlib.suppress(OSError):
            os.utime(self.local_path(folder))

    @contextlib.contextmanager
    def locked(
        self, *, shared: bool = False, patience_s: float | None = None, is_patient: bool = False
    ) -> Iterator[None]:
        """Lock the folder, and the data set in ``.next/`` that will replace it, against other runs."""
        home = Path(self.root)
        if home.name == NEXT_FOLDER:
            home = home.parent
        with contextlib.ExitStack() as stack:
            while True:
                try:
                    lock = locked(home, shared=shared, patience_s=patience_s, is_patient=is_patient)
                    stack.enter_context(lock)
                    break
                except FileNotFoundError:  # a failed run has removed the empty folder
                    with named_failures(str(home)):
                        make_folder(home)
            yield
