"""A folder that holds some Parquet files and nothing else, for programs that read all of a folder."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from tactile_toolkit.cache import cache_folder
from tactile_toolkit.store.folder import named_failures
from tactile_toolkit.store.shards import ShardName

__all__ = ["folder_of_links"]


def folder_of_links(files: Sequence[str]) -> Path:
    """Return a folder with links to files, as the shards of a split ``train``.

    It lies in the cache folder and is the same one for the same files, so that a program that remembers what
    it has read of a folder (as ``datasets`` does) need not read it again.

    Parameters
    ----------
    files : sequence of str
        Local Parquet files, in order.

    Raises
    ------
    StorageError
        The cache folder cannot be written.
    """
    targets = [Path(file).resolve() for file in files]
    # Size and time as well: a link does not tell that its file was written anew.
    facts = [(str(target), target.stat().st_size, target.stat().st_mtime_ns) for target in targets]
    folder = cache_folder() / "linked" / hashlib.sha256(repr(facts).encode()).hexdigest()[:32]
    with named_failures(str(folder)):
        for number, target in enumerate(targets):
            link = folder / ShardName("train", number, len(targets)).data_path
            link.parent.mkdir(parents=True, exist_ok=True)
            # One folder for each list of files, so a link that is there is the right one.
            if not link.is_symlink():
                _link(link, target)
    return folder


def _link(link: Path, target: Path) -> None:
    try:
        link.symlink_to(target)
    except FileExistsError:  # another process was faster
        return
