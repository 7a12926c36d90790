"""A folder that appears whole or not at all."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

from dataset_store.leavings import leavings, unfinished_name

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
    for left in leavings(place.parent, _PREFIX):
        shutil.rmtree(left, ignore_errors=True)
    staging = place.parent / unfinished_name(place.name, _PREFIX)
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
    former = place.parent / unfinished_name(place.name, _PREFIX)
    place.rename(former)
    try:
        staging.rename(place)
    except BaseException:
        former.rename(place)
        raise
    shutil.rmtree(former, ignore_errors=True)
