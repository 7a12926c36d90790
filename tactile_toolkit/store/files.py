"""Single local files: written completely or not at all, and what the system says in words."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import stat
import tempfile
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, TypeVar

from tactile_toolkit.errors import InputError, IntegrityError, StorageError, require_public

TEMPORARY_PREFIX = ".writing-"
DRAFT = re.escape(TEMPORARY_PREFIX) + "[0-9a-f]{32}-"
"""How the name of every unfinished file begins, as a pattern: what has no such number may be any user's."""

T = TypeVar("T")

_TRIES = 10
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

    An address that may hold a key is an InputError, too. Where the text as given has the ``~`` later, as in
    ``./~``, the path is returned in full: pathlib drops the ``./``, and what expands the path again would
    then take the folder for the home folder.
    """
    require_public(str(place))
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
    draft = draft or draft_of(path)
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


def draft_of(path: Path) -> Path:
    """Return a new temporary name next to a file or folder."""
    return path.with_name(f"{TEMPORARY_PREFIX}{uuid.uuid4().hex}-{path.name}")


def remove_drafts(folder: Path) -> None:
    """Remove the temporary files directly in a local folder; one that is being written is written again."""
    for path in folder.iterdir():
        with contextlib.suppress(OSError):  # of other users it stays
            if re.match(DRAFT, path.name):
                path.unlink()


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """Make a folder in ``$TMPDIR`` that goes at the end."""
    with contextlib.ExitStack() as stack:
        with named_failures(tempfile.gettempdir()):
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="tactile-toolkit-"))
        yield Path(folder)
