"""What operating systems do in ways of their own: locks, signals, other processes, folders on the disk.

Nothing else in the project imports a module that only some systems have.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import signal
import socket
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

__all__ = ["ignore_interrupts", "is_running", "locked", "machine_name", "process_start", "sync_folder"]

_ENDED_STATES = ("Z", "X")  # a zombie has ended; its parent has not asked for its exit status yet


@contextlib.contextmanager
def locked(path: Path, *, wait: bool = True, shared: bool = False) -> Iterator[None]:
    """Wait for the lock of a file, which is made, or of a folder that is there, and hold it.

    Held by the open file: threads wait for one another too, and a killed process lets go. Any number hold it
    ``shared`` at once, where the system knows that. Where the system or the file system cannot lock it,
    nobody waits. Raises OSError where the file cannot be opened, BlockingIOError, without ``wait``, where
    another holds it, and FileNotFoundError for a folder that was removed meanwhile.
    """
    is_folder = path.is_dir()
    if is_folder and _module("fcntl") is None:  # Windows opens no folders
        yield
        return
    handle = os.open(path, os.O_RDONLY if is_folder else os.O_RDWR | os.O_CREAT, 0o666)
    try:
        try:
            _lock(handle, wait=wait, shared=shared)
        except BlockingIOError:
            raise
        except OSError:
            pass  # it cannot be locked here
        if is_folder and not os.path.samestat(os.fstat(handle), path.stat()):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
        yield
    finally:
        # Said, not left to closing: a child forked meanwhile has the file open too.
        with contextlib.suppress(OSError):
            _unlock(handle)
        os.close(handle)


def _lock(handle: int, *, wait: bool, shared: bool) -> None:
    if fcntl := _module("fcntl"):
        how = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
        fcntl.flock(handle, how | (0 if wait else fcntl.LOCK_NB))
    elif msvcrt := _module("msvcrt"):
        while True:
            try:
                msvcrt.locking(handle, msvcrt.LK_LOCK if wait else msvcrt.LK_NBLCK, 1)
            except OSError as error:
                if not wait:
                    raise BlockingIOError from error
                continue  # it gives up after ten seconds
            return


def _unlock(handle: int) -> None:
    if fcntl := _module("fcntl"):
        fcntl.flock(handle, fcntl.LOCK_UN)
    elif msvcrt := _module("msvcrt"):
        msvcrt.locking(handle, msvcrt.LK_UNLCK, 1)


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


_LONGEST_HOST = 32


@cache
def machine_name() -> str:
    """Name where a process number means one process: this host since it was started, and this container.

    Containers may have the name of their host in common and number their processes each for itself.
    """
    host = socket.gethostname()
    known = [host]
    with contextlib.suppress(OSError):  # other systems than Linux: the host has to do
        known.append(Path("/proc/sys/kernel/random/boot_id").read_text().strip())
        known.append(str(Path("/proc/self/ns/pid").readlink()))
    return f"{host[:_LONGEST_HOST]}-{hashlib.sha256(chr(0).join(known).encode()).hexdigest()[:12]}"


def is_running(process: int) -> bool:
    """Tell whether a process of :func:`machine_name` is at work; a zombie is not."""
    if _has_proc():
        fields = _proc_stat(process)
        return fields is not None and fields[0] not in _ENDED_STATES
    if os.name == "nt":
        return _is_running_on_windows(process)
    try:
        os.kill(process, 0)  # sends nothing, only asks
    except ProcessLookupError:
        return False
    except OSError:
        return True  # somebody else's
    return True


def _is_running_on_windows(process: int) -> bool:
    # os.kill would end it. The system knows the process as long as a handle on it is given out.
    import ctypes

    kernel: Any = getattr(ctypes, "windll").kernel32  # noqa: B009 (mypy knows the name on Windows only)
    handle = kernel.OpenProcess(0x1000, False, process)  # PROCESS_QUERY_LIMITED_INFORMATION
    if not handle:
        return bool(kernel.GetLastError() == 5)  # ERROR_ACCESS_DENIED: somebody else's
    code = ctypes.c_ulong()
    kernel.GetExitCodeProcess(handle, ctypes.byref(code))
    kernel.CloseHandle(handle)
    return code.value == 259  # STILL_ACTIVE


def process_start(process: int) -> str | None:
    """Return when a process began, in clock ticks since the machine started; None where that is not known."""
    fields = _proc_stat(process)
    return None if fields is None else fields[19]


def _has_proc() -> bool:
    """Tell whether ``/proc`` is there and numbers processes as this one does; it may be that of the host."""
    try:
        return str(Path("/proc/self").readlink()) == str(os.getpid())
    except OSError:
        return False


def _proc_stat(process: int) -> list[str] | None:
    """Return the fields of Linux's ``/proc/PID/stat`` (proc(5)) from the third, the state, onwards."""
    if not _has_proc():
        return None
    try:
        line = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return None
    # The second field, the program's name in brackets, may hold blanks and brackets itself.
    return line.rpartition(")")[2].split()
