"""Work in the background: a process of its own, which ends with the process that started it."""

from __future__ import annotations

import atexit
import contextlib
import io
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

from tactile_toolkit.errors import ToolkitError

_NICENESS = 10
# A fresh interpreter that imports from where the caller does. Only the caller handles Ctrl-C.
_BOOT = """
import pickle, signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
sys.path[:] = pickle.load(sys.stdin.buffer)
from tactile_toolkit.run.background import work
work()
"""


def start_background(function: Callable[..., object], *arguments: Any) -> None:
    """Call a picklable function in a process of its own, at low priority.

    It may start processes, even if this one may not. It shows no progress; an error of the toolkit is a line
    on stderr. It ends when this process ends, finished or not. Without an interpreter to start, as
    in a program that embeds Python, nothing happens.
    """
    if not sys.executable:
        return
    process = subprocess.Popen(
        [sys.executable, "-I", "-c", _BOOT],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )
    atexit.register(_end, process, os.getpid())
    with contextlib.suppress(OSError):  # it has died
        assert process.stdin is not None
        process.stdin.write(pickle.dumps(sys.path) + pickle.dumps((function, arguments)))
        process.stdin.flush()  # and left open: its end tells the process that this one is gone


def _end(process: subprocess.Popen[bytes], owner: int) -> None:
    if os.getpid() == owner:  # and not a fork of it
        process.kill()
        process.wait()


def work() -> None:
    """Run the function that the starting process has sent."""
    function, arguments = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if hasattr(os, "nice"):  # not on Windows
        os.nice(_NICENESS)
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            function(*arguments)
    except ToolkitError as error:
        sys.stderr.write(f"in the background: {error}\n")


def _end_with_parent() -> None:
    with contextlib.suppress(OSError):
        while os.read(0, 1):
            pass
    os._exit(1)
