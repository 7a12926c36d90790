"""What a card says in numbers: splits, files, rows, bytes and columns of a data set folder."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from tactile_toolkit.cards.features import yaml_features
from tactile_toolkit.catalog.locate import available_splits, find_shards
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest, read_manifest
from tactile_toolkit.store.parquet import unpacked_bytes
from tactile_toolkit.store.shards import DATA_FOLDER
from tactile_toolkit.versions import toolkit_version

__all__ = ["FolderFacts", "SplitFacts", "folder_facts", "recorded_facts"]


@dataclass(frozen=True)
class SplitFacts:
    """One split: its files (opened when somebody looks into them), their paths in the folder, and sizes.

    ``unpacked_bytes`` is the size of the rows in memory; see
    :func:`tactile_toolkit.store.parquet.unpacked_bytes`.
    """

    split: str
    shards: tuple[Shard, ...]
    paths: tuple[str, ...]
    rows: int
    file_bytes: int
    unpacked_bytes: int

    @property
    def pattern(self) -> str:
        """Path pattern of the shards of this split, as ``datasets`` writes it."""
        return f"{DATA_FOLDER}/{self.split}-*"


@dataclass(frozen=True)
class FolderFacts:
    """A whole folder: its splits in canonical order, and their schema."""

    splits: tuple[SplitFacts, ...]
    schema: Any

    @property
    def rows(self) -> int:
        """Rows of all splits."""
        return sum(split.rows for split in self.splits)

    @cached_property
    def features(self) -> list[dict[str, Any]]:
        """Columns as `datasets` describes them in a card."""
        return yaml_features(self.schema)


def recorded_facts(folder: DataFolder, manifest: Manifest | None, schema: Any = None) -> FolderFacts:
    """Return the facts of a folder as its manifest records them, without opening a file where it does.

    ``schema`` is that of rows that this version of the toolkit makes. Folders made by others, and by version
    0.1.0, lack the records: their files are read. So is the first footer where the schema is not known.
    """
    if manifest is None or not manifest.shards:
        return folder_facts(folder)
    splits = []
    for split in manifest.splits:
        records = manifest.shards_of(split)
        sizes = [record.unpacked_bytes for record in records if isinstance(record.unpacked_bytes, int)]
        if len(sizes) < len(records):
            return folder_facts(folder)
        paths = tuple(record.shard.data_path for record in records)
        rows = [record.rows for record in records]
        shards = tuple(Shard(folder.address(path), count) for path, count in zip(paths, rows, strict=True))
        file_bytes = sum(record.bytes for record in records)
        splits.append(SplitFacts(split, shards, paths, sum(rows), file_bytes, sum(sizes)))
    if schema is None or manifest.toolkit_version != toolkit_version():
        schema = splits[0].shards[0].schema
    return FolderFacts(tuple(splits), schema)


def folder_facts(folder: DataFolder) -> FolderFacts:
    """Read the facts of a folder from the footers of its Parquet files, and their names from its manifest.

    Raises InputError when it holds no Parquet files, and IntegrityError when one is missing or damaged.
    """
    manifest = read_manifest(folder)
    splits = []
    for split in available_splits(folder):
        if manifest is not None:
            paths = tuple(record.shard.data_path for record in manifest.shards_of(split))
        else:
            root = f"{folder.address()}/"
            paths = tuple(shard.path.removeprefix(root) for shard in find_shards(folder.address(), split))
        shards = tuple(Shard(folder.address(path)) for path in paths)
        rows = sum(len(shard) for shard in shards)
        file_bytes = sum(folder.size_bytes(path) for path in paths)
        unpacked = sum(unpacked_bytes(shard.metadata, shard.schema, shard.read) for shard in shards)
        splits.append(SplitFacts(split, shards, paths, rows, file_bytes, unpacked))
    if not splits:
        message = f"{folder.address()!r} holds no Parquet files; next: give the folder of a data set"
        raise InputError(message)
    return FolderFacts(tuple(splits), splits[0].shards[0].schema)
