"""Locks of files and folders: how long to wait for one, and which process holds it.

No other module of the project imports modules that only some systems have, except for signals.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shlex
import socket
import sys
import time
from collections.abc import Iterator
from importlib import import_module
from itertools import takewhile
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from tactile_toolkit.errors import BusyError, IntegrityError, redact
from tactile_toolkit.store.files import open_regular

LOCK_FILE = ".lock"
"""File that is locked, or marks its folder as held, where the system cannot lock folders."""
PATIENCE_S = 60.0
"""Time limit for a lock, seconds; a stopped process (Ctrl-Z) never releases the one it holds."""

_LOOK_AGAIN_S = 0.02
_STOPPED, _AT_WORK = ("T", "t"), ("R", "S", "D")  # process states of Linux
_LONGEST_NOTE_BYTES = 300
_LONGEST_COMMAND = 60
# On Windows, a locked byte cannot be read: this one lies behind the name of the holder.
_LOCKED_BYTE = 1 << 20


@contextlib.contextmanager
def locked(
    path: Path, *, shared: bool = False, patience_s: float | None = None, is_patient: bool = False
) -> Iterator[None]:
    """Wait for the lock of a file, which is created, or of an existing folder, and hold it.

    The lock belongs to the open file: threads wait for one another too, and a killed process releases it. Any
    number of processes hold it ``shared`` at once, except on Windows, which knows no such locks. There a
    folder is locked by a file in it. A folder of a file system without locks is held by a file that a killed
    process leaves behind; a file that cannot be locked is not waited for.

    Raises BusyError, which names the holder, after ``patience_s`` (:data:`PATIENCE_S` by default); with
    ``is_patient`` it waits on while the holder is known to be at work. Raises OSError if the file cannot be
    opened, and FileNotFoundError for a folder that was removed meanwhile.
    """
    if patience_s is None:
        patience_s = PATIENCE_S
    deadline_s = time.monotonic() + patience_s
    with contextlib.ExitStack() as stack:
        while True:
            try:
                stack.enter_context(_locked_now(path, shared))
                break
            except BlockingIOError as error:
                if time.monotonic() >= deadline_s:
                    holders = _holders_of(path)
                    if not (is_patient and holders and all(holder.state in _AT_WORK for holder in holders)):
                        raise _busy(path, holders, patience_s) from error
                    deadline_s += patience_s
                time.sleep(_LOOK_AGAIN_S)
        yield


class _Holder(NamedTuple):
    pid: str
    host: str

    @property
    def state(self) -> str:
        """State of the process, a letter; empty if it is not known, as on another machine."""
        with contextlib.suppress(OSError, IndexError):
            if self.host == socket.gethostname():
                return Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()[0]
        return ""

    def __str__(self) -> str:
        name = f"process {self.pid} on {self.host}"
        if self.state:
            with contextlib.suppress(OSError):
                first, *words = os.fsdecode(Path(f"/proc/{self.pid}/cmdline").read_bytes()).split("\0")
                # No options: they may hold secrets.
                shown = [Path(first).name, *takewhile(lambda word: word[:1] not in ("-", ""), words)]
                return f"{name} (`{redact(shlex.join(shown))[:_LONGEST_COMMAND]}`)"
        return name


def _holders_of(path: Path) -> list[_Holder]:
    """Return the holders of the lock of a file or folder; empty if they are not known."""
    with contextlib.suppress(OSError, ValueError, IntegrityError):
        with (
            contextlib.suppress(FileNotFoundError, NotADirectoryError),
            open_regular(path / LOCK_FILE) as note,
        ):
            pid, host = note.read(_LONGEST_NOTE_BYTES).decode().split()
            return [_Holder(str(int(pid)), host)]
        if sys.platform == "linux":
            status = path.stat()
            name = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
            # A line is "1: FLOCK  ADVISORY  WRITE 4711 fe:00:2146526 0 EOF"; if it waits, "1: -> FLOCK ...".
            lines = [line.split() for line in Path("/proc/locks").read_text(encoding="ascii").splitlines()]
            return [_Holder(line[4], socket.gethostname()) for line in lines if line[1::4] == ["FLOCK", name]]
    return []


def _busy(path: Path, holders: list[_Holder], patience_s: float) -> BusyError:
    stopped = [holder for holder in holders if holder.state in _STOPPED]
    who = ", ".join(map(str, stopped or holders)) or "another process"
    state, first = "", "wait until it has ended"
    if stopped:
        state = ", which was stopped,"
        first = f"continue it (kill -CONT {stopped[0].pid})"
    then = ""
    if (path / LOCK_FILE).exists() and _module("msvcrt") is None:
        then = f", or remove {str(path / LOCK_FILE)!r} if no process is at work there"
    waited = f", and has done so for {patience_s:.0f} s" if patience_s else ""
    return BusyError(
        f"{who}{state} holds {str(path)!r}{waited}",
        next=f"{first}, or end it{then}, and run the same command again; what is finished stays",
    )


@contextlib.contextmanager
def _locked_now(path: Path, shared: bool) -> Iterator[None]:
    fcntl = _module("fcntl")
    msvcrt = _module("msvcrt")
    with contextlib.ExitStack() as stack:
        if fcntl is None and msvcrt is not None:
            stack.enter_context(_lock_byte(path, msvcrt))
        elif (fcntl is None or not _lock_handle(path, fcntl, shared, stack)) and path.is_dir():
            stack.enter_context(_lock_file(path / LOCK_FILE))
        yield


def _lock_handle(path: Path, fcntl: ModuleType, shared: bool, stack: contextlib.ExitStack) -> bool:
    """Lock a file or folder until the stack ends; return whether its file system has locks."""
    is_folder = path.is_dir()
    handle = os.open(path, os.O_RDONLY if is_folder else os.O_RDWR | os.O_CREAT, 0o666)
    stack.callback(os.close, handle)
    has_locks = True
    try:
        fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        # Not left to closing: a forked child may have the file open, too.
        stack.callback(fcntl.flock, handle, fcntl.LOCK_UN)
    except BlockingIOError:
        raise
    except OSError:
        has_locks = False
    if is_folder and not os.path.samestat(os.fstat(handle), path.stat()):
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
    return has_locks


@contextlib.contextmanager
def _lock_byte(path: Path, msvcrt: ModuleType) -> Iterator[None]:
    """Lock a byte of a file, or of one in a folder, as on Windows, which frees those of killed processes."""
    is_folder = path.is_dir()
    file = path / LOCK_FILE if is_folder else path
    handle = -1
    try:
        handle = os.open(file, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOINHERIT", 0), 0o666)
        os.lseek(handle, _LOCKED_BYTE, os.SEEK_SET)
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
    except OSError as error:
        if handle >= 0:
            os.close(handle)
        if isinstance(error, PermissionError):  # another holds it, or is removing the file
            raise BlockingIOError(error.errno, error.strerror) from error
        raise
    try:
        if is_folder:
            os.lseek(handle, 0, os.SEEK_SET)
            os.write(handle, _note().ljust(_LONGEST_NOTE_BYTES).encode())
        yield
    finally:
        os.lseek(handle, _LOCKED_BYTE, os.SEEK_SET)
        with contextlib.suppress(OSError):
            msvcrt.locking(handle, msvcrt.LK_UNLCK, 1)
        os.close(handle)
        if is_folder:
            with contextlib.suppress(OSError):  # another has opened it already
                file.unlink()


@contextlib.contextmanager
def _lock_file(path: Path) -> Iterator[None]:
    try:
        with path.open("x", encoding="utf-8") as note:
            note.write(_note())
    except FileExistsError as error:
        raise BlockingIOError from error
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def _note() -> str:
    """Return the text by which a lock file names its holder."""
    return f"{os.getpid()} {socket.gethostname()}\n"


def _module(name: str) -> ModuleType | None:
    """Return a module of Python that this system may lack."""
    try:
        return import_module(name)
    except ImportError:
        return None
