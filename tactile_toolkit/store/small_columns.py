"""Files of small columns: labels, ids and the like of a thousand shards each, so that not all are opened.

Splits of few shards have none. A file says of which shards it was made; where those are others by now, or it
cannot be read, the shards themselves are asked.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import (
    REPORT_STYLE,
    encode_parquet,
    file_sha256,
    named_damage,
    open_parquet,
    sha256_hex,
)
from tactile_toolkit.store.shards import ShardRecord

MADE_OF = b"made_of"
"""Key of the schema's metadata: the checksum of the checksums of the shards."""

_SHARDS_TOGETHER = 1024
_READERS = 16
"""Threads that read shards, which lie on other machines where there are many of them."""


@dataclass(frozen=True, slots=True)
class SmallFile:
    """A file of small columns: its path, its rows, and the shards that it must have been made of."""

    path: str
    records: tuple[ShardRecord, ...]

    @property
    def rows(self) -> int:
        """Rows of all its shards."""
        return sum(record.rows for record in self.records)

    @property
    def made_of(self) -> str:
        """What the file says of the shards that it was made of."""
        return sha256_hex("".join(record.sha256 for record in self.records).encode())


def small_files(manifest: Manifest, split: str) -> list[SmallFile]:
    """Return the files of small columns that a split has or is to have; none where it has few shards."""
    records = manifest.shards_of(split)
    if len(records) < _SHARDS_TOGETHER or len(records) < records[0].shard.count:
        return []
    starts = range(0, len(records), _SHARDS_TOGETHER)
    return [
        SmallFile(
            f"reports/columns-{split}-{number:05d}-of-{len(starts):05d}.parquet",
            records[start : start + _SHARDS_TOGETHER],
        )
        for number, start in enumerate(starts)
    ]


def write_small_columns(folder: DataFolder, manifest: Manifest) -> dict[str, str]:
    """Write the files of small columns of each split, and return their checksums by path.

    Those that are as they should be stay. Raises IntegrityError when a shard is damaged.
    """
    checksums = {}
    for split in manifest.splits:
        for file in small_files(manifest, split):
            known = (manifest.files or {}).get(file.path)
            if known is None or not _is_current(folder, file, known):
                content = encode_parquet(_small_table(folder, file), REPORT_STYLE)
                folder.write_bytes(file.path, content)
                known = sha256_hex(content)
            checksums[file.path] = known
    return checksums


def _is_current(folder: DataFolder, file: SmallFile, checksum: str) -> bool:
    if not folder.exists(file.path) or file_sha256(folder, file.path) != checksum:
        return False
    try:
        metadata = open_parquet(folder, file.path).schema_arrow.metadata or {}
    except IntegrityError:
        return False
    return bool(metadata.get(MADE_OF) == file.made_of.encode())


def _small_table(folder: DataFolder, file: SmallFile) -> Any:
    import pyarrow as pa

    def read(record: ShardRecord) -> Any:
        path = record.shard.data_path
        with named_damage(folder.address(path)):
            parquet = open_parquet(folder, path)
            return _flat(parquet.read(columns=_plain_columns(parquet.schema), use_threads=False))

    workers = min(os.cpu_count() or 1, _READERS) if folder.is_local else _READERS
    tables = list(in_threads(read, file.records, workers))
    # What not all shards have in one type is left to them.
    names = [
        field.name
        for field in tables[0].schema
        if all(
            field.name in table.schema.names and table.schema.field(field.name).type == field.type
            for table in tables
        )
    ]
    table = pa.concat_tables([table.select(names).replace_schema_metadata(None) for table in tables])
    return table.combine_chunks().replace_schema_metadata({MADE_OF: file.made_of.encode()})


def _flat(table: Any) -> Any:
    """Return a table with the fields of structs as columns by dotted names."""
    import pyarrow as pa

    while any(pa.types.is_struct(data_type) for data_type in table.schema.types):
        table = table.flatten()
    return table


def _plain_columns(schema: Any) -> list[str]:
    """Return the paths of columns of one value for each row: no lists, no pictures or clips."""
    columns = (schema.column(index) for index in range(len(schema.names)))
    return [
        column.path
        for column in columns
        if column.max_repetition_level == 0
        and (column.physical_type != "BYTE_ARRAY" or column.logical_type.type == "STRING")
    ]
