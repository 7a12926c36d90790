"""Files of foreign formats beside the rows: an index in Parquet vouches for each by its checksum."""

from __future__ import annotations

from typing import Any

import pyarrow as pa

from realtouch.convert.plan import WithFiles
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import is_unchanged, sha256_hex
from tactile_toolkit.store.shards import ShardRecord

__all__ = ["file_fields", "files_are_current", "files_of", "vouched_files", "with_files"]

_PATHS, _CHECKSUMS = "file", "sha256"
_PREFIXES = ("", "meta_")


def file_fields(count: int) -> list[tuple[str, pa.DataType]]:
    """Return the columns of an index that name so many files for each row."""
    names = [f"{prefix}{name}" for prefix in _PREFIXES[:count] for name in (_PATHS, _CHECKSUMS)]
    return [(name, pa.string()) for name in names]


def with_files(index: pa.Table, files: dict[str, bytes]) -> WithFiles:
    """Return the files of a shard with its index, in each row of which they are named."""
    for prefix, (path, content) in zip(_PREFIXES, files.items(), strict=False):
        for name, value in ((_PATHS, path), (_CHECKSUMS, sha256_hex(content))):
            index = index.append_column(f"{prefix}{name}", pa.array([value] * len(index), pa.string()))
    return WithFiles(index, files)


def files_of(folder: DataFolder, record: ShardRecord) -> dict[str, str]:
    """Return the checksum of each file that the index of a finished shard names, by path."""
    shard = Shard(folder.address(record.shard.data_path))
    found: dict[str, str] = {}
    for prefix in _PREFIXES:
        names = [f"{prefix}{_PATHS}", f"{prefix}{_CHECKSUMS}"]
        if record.rows and all(name in shard.types for name in names):
            paths, checksums = (column.unique().to_pylist() for column in shard.read(columns=names).columns)
            found |= dict(zip(paths, checksums, strict=True))
    return found


def files_are_current(folder: DataFolder, record: ShardRecord, reads: bool) -> bool:
    """Return whether every file that a finished shard names is there and, if read, unchanged."""
    files = files_of(folder, record).items()
    return all(is_unchanged(folder, path, checksum, reads) for path, checksum in files)


def vouched_files(folder: DataFolder, manifest: Manifest) -> dict[str, Any]:
    """Return the checksum of each file that the shards name, for the manifest."""
    return {
        path: checksum for record in manifest.shards for path, checksum in files_of(folder, record).items()
    }
