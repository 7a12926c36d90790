"""The one seam through which data set folders are read and written.

Local folders and every fsspec address (``s3://...``, ``memory://...``) go through :class:`DataFolder`. A file
appears under its name complete or not at all: local files are written under a temporary name in the same
folder, flushed to disk and renamed; object stores put whole objects (:mod:`tactile_toolkit.store.remote`).
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import re
import shutil
import stat
import tempfile
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import IO, Any

from tactile_toolkit.errors import InputError, IntegrityError, StorageError
from tactile_toolkit.run.system import is_running, locked, machine_name, process_start, sync_folder
from tactile_toolkit.store.address import is_remote, place_of_data
from tactile_toolkit.store.remote import RemoteFolder

__all__ = [
    "FORSAKEN_S",
    "TEMPORARY_PREFIX",
    "VERSION_KEYS",
    "DataFolder",
    "atomic_file",
    "being_written",
    "expanded",
    "file_at",
    "folders_below",
    "is_stale",
    "is_there",
    "named_failures",
    "of_the_process",
    "open_regular",
    "readable",
    "remove_tree",
    "scratch_folder",
    "stale_files",
    "temporary_name",
]

TEMPORARY_PREFIX = ".writing-"
"""How the name of every unfinished file begins."""

_SCRATCH_PREFIX = "tactile-toolkit-"

FORSAKEN_S = 86_400.0
"""For so long nothing was written to a temporary file before it is taken for stale where nobody here can tell
whether its writer lives: it was on another machine, before this one was started anew, or in a container."""

_PROCESS = r"(?P<process>\d+)(?:\.(?P<began>\d+))?-[0-9a-f]+-"
_HERE = re.compile(_PROCESS)
_ANYWHERE = re.compile(rf".+?-{_PROCESS}")


def temporary_name(name: str, prefix: str = TEMPORARY_PREFIX) -> str:
    """Return a name, new each time, under which this process may write ``name`` until it is finished."""
    process = os.getpid()
    began = process_start(process)
    # Process ids are used again: with the start time, a stale file is told from one of a new process.
    writer = str(process) if began is None else f"{process}.{began}"
    return f"{prefix}{machine_name()}-{writer}-{uuid.uuid4().hex[:8]}-{name}"


def is_stale(name: str, prefix: str = TEMPORARY_PREFIX) -> bool:
    """Tell whether a name is that of a temporary file whose writer, on this machine, has ended."""
    here = f"{prefix}{machine_name()}-"
    writer = _HERE.match(name, len(here)) if name.startswith(here) else None
    if writer is None:
        return False
    process, began = int(writer["process"]), writer["began"]
    return not is_running(process) or (began is not None and began != process_start(process))


def _is_strangers(name: str, prefix: str) -> bool:
    """Tell whether a name is that of a temporary file of which nobody here knows whether its writer lives."""
    of_ours = name.startswith(f"{prefix}{machine_name()}-")
    return name.startswith(prefix) and not of_ours and bool(_ANYWHERE.match(name, len(prefix)))


def _now_s(folder: Path) -> float | None:
    """Return the time by the clock of the file system, maybe another machine's; None where that fails."""
    probe = folder / temporary_name("probe")
    try:
        with probe.open("xb"):
            return probe.stat().st_mtime
    except OSError:
        return None
    finally:
        with contextlib.suppress(OSError):
            probe.unlink(missing_ok=True)


def stale_files(
    folder: Path, prefix: str = TEMPORARY_PREFIX, *, forsaken_s: float = FORSAKEN_S
) -> Iterator[Path]:
    """Yield the stale temporary files (or folders) directly in a local folder.

    Of writers elsewhere those are stale that have not changed for ``forsaken_s`` by the file system's clock.
    """
    found = list(folder.glob(f"{prefix}*"))
    yield from (path for path in found if is_stale(path.name, prefix))
    strangers = [path for path in found if _is_strangers(path.name, prefix)]
    now_s = _now_s(folder) if strangers else None
    for path in strangers:
        with contextlib.suppress(FileNotFoundError):  # finished or removed meanwhile
            if now_s is not None and now_s - path.lstat().st_mtime >= forsaken_s:
                yield path


def being_written(folder: Path) -> list[Path]:
    """List the temporary files directly in a local folder whose writers are, or may be, at work."""
    stale = set(stale_files(folder))
    return sorted(path for path in folder.glob(f"{TEMPORARY_PREFIX}*") if path not in stale)


VERSION_KEYS = ("size", "ETag", "etag", "blob_id", "mtime", "created")
"""What stores say of a file, under which name each, that changes with its content."""

_TRIES = 10
_LOOK_AGAIN_S = 0.02
_NO_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK)
_READ_AT_ONCE = 16
"""Small files that are asked for at a time: a network file system or store answers many as fast as one."""
_READ_AHEAD = 512

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


@contextlib.contextmanager
def named_failures(address: str) -> Iterator[None]:
    """Turn the file system's errors about an address into a :class:`StorageError` that says what to do."""
    try:
        yield
    except OSError as error:
        hint = _HINTS.get(error.errno or 0, error.strerror or str(error))
        message = f"cannot write {address!r}: {hint}; nothing half-written was left, finished files stay"
        raise StorageError(message) from error


_OF_THE_PROCESS = {
    errno.EMFILE: "this process has too many open files; next: close some, or raise the limit (ulimit -n)",
    errno.ENFILE: "this machine has too many open files; next: end programs that are not needed",
    errno.ENOMEM: "the memory is used up; next: end programs that are not needed, or use fewer --workers",
    errno.EINTR: "the call was interrupted; next: run the same command again",
}


def of_the_process(error: Exception) -> str | None:
    """Return, in words, which lack of this process or machine an error is about; None for any other error."""
    if isinstance(error, MemoryError):
        return _OF_THE_PROCESS[errno.ENOMEM]
    return _OF_THE_PROCESS.get(error.errno or 0) if isinstance(error, OSError) else None


@contextlib.contextmanager
def readable(address: str) -> Iterator[None]:
    """Turn errors that are not about the content of a file or folder into InputError."""
    try:
        yield
    except PermissionError as error:
        message = (
            f"{address!r} cannot be read by this user (permission denied); next: change its permissions, or "
            "ask its owner to"
        )
        raise InputError(message) from error
    except (OSError, MemoryError) as error:
        lack = of_the_process(error)
        if lack is None:
            raise
        message = f"{address!r} cannot be read now: {lack}"
        raise InputError(message) from error


def is_there(path: Path) -> bool:
    """Tell whether there is such a file or folder; PermissionError where this user may not know.

    `Path.exists` says so too, but from Python 3.14 on it answers no.
    """
    try:
        path.stat()
    except PermissionError:
        raise
    except (OSError, ValueError):  # too long a name, a circle of links, a null byte
        return False
    return True


def expanded(place: str | Path, what: str = "path") -> Path:
    """Return a local path with ``~`` at its start as the home folder; InputError where none is known.

    Where the text as given has it later, as in ``./~``, the path is returned in full: pathlib drops the
    ``./``, and what expands the path again would then take the folder for the home folder.
    """
    path = Path(place)
    if not str(path).startswith("~"):
        return path
    if not str(place).startswith("~"):
        return path.absolute()
    try:
        return path.expanduser()
    except RuntimeError as error:
        message = f"{what} {str(place)!r}: no home folder is known ({error}); next: write the path in full"
        raise InputError(message) from error


def _new_file(path: Path) -> IO[bytes]:
    """Open a file that is not there yet for writing, making its folder."""
    for _ in range(_TRIES):
        path.parent.mkdir(parents=True, exist_ok=True)
        # Another run that has come to its end may remove an empty folder in between.
        with contextlib.suppress(FileNotFoundError):
            return path.open("xb")
    return path.open("xb")


def _create_file(path: Path, content: bytes) -> bool:
    """Write a whole local file unless there is one; tell whether this call did."""
    temporary = path.parent / temporary_name(path.name)
    try:
        with _new_file(temporary) as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        try:
            os.link(temporary, path)  # the one step that is all or nothing on network file systems too
        except FileExistsError:
            return temporary.stat().st_nlink == 2  # done, and the answer of the server was lost
        except OSError as error:
            if error.errno not in _NO_LINKS:
                raise
            with contextlib.suppress(FileExistsError), path.open("xb") as stream:
                stream.write(content)
                return True
            return False
    finally:
        temporary.unlink(missing_ok=True)
    sync_folder(path.parent)
    return True


def scratch_folder() -> Path:
    """Make a folder in ``$TMPDIR`` for the caller to remove; what killed processes left there is removed."""
    place = Path(tempfile.gettempdir())
    for path in place.glob(f"{_SCRATCH_PREFIX}*"):
        if is_stale(path.name, _SCRATCH_PREFIX):
            shutil.rmtree(path, ignore_errors=True)  # of other users it stays
    folder = place / temporary_name("scratch", _SCRATCH_PREFIX)
    with named_failures(str(folder)):
        folder.mkdir(mode=0o700)
    return folder


@contextlib.contextmanager
def atomic_file(path: Path, *, durable: bool = True) -> Iterator[IO[bytes]]:
    """Open a local file for writing that appears under its name when all of it is on the disk, or never.

    Folders are made. What is not ``durable`` is not flushed: a power cut may leave damaged content under the
    name. Raises OSError as the file system does; nothing is left behind.
    """
    temporary = path.parent / temporary_name(path.name)
    try:
        with _new_file(temporary) as stream:
            yield stream
            if durable:
                stream.flush()
                os.fsync(stream.fileno())
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    if durable:
        sync_folder(path.parent)


def open_regular(path: Path) -> IO[bytes]:
    """Open a local file for reading; IntegrityError for what is not one.

    A pipe would be waited for, and a device may have no end.
    """
    unwaiting = getattr(os, "O_NONBLOCK", 0)
    stream = open(path, "rb", opener=lambda name, flags: os.open(name, flags | unwaiting))  # noqa: SIM115
    if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
        stream.close()
        message = f"{str(path)!r} is not a file (it is a pipe or a device); nothing was read from it"
        raise IntegrityError(message)
    return stream


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
    def _remote(self) -> RemoteFolder:
        return RemoteFolder(self._root)

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

    def place(self, path: str) -> Path:
        """Return where a file of a local folder is written, moved or removed.

        Raises InputError where the file, or a folder on the way to it, is a symbolic link: what that leads to
        does not belong to this folder, which may be reached through a link itself.
        """
        place, root = Path(self.address(path)), Path(self._root)
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

    def _inside(self, path: str) -> str:
        """Return a path that was looked at by :meth:`address`, for the remote half."""
        self.address(path)
        return path

    def exists(self, path: str = "") -> bool:
        """Tell whether a file (or, without an argument, the folder) is there."""
        if self.is_local:
            # Who asks for the folder itself is about to write there, and says so.
            with readable(self.address(path)) if path else contextlib.nullcontext():
                return is_there(Path(self.address(path)))
        return self._remote.info(self._inside(path)) is not None

    def lacks(self, what: str) -> str:
        """Say what is wrong with a folder in which something was not found: it, or what was looked for."""
        address = self.address()
        if self.is_local and not Path(address).exists():
            return f"{address!r} does not exist"
        if self.is_local and not Path(address).is_dir():
            return f"{address!r} is a file, a folder was expected"
        if not self.is_local and not self._remote.has_bucket():
            return f"the bucket of {address!r} does not exist"
        return f"no {what} in {address!r}"

    def names(self, folder: str = "") -> list[str]:
        """List the file names directly in a sub-folder, sorted; an absent sub-folder is empty."""
        if self.is_local:
            path = Path(self.address(folder))
            with readable(str(path)), contextlib.suppress(FileNotFoundError, NotADirectoryError):
                return sorted(entry.name for entry in path.iterdir())
            return []
        return list(self._remote.entries(self._inside(folder)))

    def sizes(self, folder: str = "") -> dict[str, int]:
        """List the files directly in a sub-folder with their sizes in bytes, sorted by name, in one look."""
        if self.is_local:
            path = self.address(folder)
            sizes: dict[str, int] = {}
            with (
                readable(path),
                contextlib.suppress(FileNotFoundError, NotADirectoryError),
                os.scandir(path) as found,
            ):
                for entry in found:
                    with contextlib.suppress(FileNotFoundError):  # gone since it was listed
                        if entry.is_file():
                            sizes[entry.name] = entry.stat().st_size
            return dict(sorted(sizes.items()))
        entries = self._remote.entries(self._inside(folder))
        return {name: size for name, size in entries.items() if size is not None}

    def refresh(self, folder: str) -> None:
        """Have a network file system forget what it knows of a sub-folder: a file comes and goes in it."""
        if self.is_local and Path(self.address(folder)).is_dir():
            _now_s(self.place(folder))

    def size_bytes(self, path: str) -> int:
        """Return the size of a file."""
        if self.is_local:
            with readable(self.address(path)):
                return Path(self.address(path)).stat().st_size
        return int(self.facts(path)["size"])

    def open(self, path: str) -> IO[bytes]:
        """Open a file for reading; IntegrityError for what is not a file, such as a pipe or a device."""
        if self.is_local:
            with readable(self.address(path)):
                return open_regular(Path(self.address(path)))
        return self._remote.open(self._inside(path))

    def facts(self, path: str) -> Mapping[str, Any]:
        """Return what a remote store says of a file; raises FileNotFoundError."""
        found = self._remote.info(self._inside(path))
        if found is None:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), self.address(path))
        return found

    def version(self, path: str) -> tuple[object, ...] | None:
        """Return what changes whenever a file is replaced; None where there is none."""
        if not self.is_local:
            found = self._remote.info(self._inside(path))
            return (
                None
                if found is None
                else tuple(str(found.get(key)) for key in (*VERSION_KEYS, "LastModified"))
            )
        try:
            facts = Path(self.address(path)).stat()
        except OSError:
            return None
        return facts.st_ino, facts.st_size, facts.st_mtime_ns

    def read_bytes(self, path: str) -> bytes:
        """Read a whole (small) file; IntegrityError when it is not there or cannot be read."""
        try:
            if not self.is_local:
                return self._remote.read(self._inside(path))
            with self.open(path) as stream:
                return stream.read()
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
        """Write a whole file unless there is one of that name; tell whether this call did.

        Of several writers at once, on any machines, one wins. Raises as :meth:`write_bytes`.
        """
        if not self.is_local:
            return self._remote.create(self._inside(path), content)
        with named_failures(self.address(path)):
            return _create_file(self.place(path), content)

    def write_bytes(self, path: str, content: bytes) -> None:
        """Write a whole file so that readers see all of it or nothing.

        Raises StorageError for a path that leads out of the folder, and where the file system refuses; then
        nothing is left behind under any name.
        """
        if not self.is_local:
            self._remote.write(self._inside(path), content)
            return
        with named_failures(self.address(path)), atomic_file(self.place(path)) as stream:
            stream.write(content)

    @contextlib.contextmanager
    def writing(self, path: str) -> Iterator[IO[bytes]]:
        """Open a file to be written in pieces, which appears whole when all is written, or never.

        What goes to a store is put together in ``$TMPDIR`` first. Raises as :meth:`write_bytes`.
        """
        if self.is_local:
            with named_failures(self.address(path)), atomic_file(self.place(path)) as stream:
                yield stream
            return
        scratch = scratch_folder()
        try:
            file = scratch / "file"
            with named_failures(str(file)), file.open("wb") as stream:
                yield stream
            self.copy_in(path, file)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)

    def copy_in(self, path: str, source: Path) -> None:
        """Write a whole file of another place of this machine, as :meth:`write_bytes` does, in pieces."""
        if not self.is_local:
            self._remote.upload(self._inside(path), str(source))
            return
        target = self.place(path)
        with named_failures(str(target)), source.open("rb") as content, atomic_file(target) as stream:
            shutil.copyfileobj(content, stream, 1 << 20)

    def copy_out(self, path: str, target: Path) -> None:
        """Copy a file to a local one; FileNotFoundError where there is none."""
        target.parent.mkdir(parents=True, exist_ok=True)
        if self.is_local:
            shutil.copyfile(self.address(path), target)
        else:
            self._remote.download(self._inside(path), str(target))

    def remove(self, path: str) -> None:
        """Remove a file, if it is there."""
        if not self.is_local:
            self._remote.remove(self._inside(path))
            return
        with named_failures(self.address(path)):
            self.place(path).unlink(missing_ok=True)

    def rename(self, path: str, target: str) -> None:
        """Move a file or sub-folder of a local folder inside it, in one step."""
        with named_failures(self.address(target)):
            self.place(path).rename(self.place(target))

    def remove_empty(self, folder: str) -> None:
        """Remove a sub-folder when nothing is left in it; in object stores it has gone with its last file."""
        path = self.address(folder)
        if self.is_local and not self.names(folder):
            with contextlib.suppress(OSError):
                Path(path).rmdir()

    def require_folder(self) -> None:
        """Create the folder, and prove that it can be written to; a bucket must be there.

        Raises StorageError where it cannot, RemoteError where a store refuses or does not answer, and
        InputError when a file stands in its place or there is no such bucket.
        """
        if not self.is_local:
            self._remote.require_writable()
            return
        path = Path(self._root)
        probe = path / temporary_name("probe")
        with named_failures(self._root):
            if path.exists() and not path.is_dir():
                message = (
                    f"{self._root!r} is a file, a folder was expected; choose another path (--out or OUT)"
                )
                raise InputError(message)
            path.mkdir(parents=True, exist_ok=True)
            probe.touch()
            probe.unlink()

    @contextlib.contextmanager
    def locked(self, *, shared: bool = False, patience_s: float = math.inf) -> Iterator[None]:
        """Hold a local folder against other runs; stores have no locks.

        What a run changes there it changes under the lock, its shards under a ``shared`` one. Raises
        InputError when other runs have held it for so long.
        """
        with contextlib.ExitStack() as held:
            deadline_s = time.monotonic() + patience_s
            while self.is_local:
                try:
                    held.enter_context(locked(Path(self._root), wait=False, shared=shared))
                    break
                except FileNotFoundError:  # a run that failed has removed it, empty as it was
                    with named_failures(self._root):
                        Path(self._root).mkdir(parents=True, exist_ok=True)
                except BlockingIOError as error:
                    if time.monotonic() >= deadline_s:
                        message = (
                            f"another run writes to {self._root!r}, and has done so for {patience_s:.0f} s; "
                            "nothing was changed; next: wait until it has ended, or end it, and run the same "
                            "command again"
                        )
                        raise InputError(message) from error
                    time.sleep(_LOOK_AGAIN_S)
            yield

    def remove_stale_files(self, folder: str, *, forsaken_s: float = FORSAKEN_S) -> None:
        """Remove the stale temporary files in a sub-folder, see :func:`stale_files`."""
        if self.is_local:  # object stores put whole objects
            for path in stale_files(self.place(folder), forsaken_s=forsaken_s):
                self.remove(f"{folder}/{path.name}" if folder else path.name)


def file_at(place: str) -> tuple[DataFolder, str]:
    """Return the folder of a file, local or at an address, and its name there."""
    if is_remote(place):
        parent, _, name = place_of_data(place).rpartition("/")
        return DataFolder(parent), name
    path = Path(place_of_data(place))
    return DataFolder(str(path.parent)), path.name


def folders_below(folder: DataFolder, path: str) -> Iterator[str]:
    """Yield a sub-folder and all folders inside it; none of a remote one, where no file is half-written."""
    if not folder.is_local:
        return
    root = folder.address()
    for found, _, _ in os.walk(folder.address(path)):
        yield os.path.relpath(found, root)


def remove_tree(folder: DataFolder, path: str) -> None:
    """Remove a sub-folder, if it is there, with all that it holds; raises as ``remove`` for a link."""
    for name in folder.names(path):
        remove_tree(folder, f"{path}/{name}")
    folder.remove_empty(path)
    if folder.exists(path):
        folder.remove(path)
