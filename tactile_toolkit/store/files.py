"""Single local files: written completely or not at all; and plain-language messages for OS errors."""

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
"""Start of the names of unfinished files, as a pattern; a file without such a number may be a user's."""

T = TypeVar("T")

_TRIES = 10
_BUFFER_BYTES = 1 << 13
# Flags to open a file for flushing: Windows flushes only files that are open for writing.
_FLUSHABLE = {"nt": os.O_RDWR}.get(os.name, os.O_RDONLY)
_OF_THE_PROCESS = (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EINTR)


@contextlib.contextmanager
def named_failures(address: str) -> Iterator[None]:
    """Turn the file system's errors about an address into a :class:`StorageError` that says what to do."""
    try:
        yield
    except OSError as error:
        raise StorageError(
            f"cannot write {address!r}: {error.strerror or error}; no partial file remains, finished "
            "files are kept",
            next="make room there, or change its permissions, and run the same command again; or choose "
            "another folder (--out or OUT)",
        ) from error


def resource_shortage(error: Exception) -> str | None:
    """Return a message for an error of scarce resources (memory, file handles); None for other errors."""
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
    """Turn errors that do not concern the content of a file or folder into InputError."""
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
    """Return whether a file or folder exists; PermissionError if this user may not look it up.

    In that case, `Path.exists` returns False from Python 3.14 on.
    """
    try:
        path.stat()
    except PermissionError:
        raise
    except (OSError, ValueError):  # too long a name, a circle of links, a null byte
        return False
    return True


def expanded(place: str | Path, what: str = "path") -> Path:
    """Return a local path in which a leading ``~`` is expanded; InputError if no home folder is known.

    An address that may contain a key is an InputError, too. For ``./~``, a folder that is called ``~``, the
    absolute path is returned: pathlib drops the ``./``, and a second expansion would give the home folder.
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


def open_regular(path: str | Path, below: Path | None = None) -> IO[bytes]:
    """Open a regular local file for reading; IntegrityError for any other, or a link out of ``below``.

    Reading a pipe would wait, and a device may have no end. ``below`` is a folder with untrusted files: a
    link in it may lead to a file that only this user can read.
    """
    # Not `Path.resolve`, which fails for circular links.
    if below is not None and not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(below)):
        raise IntegrityError(f"{str(path)!r} is a link out of {str(below)!r}; nothing was read from it")
    non_blocking = getattr(os, "O_NONBLOCK", 0)
    # Without a buffer size, Python checks whether the file is a terminal.
    stream = open(  # noqa: SIM115
        path, "rb", _BUFFER_BYTES, opener=lambda name, flags: os.open(name, flags | non_blocking)
    )
    if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
        stream.close()
        raise IntegrityError(
            f"{str(path)!r} is not a file (it is a pipe or a device); nothing was read from it"
        )
    return stream


def sync_file(path: Path) -> None:
    """Flush a file to the disk, so that a power cut does not empty it."""
    handle = os.open(path, _FLUSHABLE)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sync_folder(folder: Path) -> None:
    """Flush the entries of a folder to the disk, so that a rename survives a power cut."""
    if os.name == "nt":  # Windows cannot open folders
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def make_folder(path: Path) -> None:
    """Make a folder and its parents, although other writers may remove empty folders at the same time."""
    for _ in range(_TRIES):
        # pathlib raises FileExistsError if the folder is removed between its attempt and its check.
        with contextlib.suppress(FileExistsError, FileNotFoundError):
            path.mkdir(parents=True, exist_ok=True)
            return
    path.mkdir(parents=True, exist_ok=True)


def new_file(path: Path) -> IO[bytes]:
    """Create a file and its folder, and open it for writing."""
    for _ in range(_TRIES):
        # Another run that ends may remove an empty folder in between.
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
    """Write a local file, which appears under its name complete or not at all.

    ``fill`` writes to a stream; its result is returned. If the temporary file ``draft`` is removed, it is
    written again. Parent folders are made. Without ``durable`` the file is not flushed: a power cut may leave
    damaged content under its name. Raises OSError; only a process that is killed leaves a temporary file.
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
    """Return a new temporary path next to a file or folder."""
    return path.with_name(f"{TEMPORARY_PREFIX}{uuid.uuid4().hex}-{path.name}")


def remove_drafts(folder: Path) -> None:
    """Remove the temporary files directly in a local folder; their writers write them again."""
    for path in folder.iterdir():
        with contextlib.suppress(OSError):  # it belongs to another user
            if re.match(DRAFT, path.name):
                path.unlink()


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """Make a folder in ``$TMPDIR`` that is removed at the end."""
    with contextlib.ExitStack() as stack:
        with named_failures(tempfile.gettempdir()):
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="tactile-toolkit-"))
        yield Path(folder)
