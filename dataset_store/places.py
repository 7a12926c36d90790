"""Where the shards of a named data set lie: a local folder, a file, or a repository of the Hub."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from dataset_store.errors import InputError, IntegrityError
from dataset_store.hub.repository import HubRepository
from dataset_store.manifest import MANIFEST_FILE, read_manifest
from dataset_store.rowgroups import Shard
from dataset_store.shards import DATA_FOLDER, ShardName
from dataset_store.storage import DataFolder

__all__ = [
    "ShardFile",
    "available_splits",
    "files_of_split",
    "find_shards",
    "repository_named",
    "repository_shards",
    "shard_files",
    "splits_of",
]

_HUB_NAME = re.compile(r"(?:hf://datasets/)?(?P<repo>[\w.-]+/[\w.-]+)")


@dataclass(frozen=True, slots=True, order=True)
class ShardFile:
    """A Parquet file and the split that it belongs to by its name."""

    split: str
    path: str


def find_shards(
    name: str, split: str, *, revision: str | None = None, streaming: bool = False
) -> tuple[Shard, ...]:
    """Find the shards of one split, fetching them first where they are on the Hub.

    Parameters
    ----------
    name : str
        Local folder, Parquet file, or repository of the Hub (``USER/NAME``).
    split : str
        Split wanted; only its shards are fetched.
    revision : str, optional
        Branch, tag or commit of the repository.
    streaming : bool
        Give remote addresses that are read piece by piece instead of fetching files.

    Raises
    ------
    InputError
        No such folder, or no such split in it.
    IntegrityError
        The folder's manifest is damaged, or says that its run was interrupted in this split.
    HubError
        The repository cannot be reached or does not exist.
    """
    place = Path(name).expanduser()
    if place.is_file():
        return (Shard(str(place)),)
    if place.is_dir():
        return _local_shards(DataFolder(str(place)), split)
    repository = repository_named(name, revision)
    with repository.told_apart(f"split {split!r}"):
        files = files_of_split(repository_shards(repository), split, name)
    addresses = [repository.address(f.path) if streaming else repository.fetch(f.path) for f in files]
    return tuple(Shard(address) for address in addresses)


def repository_named(name: str, revision: str | None = None) -> HubRepository:
    """Return the repository that a name means.

    Raises
    ------
    InputError
        It is no name of one.
    """
    match = _HUB_NAME.fullmatch(name)
    if match is None or name.startswith((".", "/", "~")):
        message = (
            f"{name!r} is neither a folder, nor a Parquet file, nor a repository of the Hub (USER/NAME); "
            "next: check the path, or make a data set with `generate --out`"
        )
        raise InputError(message)
    return HubRepository(match["repo"], revision)


def splits_of(name: str, *, revision: str | None = None) -> tuple[str, ...]:
    """List the splits of a data set by its name.

    Parameters
    ----------
    name : str
        Local folder, Parquet file (which counts as ``train``), or repository of the Hub.
    revision : str, optional
        Branch, tag or commit of the repository.

    Raises
    ------
    InputError
        When the name is none of these, or holds no Parquet files.
    HubError
        The repository cannot be reached or does not exist.
    """
    place = Path(name).expanduser()
    if place.is_file():
        return ("train",)
    if place.is_dir():
        splits = available_splits(DataFolder(str(place)))
    else:
        files = repository_shards(repository_named(name, revision))
        splits = tuple(dict.fromkeys(file.split for file in files))
    if not splits:
        message = f"{name!r} holds no Parquet files; next: name the folder or repository of a data set"
        raise InputError(message)
    return splits


def available_splits(folder: DataFolder) -> tuple[str, ...]:
    """List the splits of a local folder: those of its manifest, or else those its file names tell."""
    manifest = read_manifest(folder)
    if manifest is not None:
        return manifest.splits
    return tuple(dict.fromkeys(file.split for file in _folder_files(folder)))


def _local_shards(folder: DataFolder, split: str) -> tuple[Shard, ...]:
    manifest = read_manifest(folder)
    if manifest is None:
        files = files_of_split(_folder_files(folder), split, folder.address())
        return tuple(Shard(folder.address(file.path)) for file in files)
    receipts = manifest.receipts_of(split)
    _refuse_unfinished(folder, split, [receipt.shard for receipt in receipts], manifest.complete)
    if not receipts:
        raise _no_split(split, manifest.splits, folder.address())
    return tuple(Shard(folder.address(receipt.shard.data_path), receipt.rows) for receipt in receipts)


def _refuse_unfinished(folder: DataFolder, split: str, shards: list[ShardName], complete: bool) -> None:
    """Refuse a split of which a running or interrupted `generate` has made only some shards."""
    if complete or (shards and len(shards) == shards[0].count):
        return
    there = [file.path for file in _folder_files(folder) if file.split == split]
    if there or not shards:
        message = (
            f"the run that makes {folder.address()!r} is not finished ({len(there)} shards of split "
            f"{split!r} are there, {MANIFEST_FILE} is not complete); next: run the same `generate` or "
            "`download` again, it goes on"
        )
        raise IntegrityError(message)


def _folder_files(folder: DataFolder) -> list[ShardFile]:
    nested = [f"{DATA_FOLDER}/{name}" for name in folder.names(DATA_FOLDER)]
    return shard_files([*nested, *folder.names()])


def shard_files(paths: Iterable[str]) -> list[ShardFile]:
    """Sort Parquet files by split: ``train-00000-of-00002.parquet``, or a split's bare name."""
    files = []
    for path in paths:
        file = PurePosixPath(path)
        if file.suffix != ".parquet" or file.name.startswith(".") or file.parts[0] == "reports":
            continue
        shard = ShardName.parse(file.name)
        files.append(ShardFile(shard.split if shard else re.split(r"[-.]", file.name)[0], path))
    return sorted(files)


def repository_shards(repository: HubRepository) -> list[ShardFile]:
    """Sort the Parquet files of a repository by split.

    A manifest tells which files belong to the data set: shards of an older layout may lie beside them,
    because an upload removes nothing that it was not told to remove.

    Raises
    ------
    IntegrityError
        The manifest is damaged.
    HubError
        The repository cannot be read.
    """
    files = shard_files(repository.files())
    if repository.manifest is None:
        return files
    listed = {receipt.shard.data_path for receipt in repository.manifest.receipts}
    return [file for file in files if file.path in listed]


def files_of_split(files: list[ShardFile], split: str, where: str) -> list[ShardFile]:
    """Return the files of one split.

    Raises
    ------
    InputError
        There is no such split.
    IntegrityError
        Some of its shards are absent.
    """
    chosen = [file for file in files if file.split == split]
    if not chosen:
        raise _no_split(split, tuple(dict.fromkeys(file.split for file in files)), where)
    _refuse_missing_shards(chosen, where)
    return chosen


def _refuse_missing_shards(files: list[ShardFile], where: str) -> None:
    """Refuse a split of which some shards are absent: fewer rows than there should be must not pass."""
    names = [ShardName.parse(PurePosixPath(file.path).name) for file in files]
    counts = {name.count for name in names if name is not None}
    if len(counts) == 1 and None not in names and len(files) < max(counts):
        message = (
            f"{len(files)} of {max(counts)} shards of split {files[0].split!r} are in {where!r}, all were "
            "expected; next: download or generate the data set again (with a network, if it is on the Hub)"
        )
        raise IntegrityError(message)


def _no_split(split: str, known: tuple[str, ...], where: str) -> InputError:
    found = f"it has {', '.join(known)}" if known else "it holds no Parquet files"
    return InputError(f"no split {split!r} in {where!r}: {found}; next: choose one of them, or generate it")
