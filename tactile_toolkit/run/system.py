"""What operating systems do in ways of their own: locks, signals, folders on the disk.

Nothing else in the project imports a module that only some systems have.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import signal
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

LOCK_FILE = ".lock"
"""Is in a folder while a process holds it where the system or the file system knows no locks of folders."""
_LOOK_AGAIN_S = 0.02


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
    is_folder = path.is_dir()
    with contextlib.ExitStack() as stack:
        if is_folder and _module("fcntl") is None:  # Windows opens no folders
            stack.enter_context(_lock_file(path / LOCK_FILE))
        else:
            handle = os.open(path, os.O_RDONLY if is_folder else os.O_RDWR | os.O_CREAT, 0o666)
            stack.callback(os.close, handle)
            try:
                stack.enter_context(_lock(handle, shared))
            except BlockingIOError:
                raise
            except OSError:
                if is_folder:
                    stack.enter_context(_lock_file(path / LOCK_FILE))
            if is_folder and not os.path.samestat(os.fstat(handle), path.stat()):
                raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
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


@contextlib.contextmanager
def _lock(handle: int, shared: bool) -> Iterator[None]:
    """Lock an open file without waiting; BlockingIOError where another holds it."""
    fcntl, msvcrt = _module("fcntl"), _module("msvcrt")
    if fcntl is not None:
        fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    elif msvcrt is not None:
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError as error:
            raise BlockingIOError from error
    try:
        yield
    finally:
        # Done here, not left to closing: a child forked meanwhile has the file open too.
        if fcntl is not None:
            fcntl.flock(handle, fcntl.LOCK_UN)


@contextlib.contextmanager
def held(path: Path, *, wait: bool = True) -> Iterator[bool]:
    """Hold a file or folder that only one process uses, so that others see it; yield whether this one does.

    Without ``wait``, one that a user holds is left to them, as is one that cannot be locked, and folders on
    Windows, where an open file cannot be removed anyway. Raises OSError.
    """
    fcntl = _module("fcntl")
    if fcntl is None:
        yield wait or not path.is_dir()
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except OSError:
            yield wait
        else:
            yield True
    finally:
        os.close(handle)


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


def ignore_interrupts() -> None:
    """Leave Ctrl-C to the process that started this one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
