"""Summary of a data set folder: splits, files, rows, bytes and columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import PurePosixPath

import pyarrow as pa

from tactile_toolkit import places, read, run, store
from tactile_toolkit.cards.card_features import yaml_features
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonDict


@dataclass(frozen=True)
class SplitFiles:
    """One split: its files, which are opened when needed, their paths in the folder, and sizes.

    ``unpacked_bytes`` is the size of the rows in memory, an estimate unless the manifest states it.
    """

    split: str
    shards: tuple[read.Shard, ...]
    paths: tuple[str, ...]
    rows: int
    file_bytes: int
    unpacked_bytes: int


@dataclass(frozen=True)
class FolderSummary:
    """An entire folder: its splits in canonical order, and their schema.

    With ``recorded``, the values come from the manifest, without opening files. ``viewer`` are files that
    repeat the rows of a split for the page of the Hub, if the manifest lists any.
    """

    splits: tuple[SplitFiles, ...]
    schema: pa.Schema
    recorded: bool = False
    viewer: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """Rows of all splits."""
        return sum(split.rows for split in self.splits)

    @cached_property
    def features(self) -> list[JsonDict]:
        """Columns as `datasets` describes them in a card."""
        first = next((shard.path for split in self.splits for shard in split.shards), "")
        return yaml_features(self.schema, first)


def folder_summary(
    folder: store.DataFolder, manifest: store.Manifest | None = None, place: places.Place | None = None
) -> FolderSummary:
    """Summarise a folder from its manifest, or else from the footers of its files.

    ``manifest`` is one that will be written there, ``place`` the opened folder if it has none. Raises
    InputError when the folder holds no Parquet files, and IntegrityError when one is missing or damaged.
    """
    manifest = manifest or store.manifest_so_far(folder)
    if manifest is None:
        held = (place or places.folder_place(folder)).all_shards()
        splits = [_measured(folder, split, shards) for split, shards in held.items()]
    else:
        splits = [_recorded(folder, split, manifest.shards_of(split)) for split in manifest.splits]
    if not splits:
        raise InputError(folder.missing_message("Parquet files"), next="give the folder of a data set")
    schema = splits[0].shards[0].schema
    return FolderSummary(tuple(splits), schema, manifest is not None, viewer_files(manifest))


def _recorded(folder: store.DataFolder, split: str, records: Sequence[store.ShardRecord]) -> SplitFiles:
    """Return the files of a split and their sizes as a manifest states them."""
    paths = tuple(each.shard.data_path for each in records)
    shards = (read.Shard(folder.address(path), each.rows) for path, each in zip(paths, records, strict=True))
    sizes = ((each.rows, each.bytes, each.unpacked_bytes) for each in records)
    return SplitFiles(split, tuple(shards), paths, *map(sum, zip(*sizes, strict=True)))


def _measured(folder: store.DataFolder, split: str, shards: tuple[read.Shard, ...]) -> SplitFiles:
    """Return the files of a split and their sizes as their footers state them."""
    paths = tuple(shard.path.removeprefix(f"{folder.address()}/") for shard in shards)
    files = zip(shards, paths, strict=True)
    sizes = run.in_threads(partial(_sizes, folder), files, run.usable_cores())
    return SplitFiles(split, shards, paths, *map(sum, zip(*sizes, strict=True)))


def _sizes(folder: store.DataFolder, file: tuple[read.Shard, str]) -> tuple[int, int, int]:
    """Return rows, bytes and unpacked bytes of a file."""
    shard, path = file
    groups = map(shard.metadata.row_group, range(shard.metadata.num_row_groups))
    return len(shard), folder.size_bytes(path), sum(group.total_byte_size for group in groups)


def viewer_files(manifest: store.Manifest | None) -> dict[str, tuple[str, ...]]:
    """Return the files of each split that a manifest lists for the page of the Hub."""
    if manifest is None:
        return {}
    listed = [path for path in manifest.files or () if path.startswith(f"{store.VIEWER_FOLDER}/")]
    names = sorted(filter(None, (store.ShardName.parse(PurePosixPath(path).name) for path in listed)))
    found: dict[str, tuple[str, ...]] = {}
    for split in manifest.splits:
        if paths := tuple(f"{store.VIEWER_FOLDER}/{name}.parquet" for name in names if name.split == split):
            found[split] = paths
    return found
