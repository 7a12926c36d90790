"""A folder that appears whole or not at all."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import uuid
from collections.abc import Iterator
from pathlib import Path

__all__ = ["staged_folder"]

_PREFIX = ".gallery-"


@contextlib.contextmanager
def staged_folder(place: Path) -> Iterator[Path]:
    """Give a new folder beside ``place`` that takes its name in the end.

    A folder that stands at ``place`` is replaced. An exception removes what was made; what a killed process
    left is removed by the next run beside it.

    Raises
    ------
    OSError
        As the file system raises it.
    """
    place.parent.mkdir(parents=True, exist_ok=True)
    _remove_leavings(place.parent)
    staging = place.parent / _temporary_name(place.name)
    staging.mkdir()
    try:
        yield staging
        _put_in_place(staging, place)
    except BaseException:
        shutil.rmtree(staging, ignore_errors=True)
        raise


def _put_in_place(staging: Path, place: Path) -> None:
    """Rename; what stood there before goes away first and comes back when that fails."""
    if not place.exists() or not any(place.iterdir()):
        staging.rename(place)
        return
    former = place.parent / _temporary_name(place.name)
    place.rename(former)
    try:
        staging.rename(place)
    except BaseException:
        former.rename(place)
        raise
    shutil.rmtree(former, ignore_errors=True)


def _temporary_name(name: str) -> str:
    # Host and process let a later run tell a dead writer's leavings from a living one's.
    return f"{_PREFIX}{socket.gethostname()}-{os.getpid()}-{uuid.uuid4().hex[:8]}-{name}"


def _remove_leavings(folder: Path) -> None:
    start = f"{_PREFIX}{socket.gethostname()}-"
    for entry in folder.glob(f"{_PREFIX}*"):
        process = entry.name.removeprefix(start).split("-", 1)[0]
        gone = process.isdigit() and not Path(f"/proc/{process}").exists()
        if entry.name.startswith(start) and gone:
            shutil.rmtree(entry, ignore_errors=True)
