"""Data set folders on local and network file systems.

An unfinished file lies in ``.pending/tmp-...``. A run that finishes a data set removes all such files, of any
process; a writer whose file was removed writes it again.
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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, ClassVar, TypeVar

from tactile_toolkit.errors import InputError, IntegrityError, StorageError
from tactile_toolkit.json_types import JsonObject
from tactile_toolkit.store.data_folder import NEXT_FOLDER, PENDING_FOLDER, TEMPORARY, DataFolder
from tactile_toolkit.store.files import (
    make_folder,
    named_failures,
    open_regular,
    readable,
    sync_folder,
    write_file,
)
from tactile_toolkit.store.locks import locked

T = TypeVar("T")

_COPY_BYTES = 1 << 20
# Characters of the longest usual path in a data set folder, such as that of a report of a shard in `.next`.
_LONGEST_INSIDE = 100
# For a path longer than MAX_PATH (260 characters), Windows reports a missing folder or a long name.
_TOO_LONG = (3, 206)
# Errors that are reported when a file is looked up; all others mean that there is no such file.
_REFUSALS = (errno.EACCES, errno.EPERM, errno.ENAMETOOLONG)


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
        found, root = Path(self.address(path)), Path(self.root)
        for step in (found, *found.parents):
            if step == root:
                break
            if step.is_symlink():
                raise InputError(
                    f"{str(step)!r} is a symbolic link; nothing is written, moved or removed through a link",
                    next="replace the link by a copy of its target, or choose another folder (--out or OUT)",
                )
        return found

    def problem(self) -> str:
        """Return why the folder cannot hold files, or ``""`` if it can."""
        found = self.info("")
        if found is None:
            return f"{self.root!r} does not exist"
        if found["type"] == "directory":
            return ""
        return f"{self.root!r} is a file; expected a folder"

    def info(self, path: str) -> JsonObject | None:
        """Return type, size, time and inode of a file or folder; None if it does not exist."""
        with readable(self.address(path)):
            try:
                found = Path(self.address(path)).stat()
            except (OSError, ValueError) as error:  # a circle of links, or a null byte: no file
                if getattr(error, "errno", None) in _REFUSALS:
                    raise
                return None
        kind = "file"
        if stat.S_ISDIR(found.st_mode):
            kind = "directory"
        return {"type": kind, "size": found.st_size, "mtime": found.st_mtime_ns, "inode": found.st_ino}

    def entries(self, folder: str = "") -> dict[str, int | None]:
        """List the names in a sub-folder, sorted, with sizes in bytes; None for anything but a file."""
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

    def walk(self, folder: str = "") -> Iterator[str]:
        """Yield the paths of all files and links in a sub-folder and below it, in order of their names."""
        for name, size in self.entries(folder).items():
            path = f"{folder}/{name}".lstrip("/")
            if size is None and not Path(self.address(path)).is_symlink():
                yield from self.walk(path)
            else:
                yield path

    def open(self, path: str) -> IO[bytes]:
        """Open a file for reading; IntegrityError for what is not a file, such as a pipe or a device."""
        place = self.address(path)
        try:
            return open_regular(place)
        except OSError:
            with readable(place):  # only then: this runs for each image of an import
                raise

    def read_bytes(self, path: str) -> bytes:
        """Read a whole (small) file; IntegrityError when it is missing or cannot be read."""
        try:
            with self.open(path) as stream:
                return stream.read()
        except OSError as error:
            raise IntegrityError(f"cannot read {self.address(path)!r}: {error.strerror or error}") from error

    def write(self, path: str, fill: Callable[[IO[bytes]], T]) -> T:
        """Write a file in pieces; it appears when it is complete, or never. Return the result of ``fill``.

        ``fill`` is called again if a run that finished a data set here has removed the temporary file.
        """
        return self._write(path, fill, Path.replace)

    def _write(self, path: str, fill: Callable[[IO[bytes]], T], publish: Callable[[Path, Path], object]) -> T:
        target = self.local_path(path)
        draft = self.local_path(f"{PENDING_FOLDER}/tmp-{uuid.uuid4().hex}")
        try:
            with named_failures(self.address(path)):
                return write_file(target, fill, draft, publish=publish)
        finally:
            with contextlib.suppress(OSError):  # the folder is not empty
                draft.parent.rmdir()

    def write_bytes(self, path: str, content: bytes) -> None:
        """Write a file in one step, so that readers see all of it or nothing."""
        self.write(path, lambda stream: stream.write(content))

    def create_bytes(self, path: str, content: bytes) -> None:
        """Write a file in one step unless there is one of that name; if several try, one of them wins."""

        def link(temporary: Path, target: Path) -> None:
            try:
                # Making a link is atomic on network file systems, too.
                os.link(temporary, target)
            except OSError:
                if not target.exists():
                    temporary.replace(target)  # a file system without links

        self._write(path, lambda stream: stream.write(content), link)

    def upload(self, path: str, source: Path) -> None:
        """Write a copy of a file of this machine in pieces."""

        def copy(stream: IO[bytes]) -> None:
            with source.open("rb") as content:
                shutil.copyfileobj(content, stream, _COPY_BYTES)

        self.write(path, copy)

    def download(self, path: str, target: Path) -> None:
        """Copy a file to a local one; FileNotFoundError if there is none."""
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(self.address(path), target)

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
            with contextlib.suppress(StorageError):
                self.remove_temporaries()

    def remove_temporaries(self) -> None:
        """Remove unfinished files of writers; a writer that is still at work writes again."""
        self.remove_tree(PENDING_FOLDER, re.compile(f"{PENDING_FOLDER}/{TEMPORARY}").fullmatch)

    def require_folder(self) -> None:
        """Create the folder, and check that it can be written to; InputError for a file in its place."""
        with named_failures(self.root):
            problem = self.problem()
            if problem and self.exists():
                raise InputError(problem, next="choose another path (--out or OUT)")
            make_folder(Path(self.root))
            with tempfile.TemporaryFile(dir=self.root):
                pass
        if _is_too_long(Path(self.root) / ("x" * _LONGEST_INSIDE)):
            raise InputError(
                f"{self.root!r} has {len(self.root)} characters, so that the system refuses the names of "
                "files in it",
                next="choose a folder with a shorter path (--out or OUT), or enable long paths in Windows",
            )

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
                    stack.enter_context(
                        locked(home, shared=shared, patience_s=patience_s, is_patient=is_patient)
                    )
                    break
                except FileNotFoundError:  # a failed run has removed the empty folder
                    with named_failures(str(home)):
                        make_folder(home)
            yield


def _is_too_long(path: Path) -> bool:
    """Return whether the system refuses a path, which does not exist, for its length."""
    try:
        path.lstat()
    except OSError as error:
        return error.errno == errno.ENAMETOOLONG or getattr(error, "winerror", None) in _TOO_LONG
    return False
