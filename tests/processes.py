"""What the system knows of processes that tests start and kill (Linux)."""

from __future__ import annotations

import time
from pathlib import Path


def children(pid: int) -> list[int]:
    """List the processes that a process has started itself."""
    try:
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except FileNotFoundError:
        return []


def alive(pid: int) -> bool:
    """Tell whether a process runs; one that has ended and whose status nobody asked for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def wait_until_gone(processes: list[int]) -> None:
    """Processes whose parent was killed must leave by themselves, and soon."""
    deadline_s = time.monotonic() + 60
    while any(alive(pid) for pid in processes) and time.monotonic() < deadline_s:
        time.sleep(0.02)
    assert not [pid for pid in processes if alive(pid)]
