"""A folder that appears whole or not at all."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

from tactile_toolkit.store.folder import stale_files, temporary_name

__all__ = ["is_unfinished", "staged_folder"]

_PREFIX = ".gallery-"


def is_unfinished(name: str) -> bool:
    """Tell whether a name is that of a folder which a run has not finished."""
    return name.startswith(_PREFIX)


@contextlib.contextmanager
def staged_folder(place: Path, refuse: Callable[[Path], None] = lambda _folder: None) -> Iterator[Path]:
    """Give a new folder whose content is at ``place`` in the end.

    A folder that stands at ``place`` stays and what it holds is replaced: whoever is in it stays in it. An
    exception removes what was made; what a killed process left is removed by the next run.

    Parameters
    ----------
    place : Path
        Where the content goes: no symbolic link.
    refuse : callable
        Takes a folder and raises where that holds what may not be replaced. Asked at the very end, of what
        stands at ``place`` and of what was moved out of it: hours may lie between.

    Raises
    ------
    OSError
        As the file system raises it.
    """
    place.parent.mkdir(parents=True, exist_ok=True)
    # Within a folder that is there, which may be all that may be written, or a file system of its own.
    home = place if place.is_dir() else place.parent
    for left in (*stale_files(place.parent, _PREFIX), *stale_files(place, _PREFIX)):
        shutil.rmtree(left, ignore_errors=True)
    staging = home / temporary_name(place.name, _PREFIX)
    staging.mkdir()
    try:
        yield staging
        _put_in_place(staging, place, refuse)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _put_in_place(staging: Path, place: Path, refuse: Callable[[Path], None]) -> None:
    if not place.exists():
        try:
            staging.rename(place)
        except OSError:
            # Another run may have been faster: its folder holds something.
            if not place.is_dir():
                raise
        else:
            return
    with _alone(place):
        refuse(place)
        _exchange(staging, place, refuse)


def _exchange(staging: Path, place: Path, refuse: Callable[[Path], None]) -> None:
    """Put the content of a folder in place of another's, which comes back when that fails."""
    former = place / temporary_name("former", _PREFIX)
    former.mkdir()
    arrived: list[str] = []
    try:
        _move(place, former, [])
        refuse(former)
        _move(staging, place, arrived)
    except BaseException:
        for name in arrived:
            (place / name).rename(staging / name)
        _move(former, place, [])
        former.rmdir()
        raise
    shutil.rmtree(former, ignore_errors=True)


def _move(source: Path, target: Path, moved: list[str]) -> None:
    """Move what a folder holds, folders first: these never replace others that hold something."""
    for entry in sorted(source.iterdir(), key=lambda entry: (entry.is_file(), entry.name)):
        if not is_unfinished(entry.name):
            entry.rename(target / entry.name)
            moved.append(entry.name)


@contextlib.contextmanager
def _alone(place: Path) -> Iterator[None]:
    """Keep other runs from changing a folder, where the file system can."""
    handle = os.open(place, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
