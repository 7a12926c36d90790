"""Names of unfinished files and folders, which tell what a dead writer left from what a living one is at.

A name holds the writer's host, its process and the moment that process began: process numbers come back, in a
container that is started again with every start.
"""

from __future__ import annotations

import os
import re
import socket
import uuid
from collections.abc import Iterator
from pathlib import Path

__all__ = ["UNFINISHED", "left_by_the_dead", "leavings", "unfinished_name"]

UNFINISHED = ".writing-"
"""How the name of every unfinished file begins."""

_WRITER = re.compile(r"(?P<process>\d+)(?:\.(?P<began>\d+))?-")
_ENDED_STATES = ("Z", "X")  # a zombie has ended; its parent has not asked for its exit status yet


def unfinished_name(name: str, prefix: str = UNFINISHED) -> str:
    """Return a name, new each time, under which this process may write ``name`` until it is finished."""
    process = os.getpid()
    began = _began(process)
    writer = str(process) if began is None else f"{process}.{began}"
    return f"{prefix}{socket.gethostname()}-{writer}-{uuid.uuid4().hex[:8]}-{name}"


def left_by_the_dead(name: str, prefix: str = UNFINISHED) -> bool:
    """Tell whether a name is that of an unfinished file whose writer, on this machine, has ended."""
    here = f"{prefix}{socket.gethostname()}-"
    writer = _WRITER.match(name, len(here)) if name.startswith(here) else None
    if writer is None:
        return False
    process, began = int(writer["process"]), writer["began"]
    return not _runs(process) or (began is not None and began != _began(process))


def leavings(folder: Path, prefix: str = UNFINISHED) -> Iterator[Path]:
    """Yield what dead writers left directly in a local folder."""
    yield from (entry for entry in folder.glob(f"{prefix}*") if left_by_the_dead(entry.name, prefix))


def _runs(process: int) -> bool:
    if _has_proc():
        facts = _facts(process)
        return facts is not None and facts[0] not in _ENDED_STATES
    try:
        os.kill(process, 0)  # sends nothing, only asks
    except ProcessLookupError:
        return False
    except OSError:
        return True  # somebody else's
    return True


def _began(process: int) -> str | None:
    """Return when a process began, in clock ticks since the machine started; None where that is not known."""
    facts = _facts(process)
    return None if facts is None else facts[19]


def _facts(process: int) -> list[str] | None:
    """Return the fields of Linux's ``/proc/PID/stat`` (proc(5)) from the third, the state, onwards."""
    try:
        line = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return None
    # The second field, the program's name in brackets, may hold blanks and brackets itself.
    return line.rpartition(")")[2].split()


def _has_proc() -> bool:
    return Path("/proc/self/stat").exists()
