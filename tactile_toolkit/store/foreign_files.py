"""Files below a folder of unknown origin: every importer opens them here.

A table, a tar or a Zarr group names files of its folder. A link may lead to any file of this machine, whose
bytes would then be stored as a picture and published. Reading a pipe would wait, and a device has no end.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO

from tactile_toolkit.errors import IntegrityError, ItemError
from tactile_toolkit.store.data_folder import DataFolder
from tactile_toolkit.store.names import problem_of_name


def open_inside(folder: DataFolder, path: str, known: set[str] | None = None) -> IO[bytes]:
    """Open a regular file below a folder for reading.

    Parameters
    ----------
    folder : DataFolder
        The source, as the user named it; it may be reached through a link itself.
    path : str
        Relative path, with slashes.
    known : set of str, optional
        Sub-folders that lie inside, for a caller that opens many files in a row: each is checked once.

    Raises
    ------
    ItemError
        The file does not exist or is not a regular one, or a link leads out of the folder.
    InputError
        This user may not read it.
    """
    _require_inside(folder, path, known)
    try:
        return folder.open(path)
    except (FileNotFoundError, NotADirectoryError) as error:
        raise ItemError("missing", "the file does not exist") from error
    except (OSError, IntegrityError) as error:
        raise ItemError("file", "it is not a regular file, or cannot be read") from error


def read_inside(folder: DataFolder, path: str, size: int, known: set[str] | None = None) -> bytes:
    """Return the beginning of a small regular file below a folder; arguments and errors of `open_inside`.

    This runs for each image. On systems that can refuse to open a link, a local file takes less than half of
    the time of `open_inside`.
    """
    no_link = getattr(os, "O_NOFOLLOW", 0)
    parent = path.rpartition("/")[0]
    if folder.is_local and no_link and known is not None and (not parent or parent in known):
        with suppress(OSError):  # a link, or not a file: `open_inside` says what it is
            handle = os.open(folder.address(path), os.O_RDONLY | no_link | getattr(os, "O_NONBLOCK", 0))
            try:
                content = os.read(handle, size) if stat.S_ISREG(os.fstat(handle).st_mode) else b""
            finally:
                os.close(handle)
            if len(content) == size > 0:
                return content
    with open_inside(folder, path, known) as stream:
        return stream.read(size)


def size_inside(
    folder: DataFolder,
    path: str,
    sizes: Callable[[str], Mapping[str, int]] | None = None,
    known: set[str] | None = None,
) -> int:
    """Return the size of a regular file below a folder; raises as :func:`open_inside`.

    ``sizes`` lists a folder of a store, such as ``functools.cache(folder.sizes)``.
    """
    words = problem_of_name(path)
    if words:
        raise ItemError("name", f"the name {words}; expected a path below the folder")
    _require_inside(folder, path, known)
    size = None
    if folder.is_local:
        with suppress(OSError, ValueError):
            found = os.stat(folder.address(path))  # noqa: PTH116
            if stat.S_ISREG(found.st_mode):
                size = found.st_size
    else:
        parent, _, base = path.rpartition("/")
        size = (sizes or folder.sizes)(parent).get(base)
    if size is None:
        if folder.is_local and Path(folder.address(path)).exists():
            raise ItemError("file", "it is not a regular file, or cannot be read")
        raise ItemError("missing", "the file does not exist")
    return size


def _require_inside(folder: DataFolder, path: str, known: set[str] | None) -> None:
    """Refuse a path on which a symbolic link leads out of a local folder (ItemError)."""
    if not folder.is_local:
        return
    parent, step, parts = path.rpartition("/")[0], folder.root, path.split("/")
    if known is not None and parent in known:
        step, parts = f"{folder.root}/{parent}", parts[-1:]
    for part in parts:
        step = f"{step}/{part}"
        # Not pathlib, and resolved only if there is a link: this runs for each image.
        if os.path.islink(step):  # noqa: PTH114
            if not Path(folder.address(path)).resolve().is_relative_to(Path(folder.root).resolve()):
                problem = "a link leads out of the folder; expected a file below it, such as a copy"
                raise ItemError("name", problem)
            return
    if known is not None and parent:
        known.add(parent)


def problem_of_place(folder: DataFolder, path: str) -> str:
    """Return why a path is not a file of the folder itself; empty if it is.

    A link may lead to another file of the folder, or from a snapshot of the Hub's cache to its contents. No
    other file is read, because the folder is untrusted.
    """
    if not folder.exists(path):
        return "is missing"
    if not folder.is_local:
        return ""
    root, place = (Path(os.path.realpath(folder.address(each))) for each in ("", path))
    blobs = root.parent.parent / "blobs"
    if not place.is_relative_to(root) and not (root.parent.name == "snapshots" and place.parent == blobs):
        return f"is a link that leads out of the folder, to {str(place)!r}; next: put the file there itself"
    if place.is_file():
        return ""
    return "is not a file (it is a folder, a pipe or a device)"
