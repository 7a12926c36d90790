"""A data set folder on a local file system: whole files, and nothing through symbolic links.

What is written lies in ``.pending/tmp-...`` until it is whole. Who finishes a data set removes all such
files, whoever's they are; a writer whose file has gone writes it again.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from tactile_toolkit.errors import InputError, StorageError
from tactile_toolkit.run.system import locked, sync_folder
from tactile_toolkit.store.files import is_there, named_failures, new_file, open_regular, readable

__all__ = ["NEXT_FOLDER", "PENDING_FOLDER", "TEMPORARY", "LocalFiles"]

PENDING_FOLDER = ".pending"
"""Holds the records and report rows of finished shards until the manifest has them."""

NEXT_FOLDER = ".next"
"""Holds the data set that is to take the place of the one around it."""

TEMPORARY = "tmp-"
"""How the name of every unfinished file in :data:`PENDING_FOLDER` begins."""

_TRIES = 10
_NO_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK)


@dataclass(frozen=True)
class LocalFiles:
    """A local folder; paths are relative to it. Raises StorageError where the file system refuses."""

    root: str

    def place(self, path: str) -> Path:
        """Return where a file is written, moved or removed.

        Raises InputError where the file, or a folder on the way to it, is a symbolic link: what that leads to
        does not belong to this folder, which may be reached through a link itself.
        """
        place, root = Path(self.root, path), Path(self.root)
        for step in (place, *place.parents):
            if step == root:
                break
            if step.is_symlink():
                message = (
                    f"{str(step)!r} is a symbolic link; expected a file or folder of its own: nothing is "
                    "written, moved or removed through a link; next: put what it leads to in its place, or "
                    "choose another folder (--out or OUT)"
                )
                raise InputError(message)
        return place

    def exists(self, path: str = "") -> bool:
        """Return whether a file (or, without an argument, the folder) is there."""
        # Who asks for the folder itself is about to write there, and names the failure.
        with readable(str(Path(self.root, path))) if path else contextlib.nullcontext():
            return is_there(Path(self.root, path))

    def version(self, path: str) -> tuple[object, ...] | None:
        """Return what changes whenever a file is replaced; None where there is none."""
        try:
            facts = Path(self.root, path).stat()
        except OSError:
            return None
        return facts.st_ino, facts.st_size, facts.st_mtime_ns

    def entries(self, folder: str = "") -> dict[str, int | None]:
        """List names directly in a sub-folder, sorted, with sizes in bytes, None for what is not a file."""
        path = f"{self.root}/{folder}"
        sizes: dict[str, int | None] = {}
        with (
            readable(path),
            contextlib.suppress(FileNotFoundError, NotADirectoryError),
            os.scandir(path) as found,
        ):
            for entry in found:
                try:
                    sizes[entry.name] = entry.stat().st_size if entry.is_file() else None
                except FileNotFoundError:  # gone since it was listed, or a link that leads nowhere
                    if entry.is_symlink():
                        sizes[entry.name] = None
        return dict(sorted(sizes.items()))

    def open(self, path: str) -> IO[bytes]:
        """Open a file for reading; IntegrityError for what is not a file, such as a pipe or a device."""
        with readable(f"{self.root}/{path}"):
            return open_regular(Path(self.root, path))

    def read(self, path: str) -> bytes:
        """Read a whole file at once; raises OSError."""
        with self.open(path) as stream:
            return stream.read()

    def put(self, path: str, content: bytes | Path) -> None:
        """Write a whole file in place of any other, or copy one; nothing half-written is left."""
        for tries_left in reversed(range(_TRIES)):
            try:
                self._put(path, content)
                return
            except FileNotFoundError as error:  # who finished a data set here has removed it
                if not tries_left:
                    with named_failures(f"{self.root}/{path}"):
                        raise error

    def _put(self, path: str, content: bytes | Path) -> None:
        with self.temporary(path) as (temporary, stream):
            if isinstance(content, bytes):
                stream.write(content)
            else:
                with content.open("rb") as source:
                    shutil.copyfileobj(source, stream, 1 << 20)
            self._arrive(temporary, stream, path)

    def _arrive(self, temporary: Path, stream: IO[bytes], path: str) -> None:
        stream.flush()
        os.fsync(stream.fileno())
        stream.close()  # Windows moves no open file
        target = self.place(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary.replace(target)
        sync_folder(target.parent)

    @contextlib.contextmanager
    def temporary(self, path: str) -> Iterator[tuple[Path, IO[bytes]]]:
        """Give a new temporary file and remove it if it is still there at the end; names failures of both.

        FileNotFoundError stays as it is: the file may have been removed by who finished a data set here.
        """
        self.place(path)
        temporary = self.place(f"{PENDING_FOLDER}/{TEMPORARY}{uuid.uuid4().hex}")
        with _named_but_absence(f"{self.root}/{path}".rstrip("/")):
            try:
                with new_file(temporary) as stream:
                    yield temporary, stream
            finally:
                with contextlib.suppress(FileNotFoundError, NotADirectoryError):
                    temporary.unlink()
                with contextlib.suppress(OSError):  # something else is in it
                    temporary.parent.rmdir()

    @contextlib.contextmanager
    def writing(self, path: str) -> Iterator[IO[bytes]]:
        """Open a file to be written in pieces, which appears whole when all is written, or never."""
        with named_failures(f"{self.root}/{path}"), self.temporary(path) as (temporary, stream):
            yield stream
            self._arrive(temporary, stream, path)

    def create(self, path: str, content: bytes) -> bool:
        """Write a whole file unless there is one of that name; return whether this call did."""
        with named_failures(f"{self.root}/{path}"), self.temporary(path) as (temporary, stream):
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
            target = self.place(path)
            try:
                os.link(temporary, target)  # the one step that is all or nothing on network file systems too
            except FileExistsError:
                return temporary.stat().st_nlink == 2  # done, and the answer of the server was lost
            except OSError as error:
                if error.errno not in _NO_LINKS:
                    raise
                with contextlib.suppress(FileExistsError), target.open("xb") as other:
                    other.write(content)
                    return True
                return False
            sync_folder(target.parent)
        return True

    def move(self, path: str, target: str) -> None:
        """Move a file inside the folder, in place of any other."""
        with named_failures(f"{self.root}/{target}"):
            place = self.place(target)
            place.parent.mkdir(parents=True, exist_ok=True)
            self.place(path).replace(place)
            sync_folder(place.parent)

    def download(self, path: str, target: Path) -> None:
        """Copy a file to another place; raises FileNotFoundError."""
        shutil.copyfile(Path(self.root, path), target)

    def remove(self, path: str) -> None:
        """Remove a file, if it is there."""
        with named_failures(f"{self.root}/{path}"):
            self.place(path).unlink(missing_ok=True)

    def remove_empty(self, folder: str) -> None:
        """Remove a sub-folder when nothing is left in it."""
        with contextlib.suppress(OSError):
            Path(self.root, folder).rmdir()

    def make(self) -> None:
        """Create the folder, and prove that it can be written to; InputError when a file stands there."""
        path = Path(self.root)
        with named_failures(self.root):
            if path.exists() and not path.is_dir():
                message = (
                    f"{self.root!r} is a file, a folder was expected; choose another path (--out or OUT)"
                )
                raise InputError(message)
            path.mkdir(parents=True, exist_ok=True)
            with self.temporary(""):
                pass

    def refresh(self, folder: str) -> None:
        """Have a network file system forget what it knows of a sub-folder: its time changes."""
        with contextlib.suppress(OSError):
            os.utime(self.place(folder))

    @contextlib.contextmanager
    def lock(self, *, shared: bool, patience_s: float) -> Iterator[None]:
        """Hold the folder against other runs, with the data set that is to take its place."""
        home = Path(self.root)
        home = home.parent if home.name == NEXT_FOLDER else home
        with contextlib.ExitStack() as stack:
            while True:
                try:
                    stack.enter_context(locked(home, shared=shared, patience_s=patience_s))
                    break
                except FileNotFoundError:  # a run that failed has removed it, empty as it was
                    with named_failures(str(home)):
                        home.mkdir(parents=True, exist_ok=True)
                except BlockingIOError as error:
                    left = f", or remove {error.filename!r} if none is at work" if error.filename else ""
                    message = (
                        f"another run writes to {str(home)!r}, and has done so for {patience_s:.0f} s; "
                        f"nothing was changed; next: wait until it has ended, or end it{left}, and run the "
                        "same command again"
                    )
                    raise InputError(message) from error
            yield


@contextlib.contextmanager
def _named_but_absence(address: str) -> Iterator[None]:
    try:
        with named_failures(address):
            yield
    except StorageError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            raise error.__cause__ from None
        raise
