"""Single local files: written as a whole or not at all, and what the system says in words.

A temporary file or folder outside a data set is held by who writes it: what is not held is removed by the
next one who comes by.
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
from pathlib import Path
from typing import IO

from tactile_toolkit.errors import InputError, IntegrityError, StorageError
from tactile_toolkit.run.system import held, sync_folder

TEMPORARY_PREFIX = ".writing-"
"""How the name of every unfinished file begins."""

_SCRATCH_PREFIX = "tactile-toolkit-"
_TRIES = 10
_UNIQUE = re.compile("[0-9a-f]{32}-")
"""Follows the prefix: what has none may be any user's."""

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
_OF_THE_PROCESS = {
    errno.EMFILE: "this process has too many open files; next: close some, or raise the limit (ulimit -n)",
    errno.ENFILE: "this machine has too many open files; next: end programs that are not needed",
    errno.ENOMEM: "the memory is used up; next: end programs that are not needed, or use fewer --workers",
    errno.EINTR: "the call was interrupted; next: run the same command again",
}


@contextlib.contextmanager
def named_failures(address: str) -> Iterator[None]:
    """Turn the file system's errors about an address into a :class:`StorageError` that says what to do."""
    try:
        yield
    except OSError as error:
        hint = _HINTS.get(error.errno or 0, error.strerror or str(error))
        raise StorageError(
            f"cannot write {address!r}: {hint}; nothing half-written was left, finished files stay"
        ) from error


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
    except (OSError, MemoryError) as error:
        lack = f"now: {of_the_process(error)}"
        if isinstance(error, PermissionError):
            lack = "by this user (permission denied); next: change its permissions, or ask its owner to"
        elif of_the_process(error) is None:
            raise
        raise InputError(f"{address!r} cannot be read {lack}") from error


def is_there(path: Path) -> bool:
    """Return whether there is such a file or folder; PermissionError where this user may not know.

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
        raise InputError(
            f"{what} {str(place)!r}: no home folder is known ({error})", next="write the path in full"
        ) from error


def open_regular(path: Path) -> IO[bytes]:
    """Open a local file for reading; IntegrityError for what is not one.

    A pipe would be waited for, and a device may have no end.
    """
    unwaiting = getattr(os, "O_NONBLOCK", 0)
    stream = open(path, "rb", opener=lambda name, flags: os.open(name, flags | unwaiting))  # noqa: SIM115
    if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
        stream.close()
        raise IntegrityError(
            f"{str(path)!r} is not a file (it is a pipe or a device); nothing was read from it"
        )
    return stream


def new_file(path: Path) -> IO[bytes]:
    """Open a file that is not there yet for writing, making its folder."""
    for _ in range(_TRIES):
        # Another run that has come to its end may remove an empty folder in between.
        with contextlib.suppress(FileNotFoundError):
            return path.open("xb")
        path.parent.mkdir(parents=True, exist_ok=True)
    return path.open("xb")


@contextlib.contextmanager
def temporary(
    folder: Path, name: str, make: Callable[[Path], object], prefix: str = TEMPORARY_PREFIX
) -> Iterator[Path]:
    """Make a temporary file or folder, and hold it until it has been moved, or is removed."""
    with contextlib.ExitStack() as stack:
        while True:
            path = folder / f"{prefix}{uuid.uuid4().hex}-{name}"
            stack.callback(_remove, path)
            make(path)
            # Somebody may have come by before it was held.
            with contextlib.suppress(FileNotFoundError):
                stack.enter_context(held(path))
                if path.exists():
                    break
        yield path


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def remove_abandoned(folder: Path, prefix: str = TEMPORARY_PREFIX) -> None:
    """Remove the temporary files and folders directly in a local folder that are not held any more."""
    for path in folder.glob(f"{prefix}*"):
        with contextlib.suppress(OSError):  # of other users it stays
            if _UNIQUE.match(path.name, len(prefix)):
                with held(path, wait=False) as is_ours:
                    if is_ours:
                        _remove(path)


@contextlib.contextmanager
def atomic_file(path: Path, *, durable: bool = True) -> Iterator[IO[bytes]]:
    """Open a local file for writing that appears under its name when all of it is on the disk, or never.

    Folders are made. What is not ``durable`` is not flushed: a power cut may leave damaged content under the
    name. Raises OSError as the file system does; nothing is left behind.
    """
    with temporary(path.parent, path.name, lambda made: new_file(made).close()) as made:
        with made.open("wb") as stream:
            yield stream
            if durable:
                stream.flush()
                os.fsync(stream.fileno())
        made.replace(path)
    if durable:
        sync_folder(path.parent)


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """Make a folder in ``$TMPDIR`` that goes at the end, with those that killed processes left there."""
    place = Path(tempfile.gettempdir())
    remove_abandoned(place, _SCRATCH_PREFIX)
    with contextlib.ExitStack() as stack:
        with named_failures(str(place)):
            folder = stack.enter_context(
                temporary(place, "scratch", lambda path: path.mkdir(mode=0o700), _SCRATCH_PREFIX)
            )
        yield folder
