"""Names of files, and single local files: written completely or not at all, with plain-language errors.

A name from outside decides what is read, overwritten or deleted.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import stat
import tempfile
import unicodedata
import uuid
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import IO, TypeVar

from tactile_toolkit import errors, wording

TEMPORARY_PREFIX = ".writing-"
DRAFT = re.escape(TEMPORARY_PREFIX) + "[0-9a-f]{32}-"
"""Start of the names of unfinished files, as a pattern; a file without such a number may be a user's."""

T = TypeVar("T")

_TRIES = 10
_BUFFER_BYTES = 1 << 13
# Flags to open a file for flushing: Windows flushes only files that are open for writing.
_FLUSHABLE = {"nt": os.O_RDWR}.get(os.name, os.O_RDONLY)

_LONGEST_BYTES = 1024
# File systems take 255 bytes; while a file is written, its name has a prefix.
_LONGEST_PART_BYTES = 150
_DEVICE = r"(?:con|prn|aux|nul|conin\$|conout\$|(?:com|lpt)[0-9¹²³])\s*(?:[.:/]|\Z)"
_SHOWN = 80
_STEPS = frozenset({".", ".."})
# Files that systems leave in folders and archives, in lower case; names with a leading dot are hidden anyway.
_LEFT_BY_SYSTEMS = frozenset(
    {
        "__macosx",
        "@eadir",
        "#recycle",
        "$recycle.bin",
        "system volume information",
        "thumbs.db",
        "ehthumbs.db",
        "desktop.ini",
    }
)

# One search for the whole path: an import asks for 50,000 of them.
leads_elsewhere = re.compile(rf"\A/|[\0\\]|(?:\A|/)(?:\.\.(?:/|\Z)|[a-z]:|{_DEVICE})", re.IGNORECASE).search
"""Matches a path with slashes that leads out of a folder, or to a drive or a device, on any system.

Windows takes a backslash for a slash, and some names for devices, in every folder and with every ending.
"""


def is_hidden(path: str) -> bool:
    """Return whether listings skip a relative path, with slashes.

    They do if a part of the path begins with a dot (``._a.png``, ``.DS_Store``) or is one that systems
    leave in folders and archives (``__MACOSX``, ``@eaDir``, ``Thumbs.db``, ``desktop.ini``, ...). A path that
    leads elsewhere (``../a.png``) is not hidden, but wrong.
    """
    return any(map(_is_hidden_part, path.split("/")))


@lru_cache(maxsize=1024)
def _is_hidden_part(part: str) -> bool:
    return (part[:1] == "." and part not in _STEPS) or part.lower() in _LEFT_BY_SYSTEMS


def problem_of_name(name: object) -> str:
    """Return why a path with slashes cannot name a file of a data set; empty if it can."""
    is_plain = (
        isinstance(name, str)
        and name.isprintable()
        and len(name.encode(errors="replace")) <= _LONGEST_BYTES
        and all(map(_is_plain_part, name.split("/")))
    )
    if is_plain:
        return ""
    return "is not the plain relative path of a visible file on every system"


@lru_cache(maxsize=1024)  # most files of a folder have its name in common
def _is_plain_part(part: str) -> bool:
    return not (
        part.startswith(".")
        or part.endswith((".", " "))
        or leads_elsewhere(part)
        or not 0 < len(part.encode(errors="replace")) <= _LONGEST_PART_BYTES
    )


def names_inside(names: Iterable[object], source: str) -> tuple[str, ...]:
    """Return names of files without repetition, if each can name a file in a data set folder.

    ``source`` says in the message who gave the names. Raises IntegrityError for a name that leads out of the
    folder, is hidden, or is not valid on every system, and for two names of one file where case does not
    count.
    """
    names_by_key: dict[str, str] = {}
    for name in names:
        problem = problem_of_name(name)
        if not problem:
            text = str(name)
            first = names_by_key.setdefault(unicodedata.normalize("NFC", text).casefold(), text)
            problem = "" if first == text else f"is the same file as {first!r} where case does not count"
        if problem:
            raise errors.IntegrityError(
                f"{source} names the file {wording.shortened(ascii(name), _SHOWN)}, which {problem}; "
                "nothing was done with it",
                next="do not use this data set, or ask who made it",
            )
    return tuple(names_by_key.values())


@contextlib.contextmanager
def named_failures(address: str) -> Iterator[None]:
    """Turn the file system's errors about an address into a :class:`StorageError` that says what to do."""
    try:
        yield
    except OSError as error:
        raise errors.StorageError(
            f"cannot write {address!r}: {error.strerror or error}; no partial file remains, finished "
            "files are kept",
            next="make room there, or change its permissions, and run the same command again; or choose "
            "another folder (--out or OUT)",
        ) from error


def unreadable(address: str, error: Exception) -> errors.InputError | None:
    """Return the error for a file or folder that cannot be read for another reason than its content."""
    reason = errors.resource_shortage(error)
    if isinstance(error, PermissionError):
        reason = "permission denied; next: change its permissions, or ask its owner to"
    return None if reason is None else errors.InputError(f"{address!r} cannot be read: {reason}")


@contextlib.contextmanager
def readable(address: str) -> Iterator[None]:
    """Turn errors that do not concern the content of a file or folder into InputError."""
    try:
        yield
    except (OSError, MemoryError) as error:
        refused = unreadable(address, error)
        if refused is None:
            raise
        raise refused from error


def expanded(path: str | Path, what: str = "path") -> Path:
    """Return a local path in which a leading ``~`` is expanded; InputError if no home folder is known.

    An address that may contain a key is an InputError, too. For ``./~``, a folder that is called ``~``, the
    absolute path is returned: pathlib drops the ``./``, and a second expansion would give the home folder.
    """
    text, local = str(path), Path(path)
    if ":" in text:
        errors.require_public(text)
    if not str(local).startswith("~"):
        return local
    if not text.startswith("~"):
        return local.absolute()
    try:
        return local.expanduser()
    except RuntimeError as error:
        raise errors.InputError(
            f"{what} {text!r}: no home folder is known ({error})", next="write the path in full"
        ) from error


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


def open_regular(path: str | Path, below: Path | None = None) -> IO[bytes]:
    """Open a regular local file for reading; IntegrityError for any other, or a link out of ``below``.

    Reading a pipe would wait, and a device may have no end. ``below`` is a folder with untrusted files: a
    link in it may lead to a file that only this user can read.
    """
    # Not `Path.resolve`, which fails for circular links.
    if below is not None and not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(below)):
        raise errors.IntegrityError(
            f"{str(path)!r} is a link out of {str(below)!r}; nothing was read from it"
        )
    non_blocking = getattr(os, "O_NONBLOCK", 0)
    # Without a buffer size, Python checks whether the file is a terminal.
    stream = open(  # noqa: SIM115
        path, "rb", _BUFFER_BYTES, opener=lambda name, flags: os.open(name, flags | non_blocking)
    )
    if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
        stream.close()
        raise errors.IntegrityError(
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
    if os.name != "nt":  # Windows cannot open folders
        sync_file(folder)


def make_folder(path: Path) -> None:
    """Make a folder and its parents, although other writers may remove empty folders at the same time."""
    for _ in range(_TRIES):
        # pathlib raises FileExistsError if the folder is removed between its attempt and its check.
        with contextlib.suppress(FileExistsError, FileNotFoundError):
            path.mkdir(parents=True, exist_ok=True)
            return
    if path.is_file():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path))
    path.mkdir(parents=True, exist_ok=True)


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
            make_folder(draft.parent)
            with draft.open("xb") as stream:
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
