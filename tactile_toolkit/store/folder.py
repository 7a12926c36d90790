"""The one seam through which data set folders are read and written.

Local folders and every fsspec address (``s3://...``, ``memory://...``) go through :class:`DataFolder`. A file
appears under its name complete or not at all: local files are written under a temporary name beside their
place, flushed to disk and renamed; object stores put whole objects.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import socket
import uuid
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import IO, Any

from tactile_toolkit.errors import InputError, IntegrityError, StorageError

__all__ = [
    "DataFolder",
    "UNFINISHED",
    "atomic_file",
    "folders_below",
    "leavings",
    "left_by_the_dead",
    "named_failures",
    "remove_tree",
    "unfinished_name",
]

UNFINISHED = ".writing-"
"""How the name of every unfinished file begins."""

_WRITER = re.compile(r"(?P<process>\d+)(?:\.(?P<began>\d+))?-")
_ENDED_STATES = ("Z", "X")  # a zombie has ended; its parent has not asked for its exit status yet


def unfinished_name(name: str, prefix: str = UNFINISHED) -> str:
    """Return a name, new each time, under which this process may write ``name`` until it is finished."""
    process = os.getpid()
    began = _began(process)
    writer = str(process) if began is None else f"{process}.{began}"
    return f"{prefix}{socket.gethostname()}-{writer}-{uuid.uuid4().hex[:8]}-{name}"


def left_by_the_dead(name: str, prefix: str = UNFINISHED) -> bool:
    """Tell whether a name is that of an unfinished file whose writer, on this machine, has ended."""
    here = f"{prefix}{socket.gethostname()}-"
    writer = _WRITER.match(name, len(here)) if name.startswith(here) else None
    if writer is None:
        return False
    process, began = int(writer["process"]), writer["began"]
    return not _runs(process) or (began is not None and began != _began(process))


def leavings(folder: Path, prefix: str = UNFINISHED) -> Iterator[Path]:
    """Yield what dead writers left directly in a local folder."""
    yield from (entry for entry in folder.glob(f"{prefix}*") if left_by_the_dead(entry.name, prefix))


def _runs(process: int) -> bool:
    if _has_proc():
        facts = _facts(process)
        return facts is not None and facts[0] not in _ENDED_STATES
    try:
        os.kill(process, 0)  # sends nothing, only asks
    except ProcessLookupError:
        return False
    except OSError:
        return True  # somebody else's
    return True


def _began(process: int) -> str | None:
    """Return when a process began, in clock ticks since the machine started; None where that is not known."""
    facts = _facts(process)
    return None if facts is None else facts[19]


def _facts(process: int) -> list[str] | None:
    """Return the fields of Linux's ``/proc/PID/stat`` (proc(5)) from the third, the state, onwards."""
    try:
        line = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return None
    # The second field, the program's name in brackets, may hold blanks and brackets itself.
    return line.rpartition(")")[2].split()


def _has_proc() -> bool:
    return Path("/proc/self/stat").exists()


_HINTS = {
    errno.ENOSPC: "no space is left on the device; free some and run the same command again",
    errno.EDQUOT: "the disk quota is used up; free some space and run the same command again",
    errno.EROFS: "the file system is read-only; choose another folder (--out or OUT)",
    errno.EACCES: "permission denied; choose another folder (--out or OUT) or change its permissions",
    errno.EPERM: "the operation is not permitted; choose another folder (--out or OUT)",
    errno.ENOTDIR: "a part of the path is a file, not a folder; choose another folder (--out or OUT)",
    errno.EEXIST: "a file of that name stands where a folder is needed; choose another folder (--out or OUT)",
    errno.EFBIG: "the file would be larger than allowed here (ulimit -f, or the file system's own limit)",
}


@dataclass(frozen=True)
class DataFolder:
    """A data set folder, local or remote.

    Parameters
    ----------
    url : str
        Path of a local folder, or any fsspec address of one.

    Notes
    -----
    Pickles as its address alone, so that tasks carry it to other processes and machines.
    """

    url: str
    _root: str = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        root = self.url if "://" in self.url else str(Path(self.url).expanduser().absolute())
        object.__setattr__(self, "_root", root.removeprefix("file://").rstrip("/") or "/")

    @property
    def is_local(self) -> bool:
        """Whether the folder is on a local file system."""
        return "://" not in self._root

    @cached_property
    def _remote(self) -> tuple[Any, str]:
        import fsspec

        file_system, root = fsspec.core.url_to_fs(self._root)
        return file_system, root

    def __getstate__(self) -> dict[str, str]:
        """Leave open connections behind."""
        return {"url": self.url, "_root": self._root}

    def __setstate__(self, state: dict[str, str]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, value)

    def address(self, path: str = "") -> str:
        """Return the full address of a file of the folder, for messages and readers."""
        return f"{self._root}/{path}" if path else self._root

    def exists(self, path: str = "") -> bool:
        """Tell whether a file (or, without an argument, the folder) is there."""
        if self.is_local:
            return Path(self.address(path)).exists()
        file_system, root = self._remote
        return bool(file_system.exists(f"{root}/{path}" if path else root))

    def names(self, folder: str = "") -> list[str]:
        """List the file names directly in a sub-folder, sorted; an absent sub-folder is empty."""
        if self.is_local:
            place = Path(self.address(folder))
            return sorted(entry.name for entry in place.iterdir()) if place.is_dir() else []
        file_system, root = self._remote
        try:
            found = file_system.ls(f"{root}/{folder}" if folder else root, detail=False)
        except FileNotFoundError:
            return []
        return sorted(PurePosixPath(name).name for name in found)

    def size_bytes(self, path: str) -> int:
        """Return the size of a file."""
        if self.is_local:
            return Path(self.address(path)).stat().st_size
        file_system, root = self._remote
        return int(file_system.size(f"{root}/{path}"))

    def open(self, path: str) -> IO[bytes]:
        """Open a file for reading."""
        if self.is_local:
            return Path(self.address(path)).open("rb")
        file_system, root = self._remote
        opened: IO[bytes] = file_system.open(f"{root}/{path}", "rb")
        return opened

    def read_bytes(self, path: str) -> bytes:
        """Read a whole (small) file.

        Raises
        ------
        IntegrityError
            When the file is not there or cannot be read.
        """
        try:
            with self.open(path) as stream:
                return stream.read()
        except OSError as error:
            message = f"cannot read {self.address(path)!r}: {error.strerror or error}"
            raise IntegrityError(message) from error

    def write_bytes(self, path: str, content: bytes) -> None:
        """Write a whole file so that readers see all of it or nothing.

        Raises
        ------
        StorageError
            No space, no permission, a read-only place, or a path that leads out of the folder. Nothing is
            left behind under any name.
        """
        _refuse_escape(path, self._root)
        with named_failures(self.address(path)):
            if self.is_local:
                _write_atomic(Path(self.address(path)), content)
            else:
                file_system, root = self._remote
                file_system.makedirs(str(PurePosixPath(f"{root}/{path}").parent), exist_ok=True)
                file_system.pipe_file(f"{root}/{path}", content)

    def remove(self, path: str) -> None:
        """Remove a file; an absent one is no error."""
        with named_failures(self.address(path)):
            if self.is_local:
                Path(self.address(path)).unlink(missing_ok=True)
            elif self.exists(path):
                file_system, root = self._remote
                file_system.rm_file(f"{root}/{path}")

    def remove_empty(self, folder: str) -> None:
        """Remove a sub-folder when nothing is left in it."""
        if self.names(folder):
            return
        with contextlib.suppress(OSError, NotImplementedError):
            if self.is_local:
                Path(self.address(folder)).rmdir()
            elif folder:  # never the root, which may be a bucket; most object stores know no folders at all
                file_system, root = self._remote
                file_system.rmdir(f"{root}/{folder}")

    def require_folder(self) -> None:
        """Create the folder, or say why it cannot hold a data set.

        Raises
        ------
        StorageError
            When the folder cannot be made or written to.
        InputError
            When a file stands in its place.
        """
        if not self.is_local:
            return
        place = Path(self._root)
        probe = place / unfinished_name("probe")
        with named_failures(self._root):
            if place.exists() and not place.is_dir():
                message = (
                    f"{self._root!r} is a file, a folder was expected; choose another place (--out or OUT)"
                )
                raise InputError(message)
            place.mkdir(parents=True, exist_ok=True)
            probe.touch()
            probe.unlink()

    def remove_stale_temporaries(self, folder: str) -> None:
        """Remove what killed writers of this machine left half-written in a sub-folder."""
        for name in self.names(folder):
            if left_by_the_dead(name):
                self.remove(f"{folder}/{name}" if folder else name)


def _refuse_escape(path: str, root: str) -> None:
    """Refuse a path that leads out of the folder: names in stored data may be anybody's."""
    parts = PurePosixPath(path)
    if parts.is_absolute() or ".." in parts.parts or "\0" in path:
        message = f"{path!r} leads out of {root!r} or is no path; expected a path inside; nothing was written"
        raise StorageError(message)


def _write_atomic(place: Path, content: bytes) -> None:
    with atomic_file(place) as stream:
        stream.write(content)


@contextlib.contextmanager
def atomic_file(place: Path, *, durable: bool = True) -> Iterator[IO[bytes]]:
    """Open a local file for writing that appears under its name when all of it is on the disk, or never.

    Parameters
    ----------
    place : Path
        Where it is to stand; folders are made.
    durable : bool
        Flush it to the disk first; without, a power cut may leave damaged content under the name.

    Raises
    ------
    OSError
        As the file system raises it; nothing is left behind.
    """
    place.parent.mkdir(parents=True, exist_ok=True)
    temporary = place.parent / unfinished_name(place.name)
    try:
        with temporary.open("xb") as stream:
            yield stream
            if durable:
                stream.flush()
                os.fsync(stream.fileno())
        temporary.replace(place)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    if durable:
        _flush_folder(place.parent)


def _flush_folder(folder: Path) -> None:
    # A rename survives a power cut only once the folder itself is on the disk.
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextlib.contextmanager
def named_failures(address: str) -> Iterator[None]:
    """Turn the file system's errors about a place into a :class:`StorageError` that says what to do."""
    try:
        yield
    except OSError as error:
        hint = _HINTS.get(error.errno or 0, error.strerror or str(error))
        message = f"cannot write {address!r}: {hint}; nothing half-written was left, finished files stay"
        raise StorageError(message) from error


def folders_below(folder: DataFolder, place: str) -> Iterator[str]:
    """Yield a sub-folder and all folders inside it; none of a remote one, where no file is half-written."""
    if not folder.is_local:
        return
    root = folder.address()
    for found, _, _ in os.walk(folder.address(place)):
        yield os.path.relpath(found, root)


def remove_tree(folder: DataFolder, place: str) -> None:
    """Remove a sub-folder with all that it holds; an absent one is no error.

    Links are removed, and nothing that they lead to.

    Raises
    ------
    StorageError
        When something cannot be removed.
    """
    if folder.is_local and Path(folder.address(place)).is_symlink():
        folder.remove(place)
        return
    for name in folder.names(place):
        remove_tree(folder, f"{place}/{name}")
    folder.remove_empty(place)
    if folder.exists(place):
        folder.remove(place)
