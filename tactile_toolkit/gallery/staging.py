"""A folder that appears whole or not at all."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from tactile_toolkit.run.system import locked
from tactile_toolkit.store.folder import stale_files, temporary_name

__all__ = ["is_unfinished", "staged_folder"]

_PREFIX = ".gallery-"


def is_unfinished(name: str) -> bool:
    """Tell whether a name is that of a folder which a run has not finished."""
    return name.startswith(_PREFIX)


@contextlib.contextmanager
def staged_folder(
    path: Path, refuse: Callable[[Path, Path], None] = lambda _folder, _staging: None, marker: str = ""
) -> Iterator[Path]:
    """Give a new folder whose content is at ``path``, which is not a symbolic link, in the end.

    A folder that stands there stays and what it holds is replaced: whoever is in it stays in it. An exception
    removes what was made; what a killed process left is removed by the next run. ``refuse`` takes a folder
    and the new one, and raises where the first holds what may not be replaced. It is asked at the very end,
    of what is at ``path`` and of what was moved out of it: hours may pass between. ``marker`` is the file by
    which the others are known: it leaves last and arrives first, so that nothing unknown is left when the
    process is killed in between.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # Within a folder that is there, which may be all that may be written, or a file system of its own.
    home = path if path.is_dir() else path.parent
    for left in (*stale_files(path.parent, _PREFIX), *stale_files(path, _PREFIX)):
        shutil.rmtree(left, ignore_errors=True)
    staging = home / temporary_name(path.name, _PREFIX)
    staging.mkdir()
    try:
        yield staging
        _put_in_place(staging, path, marker, refuse)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _put_in_place(staging: Path, path: Path, marker: str, refuse: Callable[[Path, Path], None]) -> None:
    if not path.exists():
        try:
            # One step for whoever looks: no moment without a whole folder.
            staging.rename(path)
        except OSError:
            # Another run may have been faster: its folder holds something.
            if not path.is_dir():
                raise
        else:
            return
    with locked(path):
        refuse(path, staging)
        _exchange(staging, path, marker, refuse)


def _exchange(staging: Path, path: Path, marker: str, refuse: Callable[[Path, Path], None]) -> None:
    """Put the content of a folder in place of another's, which comes back when that fails."""
    former = path / temporary_name("former", _PREFIX)
    former.mkdir()
    arrived: list[str] = []
    try:
        _move(_entries(path, marker)[::-1], path, former, [])
        refuse(former, staging)
        _move(_entries(staging, marker), staging, path, arrived)
    except BaseException:
        _move(arrived[::-1], path, staging, [])
        _move(_entries(former, marker), former, path, [])
        former.rmdir()
        raise
    shutil.rmtree(former, ignore_errors=True)


def _entries(folder: Path, marker: str) -> list[str]:
    """List what a folder holds: the marker, then folders, which never replace others that hold something."""
    entries = [entry for entry in folder.iterdir() if not is_unfinished(entry.name)]
    order = sorted(entries, key=lambda entry: (entry.name != marker, entry.is_file(), entry.name))
    return [entry.name for entry in order]


def _move(names: Iterable[str], source: Path, target: Path, moved: list[str]) -> None:
    for name in names:
        (source / name).rename(target / name)
        moved.append(name)
