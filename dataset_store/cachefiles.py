"""The cache folder: Arrow files of unpacked row groups, mapped into memory by every process on a machine."""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from dataset_store.leavings import leavings
from dataset_store.storage import atomic_file

__all__ = ["CACHE_VARIABLE", "cache_folder", "mapped_batch", "store_batches"]

CACHE_VARIABLE = "TACTILE_TOOLKIT_CACHE"
"""Environment variable that names the folder of unpacked row groups."""

_CACHE_LIMIT_BYTES = 32 << 30
_unwritable: set[Path] = set()  # cache folders that this process has given up on


def cache_folder() -> Path:
    """Return the folder of unpacked row groups: ``$TACTILE_TOOLKIT_CACHE`` or the user's cache folder."""
    named = os.environ.get(CACHE_VARIABLE)
    if named:
        return Path(named).expanduser()
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base).expanduser() / "tactile-toolkit"


def mapped_batch(name: str, number: int) -> Any:
    """Map one record batch of a file of the cache.

    Returns
    -------
    pyarrow.RecordBatch or None
        None when the file is not there, or was damaged (it is then removed).
    """
    import pyarrow as pa

    path = _place(name)
    try:
        # From the map's own buffer, still without a copy: from the map, Arrow would read in its own threads.
        batch = pa.ipc.open_file(pa.memory_map(str(path)).read_buffer()).get_batch(number)
    except FileNotFoundError:
        return None
    except (pa.ArrowInvalid, IndexError, OSError):
        with contextlib.suppress(OSError):  # a cache that cannot be written must not stop a reader
            path.unlink(missing_ok=True)
        return None
    with contextlib.suppress(OSError):
        os.utime(path)  # the time of last use decides what leaves a full cache first
    return batch


def store_batches(name: str, schema: Any, size_bytes: int, tables: Iterable[Any]) -> bool:
    """Write tables as the record batches of a file of the cache, making room for it first.

    A folder that cannot be written is told once and not tried again by this process: trying costs decoding.

    Parameters
    ----------
    name : str
        Name of the file in the cache.
    schema : pyarrow.Schema
        Schema of the tables.
    size_bytes : int
        How large they are, about.
    tables : iterable of pyarrow.Table
        Each becomes one batch; nothing is taken from it when the folder is known to be unwritable.

    Returns
    -------
    bool
        Whether the file is there now.
    """
    place = _place(name)
    if place.parent in _unwritable:
        return False
    try:
        _make_room(place.parent, size_bytes)
        _write_arrow(place, schema, tables)
    except OSError as error:
        _give_up(place.parent, error)
        return False
    return True


def _place(name: str) -> Path:
    return cache_folder() / "blocks" / f"{name}.arrow"


def _give_up(folder: Path, error: OSError) -> None:
    _unwritable.add(folder)
    message = (
        f"row groups cannot be kept unpacked, {str(folder)!r} cannot be written: {error.strerror or error}; "
        "what was used last stays in the memory of this process, all else is decoded again; next: make room "
        f"there, or let {CACHE_VARIABLE} name another folder"
    )
    warnings.warn(message, RuntimeWarning, stacklevel=2)


def _write_arrow(place: Path, schema: Any, tables: Iterable[Any]) -> None:
    import pyarrow as pa

    with atomic_file(place) as stream, pa.ipc.new_file(stream, schema) as writer:
        for table in tables:
            writer.write_table(table)


def _make_room(folder: Path, needed_bytes: int) -> None:
    """Drop the files used longest ago when the cache would pass its limit; open maps stay valid."""
    for left in leavings(folder):
        left.unlink(missing_ok=True)
    files = sorted(_cached_files(folder))
    excess = sum(size for _, size, _ in files) + needed_bytes - _CACHE_LIMIT_BYTES
    for _, size, file in files:
        if excess <= 0:
            return
        file.unlink(missing_ok=True)
        excess -= size


def _cached_files(folder: Path) -> Iterator[tuple[int, int, Path]]:
    """Yield time of last use, size and place of finished files; other processes may remove some meanwhile."""
    for file in folder.glob("[!.]*.arrow"):
        with contextlib.suppress(FileNotFoundError):
            facts = file.stat()
            yield facts.st_mtime_ns, facts.st_size, file
