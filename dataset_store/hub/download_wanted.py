"""Which files of a repository a download wants, what proves them, and which of them are here."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path, PurePosixPath

from dataset_store.cards.card import CARD_FILE
from dataset_store.errors import IntegrityError
from dataset_store.hub.checks import is_whole
from dataset_store.hub.failures import not_cached
from dataset_store.hub.repository import HubRepository
from dataset_store.hub.snapshot import HubFile
from dataset_store.manifest import MANIFEST_FILE, read_manifest
from dataset_store.places import files_of_split, repository_shards
from dataset_store.storage import DataFolder

__all__ = [
    "chosen_splits",
    "extras",
    "is_here",
    "is_labelled",
    "labels_of",
    "require_within_reach",
    "wanted_file",
]

_EXTRA_FOLDERS = ("reports", "previews")
_EXTRA_FILES = ("LICENSE", "LICENSE.md", "LICENSE.txt")
_PICTURE_FOLDER = "images"


def chosen_splits(
    repository: HubRepository, splits: Sequence[str]
) -> tuple[tuple[str, ...], tuple[str, ...], list[str]]:
    """Return the splits wanted (all, where none is named), all splits, and the paths of the shards wanted."""
    found = repository_shards(repository)
    order = repository.manifest.split_order if repository.manifest is not None else ()
    names = {file.split for file in found}
    known = tuple(split for split in order if split in names) or tuple(sorted(names))
    chosen = tuple(split for split in known if split in splits) if splits else known
    shards = []
    for split in dict.fromkeys([*chosen, *splits] or ["train"]):
        with repository.told_apart(f"split {split!r}"):
            shards += [file.path for file in files_of_split(found, split, repository.repo_id)]
    return chosen, known, shards


def extras(repository: HubRepository, splits: Sequence[str], *, fitted: bool) -> list[str]:
    """Return what goes with the shards of some splits: small files, and pictures where the set has any.

    Parameters
    ----------
    repository : HubRepository
        Where from.
    splits : sequence of str
        Splits wanted.
    fitted : bool
        Take card and manifest too, as they are.
    """
    manifest = repository.manifest
    listed = set(manifest.files or ()) if manifest is not None else set()
    found = [path for path in repository.files() if _is_extra(path, listed, fitted)]
    if manifest is None:
        return found
    # Data sets of plain pictures name them in their rows: without the files, those are names of nothing.
    trees = tuple(f"{_PICTURE_FOLDER}/{split}/" for split in splits)
    return [*found, *(path for path in repository.files() if path.startswith(trees))]


def _is_extra(path: str, listed: set[str], fitted: bool) -> bool:
    if path in (CARD_FILE, MANIFEST_FILE):
        return fitted
    return path in listed or path in _EXTRA_FILES or PurePosixPath(path).parts[0] in _EXTRA_FOLDERS


def wanted_file(repository: HubRepository, path: str) -> HubFile:
    """Return a wanted file with what proves it: the manifest's checksum, or else the Hub's."""
    return HubFile(path, repository.size_bytes(path), repository.expected(path))


def is_here(folder: DataFolder, file: HubFile) -> bool:
    """Tell whether a folder holds a file, whole."""
    place = Path(folder.address(file.path))
    if not place.is_file() or place.stat().st_size != file.size_bytes or file.digest is None:
        return False
    return is_whole(place, file.digest)


def labels_of(repository: HubRepository) -> tuple[str, ...]:
    """Return which of card and manifest a repository has."""
    return tuple(name for name in (CARD_FILE, MANIFEST_FILE) if name in repository.snapshot.files)


def is_labelled(folder: DataFolder, labels: Iterable[str]) -> bool:
    """Tell whether a folder has its card, and a manifest that says that nothing is left to do."""
    if not all(folder.exists(name) for name in labels):
        return False
    try:
        manifest = read_manifest(folder)
    except IntegrityError:
        return False
    return manifest is None or manifest.complete


def require_within_reach(repository: HubRepository, paths: Iterable[str]) -> None:
    """Make sure, before anything is touched, that the cache has what is wanted when it answers for the Hub.

    Raises
    ------
    HubError
        It lacks a file, and the Hub cannot be asked; names the file.
    """
    if not repository.snapshot.is_cache:
        return
    for path in paths:
        if repository.cached(path) is None:
            raise not_cached(repository.repo_id, repr(path))
