"""What a card says in numbers: splits, files, rows, bytes and columns of a data set folder."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tactile_toolkit.cards.features import yaml_features
from tactile_toolkit.cards.sizes import unpacked_bytes
from tactile_toolkit.catalog.locate import available_splits, find_shards
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import read_manifest
from tactile_toolkit.store.shards import DATA_FOLDER

__all__ = ["FolderFacts", "SplitFacts", "folder_facts"]


@dataclass(frozen=True)
class SplitFacts:
    """One split.

    Attributes
    ----------
    split : str
        Its name.
    shards : tuple of Shard
        Its files.
    paths : tuple of str
        The same inside the folder.
    rows : int
        Rows by the footers of the files.
    file_bytes : int
        Size of the files.
    unpacked_bytes : int
        Size of the rows in memory; see :func:`tactile_toolkit.cards.sizes.unpacked_bytes`.
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
    """A whole folder.

    Attributes
    ----------
    splits : tuple of SplitFacts
        In canonical order.
    schema : pyarrow.Schema
        Of the first file.
    """

    splits: tuple[SplitFacts, ...]
    schema: Any

    @property
    def rows(self) -> int:
        """Rows of all splits."""
        return sum(split.rows for split in self.splits)

    @property
    def features(self) -> list[dict[str, Any]]:
        """Columns as `datasets` describes them in a card."""
        return yaml_features(self.schema)


def folder_facts(folder: DataFolder) -> FolderFacts:
    """Read the facts of a folder from its manifest, if it has one, and the footers of its Parquet files.

    Raises
    ------
    InputError
        When it holds no Parquet files.
    IntegrityError
        When a file is missing or damaged.
    """
    splits = tuple(_split_facts(folder, split) for split in available_splits(folder))
    if not splits:
        message = f"{folder.address()!r} holds no Parquet files; next: give the folder of a data set"
        raise InputError(message)
    return FolderFacts(splits, splits[0].shards[0].schema)


def _split_facts(folder: DataFolder, split: str) -> SplitFacts:
    paths = _paths(folder, split)
    shards = tuple(Shard(folder.address(path)) for path in paths)
    return SplitFacts(
        split,
        shards,
        paths,
        rows=sum(len(shard) for shard in shards),
        file_bytes=sum(folder.size_bytes(path) for path in paths),
        unpacked_bytes=unpacked_bytes(shards),
    )


def _paths(folder: DataFolder, split: str) -> tuple[str, ...]:
    manifest = read_manifest(folder)
    if manifest is not None:
        return tuple(receipt.shard.data_path for receipt in manifest.receipts_of(split))
    root = f"{folder.address()}/"
    return tuple(shard.path.removeprefix(root) for shard in find_shards(folder.address(), split))
