"""What checking a whole data set folder means: all its splits, none of them unfinished."""

from __future__ import annotations

from dataset_store.errors import InputError
from dataset_store.manifest import Manifest, read_manifest
from dataset_store.parts import manifest_so_far
from dataset_store.places import available_splits, find_shards
from dataset_store.storage import DataFolder

__all__ = ["splits_to_check"]


def splits_to_check(path: str) -> tuple[str, ...]:
    """List the splits of a local data set folder that is to be checked as a whole.

    Raises
    ------
    InputError
        The folder holds no data set.
    IntegrityError
        The run that makes it is under way or was interrupted: a check of the rest would pass for one of all.
    """
    folder = DataFolder(path)
    manifest = read_manifest(folder)
    if manifest is not None and not manifest.complete:
        unfinished = _unfinished_split(folder, manifest)
        if unfinished is not None:
            find_shards(path, unfinished)
    splits = available_splits(folder)
    if not splits:
        message = (
            f"{path!r} holds no data set (no manifest and no Parquet files); next: name a generated folder"
        )
        raise InputError(message)
    return splits


def _unfinished_split(folder: DataFolder, manifest: Manifest) -> str | None:
    """Return a split that lacks shards, one that was begun before one that was not."""
    so_far = manifest_so_far(folder)
    begun = so_far.splits if so_far is not None else ()
    for split in (*begun, *manifest.split_order):
        receipts = manifest.receipts_of(split)
        if not receipts or len(receipts) < receipts[0].shard.count:
            return split
    return None
