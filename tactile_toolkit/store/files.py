"""Single local files: locked, written completely or not at all, and what the system says in words.

No other module of the project imports what only some systems have, but for signals.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import re
import stat
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import IO, Any, TypeVar

from tactile_toolkit.errors import InputError, IntegrityError, StorageError

TEMPORARY_PREFIX = ".writing-"
"""How the name of every unfinished file begins."""
LOCK_FILE = ".lock"
"""Is in a folder while a process holds it where the system or the file system knows no locks of folders."""

T = TypeVar("T")

_LOOK_AGAIN_S = 0.02
_TRIES = 10
# Follows the prefix: what has none may be any user's.
_UNIQUE = re.compile("[0-9a-f]{32}-")
_OF_THE_PROCESS = (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EINTR)


@contextlib.contextmanager
def named_failures(address: str) -> Iterator[None]:
    """Turn the file system's errors about an address into a :class:`StorageError` that says what to do."""
    try:
        yield
    except OSError as error:
        raise StorageError(
            f"cannot write {address!r}: {error.strerror or error}; nothing half-written was left, finished "
            "files stay",
            next="make room there, or change its permissions, and run the same command again; or choose "
            "another folder (--out or OUT)",
        ) from error


def resource_shortage(error: Exception) -> str | None:
    """Return, in words, of what this process or machine has too little; None for any other error."""
    if isinstance(error, MemoryError):
        error = OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))
    if not isinstance(error, OSError) or error.errno not in _OF_THE_PROCESS:
        return None
    return (
        f"{error.strerror}; next: end programs that are not needed, raise the limit of open files "
        "(ulimit -n) or use fewer --workers, and run it again"
    )


@contextlib.contextmanager
def readable(address: str) -> Iterator[None]:
    """Turn errors that are not about the content of a file or folder into InputError."""
    try:
        yield
    except (OSError, MemoryError) as error:
        reason = resource_shortage(error)
        if isinstance(error, PermissionError):
            reason = "permission denied; next: change its permissions, or ask its owner to"
        if reason is None:
            raise
        raise InputError(f"{address!r} cannot be read: {reason}") from error


def path_exists(path: Path) -> bool:
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


def open_regular(path: Path, below: Path | None = None) -> IO[bytes]:
    """Open a local file for reading; IntegrityError for what is not one, or a link out of a folder.

    A pipe would be waited for, and a device may have no end. ``below`` is a folder whose files are of anyone:
    a link in it may lead to what its reader alone can read.
    """
    # Not `Path.resolve`, which fails for links in a circle.
    if below is not None and not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(below)):
        raise IntegrityError(f"{str(path)!r} is a link out of {str(below)!r}; nothing was read from it")
    unwaiting = getattr(os, "O_NONBLOCK", 0)
    stream = open(path, "rb", opener=lambda name, flags: os.open(name, flags | unwaiting))  # noqa: SIM115
    if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
        stream.close()
        raise IntegrityError(
            f"{str(path)!r} is not a file (it is a pipe or a device); nothing was read from it"
        )
    return stream


@contextlib.contextmanager
def locked(path: Path, *, shared: bool = False, patience_s: float = math.inf) -> Iterator[None]:
    """Wait for the lock of a file, which is made, or of a folder that is there, and hold it.

    Held by the open file: threads wait for one another too, and a killed process lets go. Any number hold it
    ``shared`` at once, where the system knows that. A folder that cannot be locked is held by a file in it,
    which a killed process leaves; for a file that cannot be locked, no one waits. Raises OSError where the
    file cannot be opened, BlockingIOError where another has held it for so long, and FileNotFoundError for a
    folder that was removed meanwhile.
    """
    deadline_s = time.monotonic() + patience_s
    with contextlib.ExitStack() as stack:
        while True:
            try:
                stack.enter_context(_locked_now(path, shared))
                break
            except BlockingIOError:
                if time.monotonic() >= deadline_s:
                    raise
                time.sleep(_LOOK_AGAIN_S)
        yield


@contextlib.contextmanager
def _locked_now(path: Path, shared: bool) -> Iterator[None]:
    fcntl, msvcrt, is_folder = _module("fcntl"), _module("msvcrt"), path.is_dir()
    needs_file = is_folder and fcntl is None  # Windows opens no folders
    with contextlib.ExitStack() as stack:
        if not needs_file:
            handle = os.open(path, os.O_RDONLY if is_folder else os.O_RDWR | os.O_CREAT, 0o666)
            stack.callback(os.close, handle)
            try:
                if fcntl is not None:
                    fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
                    # Not left to closing: a child forked meanwhile has the file open too.
                    stack.callback(fcntl.flock, handle, fcntl.LOCK_UN)
                elif msvcrt is not None:
                    msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
            except OSError as error:
                if isinstance(error, BlockingIOError) or fcntl is None:
                    raise BlockingIOError from error
                needs_file = is_folder
            if is_folder and not os.path.samestat(os.fstat(handle), path.stat()):
                raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
        if needs_file:
            stack.enter_context(_lock_file(path / LOCK_FILE))
        yield


@contextlib.contextmanager
def _lock_file(path: Path) -> Iterator[None]:
    try:
        path.open("xb").close()
    except (FileExistsError, PermissionError) as error:  # Windows refuses what is being removed
        if isinstance(error, PermissionError) and os.name != "nt":
            raise
        raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN), str(path)) from error
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def _module(name: str) -> Any:
    """Return a module of Python's that this system may not have."""
    try:
        return import_module(name)
    except ImportError:
        return None


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk: a rename survives a power cut only once they are there."""
    if os.name == "nt":  # Windows opens no folders
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def make_folder(path: Path) -> None:
    """Make a folder and those above it, where other writers may remove empty ones at the same time."""
    for _ in range(_TRIES):
        # pathlib says that the folder exists where it goes between its attempt and its look at what is there.
        with contextlib.suppress(FileExistsError, FileNotFoundError):
            path.mkdir(parents=True, exist_ok=True)
            return
    path.mkdir(parents=True, exist_ok=True)


def new_file(path: Path) -> IO[bytes]:
    """Open a file that is not there yet for writing, making its folder."""
    for _ in range(_TRIES):
        # Another run that has come to its end may remove an empty folder in between.
        with contextlib.suppress(FileNotFoundError):
            return path.open("xb")
        make_folder(path.parent)
    return path.open("xb")


def write_file(
    path: Path,
    fill: Callable[[IO[bytes]], T],
    draft: Path | None = None,
    *,
    durable: bool = True,
    publish: Callable[[Path, Path], object] = lambda draft, path: draft.replace(path),
) -> T:
    """Write a local file, which appears under its name when all of it is there, or never.

    ``fill`` writes to a stream, and what it returns is returned. Any program may remove the temporary file,
    ``draft``: it is written again. Folders are made. What is not ``durable`` is not flushed: a power cut may
    leave damaged content under the name. Raises OSError as the file system does; nothing is left behind but
    by a process that is killed.
    """
    draft = draft or path.with_name(f"{TEMPORARY_PREFIX}{uuid.uuid4().hex}-{path.name}")
    for tries_left in reversed(range(_TRIES)):
        try:
            with new_file(draft) as stream:
                filled = fill(stream)
                stream.flush()
                if durable:
                    os.fsync(stream.fileno())
            make_folder(path.parent)
            publish(draft, path)
            break
        except FileNotFoundError:
            if not tries_left:
                raise
        finally:
            with contextlib.suppress(FileNotFoundError, NotADirectoryError):
                draft.unlink()
    if durable:
        sync_folder(path.parent)
    return filled


def remove_drafts(folder: Path) -> None:
    """Remove the temporary files directly in a local folder; one that is being written is written again."""
    for path in folder.glob(f"{TEMPORARY_PREFIX}*"):
        with contextlib.suppress(OSError):  # of other users it stays
            if _UNIQUE.match(path.name, len(TEMPORARY_PREFIX)):
                path.unlink()


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """Make a folder in ``$TMPDIR`` that goes at the end."""
    with contextlib.ExitStack() as stack:
        with named_failures(tempfile.gettempdir()):
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="tactile-toolkit-"))
        yield Path(folder)
