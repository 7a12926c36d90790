"""Resources of this process: processor cores and the working folder."""

from __future__ import annotations

import os
from pathlib import Path

from tactile_toolkit.errors import InputError


def usable_cores() -> int:
    """Return the number of processor cores that this process may use.

    A scheduler, a container or `taskset` may allow fewer cores than the machine has.
    """
    count = os.cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        return min(count, len(os.sched_getaffinity(0)))
    return count


def working_folder() -> Path:
    """Return the working folder; InputError if it was deleted."""
    try:
        return Path.cwd()
    except FileNotFoundError as error:
        raise InputError("the working folder was deleted", next="change to a folder that exists") from error
