"""Folders of files that tasks write beside the rows, such as pictures."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from dataset_store.storage import DataFolder

__all__ = ["folders_below", "remove_tree"]


def folders_below(folder: DataFolder, place: str) -> Iterator[str]:
    """Yield a sub-folder and all folders inside it; none of a remote one, where no file is half-written."""
    if not folder.is_local:
        return
    root = folder.address()
    for found, _, _ in os.walk(folder.address(place)):
        yield os.path.relpath(found, root)


def remove_tree(folder: DataFolder, place: str) -> None:
    """Remove a sub-folder with all that it holds; an absent one is no error.

    Links are removed, and nothing that they lead to.

    Raises
    ------
    StorageError
        When something cannot be removed.
    """
    if folder.is_local and Path(folder.address(place)).is_symlink():
        folder.remove(place)
        return
    for name in folder.names(place):
        remove_tree(folder, f"{place}/{name}")
    folder.remove_empty(place)
    if folder.exists(place):
        folder.remove(place)
