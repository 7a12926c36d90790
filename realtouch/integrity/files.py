"""Files next to the rows: each row of the index names its own, with its checksum."""

from __future__ import annotations

from typing import Any

import pyarrow as pa

from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import is_unchanged, sha256_hex
from tactile_toolkit.store.shards import ShardRecord

_PREFIXES = ("", "meta_")


def file_fields(count: int) -> list[tuple[str, pa.DataType]]:
    """Return the columns of an index that name so many files for each row."""
    return [(f"{prefix}{name}", pa.string()) for prefix in _PREFIXES[:count] for name in ("file", "sha256")]


def with_files(index: pa.Table, files: dict[str, bytes]) -> tuple[pa.Table, dict[str, bytes]]:
    """Return the files of a shard with its index, in each row of which they are named."""
    for prefix, (path, content) in zip(_PREFIXES, files.items(), strict=False):
        for name, value in (("file", path), ("sha256", sha256_hex(content))):
            index = index.append_column(f"{prefix}{name}", pa.array([value] * len(index), pa.string()))
    return index, files


def files_of(folder: DataFolder, record: ShardRecord) -> dict[str, str]:
    """Return the checksum of each file that the index of a finished shard names, by path."""
    shard = Shard(folder.address(record.shard.data_path))
    found: dict[str, str] = {}
    for prefix in _PREFIXES:
        names = [f"{prefix}file", f"{prefix}sha256"]
        if all(name in shard.types for name in names):
            paths, digests = (column.to_pylist() for column in shard.read(columns=names).columns)
            found |= dict(zip(paths, digests, strict=True))
    return found


def files_are_current(folder: DataFolder, record: ShardRecord, reads: bool) -> bool:
    """Return whether every file that a finished shard names is there and, if read, unchanged."""
    return all(is_unchanged(folder, *file, reads) for file in files_of(folder, record).items())


def checksums(folder: DataFolder, manifest: Manifest) -> dict[str, Any]:
    """Return the checksum of each file that the shards name, for the manifest."""
    return {path: sha256 for record in manifest.shards for path, sha256 in files_of(folder, record).items()}


def write_changed(folder: DataFolder, path: str, content: bytes) -> str:
    """Write a file only where it differs: a run over a finished set changes nothing. Return its checksum."""
    if not folder.exists(path) or folder.read_bytes(path) != content:
        folder.write_bytes(path, content)
    return sha256_hex(content)
