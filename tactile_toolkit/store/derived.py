"""Files that follow from all shards: the report, and small columns of many shards; a row group at a time.

Small columns are labels, ids and the like of a thousand shards each, so that not all are opened; splits of
few shards have none. A file says of which shards it was made; where those are others by now, or it cannot be
read, the shards themselves are asked.
"""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Collection, Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import IO, Any

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.folder import PENDING_FOLDER, DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import (
    REPORT_STYLE,
    encode_parquet,
    file_sha256,
    named_damage,
    open_checked,
    open_parquet,
    sha256_hex,
    stream_parquet,
)
from tactile_toolkit.store.shards import ShardName, ShardRecord

SOURCE_DIGEST = b"made_of"
"""Key of the schema's metadata: the checksum of the checksums of the shards."""

_SHARDS_TOGETHER = 1024
# Threads that read shards, which lie on other machines where there are many of them.
_READERS = 16


def report_columns(folder: DataFolder, path: str) -> list[str]:
    """Return the names of the columns of a report; IntegrityError where it is missing or damaged."""
    return list(open_parquet(folder, path).schema_arrow.names)


def report_pieces(folder: DataFolder, path: str, columns: Sequence[str] | None = None) -> Iterator[Any]:
    """Yield a report, or some of its columns, as Arrow tables, one for each row group.

    Raises IntegrityError when the file is missing or damaged.
    """
    with contextlib.ExitStack() as stack, named_damage(folder.address(path)):
        source = folder.address(path) if folder.is_local else stack.enter_context(folder.open(path))
        parquet = stack.enter_context(open_checked(source))
        for group in range(parquet.num_row_groups):
            # Arrow's threads are not started, see open_checked.
            yield parquet.read_row_group(group, columns=columns, use_threads=False)


def read_report(folder: DataFolder, path: str, columns: Sequence[str] | None = None) -> Any:
    """Read a report, or some of its columns, as one Arrow table; raises as :func:`report_pieces`."""
    import pyarrow as pa

    return pa.concat_tables(report_pieces(folder, path, columns))


def merge_reports(folder: DataFolder, path: str, manifest: Manifest) -> str | None:
    """Write one report over all shards of the manifest and return its checksum; None where none has rows.

    Rows of shards finished in an earlier run come from the report that run wrote; the order is always that
    of the manifest, so the bytes do not depend on the order of the work. Where that report is of the same
    shards it stays as it is. Raises IntegrityError where rows are missing.
    """
    records = [record for record in manifest.shards if record.report_sha256]
    if not records:
        return None
    stored = {f"{PENDING_FOLDER}/{name}" for name in folder.names(PENDING_FOLDER)}
    pending = {record.shard for record in records if record.shard.report_path in stored}
    known = manifest.files.get(path)
    if known and not pending and folder.exists(path) and file_sha256(folder, path) == known:
        return known

    def write(stream: IO[bytes]) -> str:
        # What is read is let go before the new file takes its place.
        with contextlib.closing(_stored_rows(folder, path)) as stored:
            return stream_parquet(stream, _tables(folder, records, pending, stored), REPORT_STYLE)

    try:
        return folder.write(path, write)
    except IntegrityError as error:
        raise IntegrityError(
            f"{error}; nothing was changed", next="run the same command again with --check"
        ) from error


def _tables(
    folder: DataFolder,
    records: Sequence[ShardRecord],
    pending: Collection[ShardName],
    stored: Iterator[tuple[str, Any]],
) -> Iterator[Any]:
    """Yield the report rows of each of these shards, in their order, which is that of the stored ones."""
    contents = folder.read_many([each.shard.report_path for each in records if each.shard in pending])
    for record in records:
        content = next(contents) if record.shard in pending else None
        table = None
        # It is removed where another run of the same ends at this moment, which has merged it.
        if content is not None and sha256_hex(content) == record.report_sha256:
            with contextlib.suppress(IntegrityError), named_damage(record.shard.report_path):
                table = open_checked(io.BytesIO(content)).read(use_threads=False)
        if table is None and record.rows:
            table = next((rows for name, rows in stored if name == str(record.shard)), None)
            found = 0 if table is None else len(table)
            if found != record.rows:
                raise IntegrityError(
                    f"the report holds {found:,} rows of shard {record.shard}, expected {record.rows:,}"
                )
        if table is not None:
            yield table


def _stored_rows(folder: DataFolder, path: str) -> Generator[tuple[str, Any], None, None]:
    """Yield the shards of a report that a run has merged, each with its rows, which are contiguous."""
    import pyarrow as pa
    import pyarrow.compute as pc

    last = ""
    held: list[Any] = []
    for piece in report_pieces(folder, path):
        runs, start = pc.run_end_encode(piece["shard"].combine_chunks()), 0
        for name, end in zip(runs.values.to_pylist(), runs.run_ends.to_pylist(), strict=True):
            if name != last and held:
                yield last, pa.concat_tables(held)
                held = []
            held.append(piece.slice(start, end - start))
            last, start = name, end
    if held:
        yield last, pa.concat_tables(held)


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
            known = manifest.files.get(file.path)
            if known is None or not _is_current(folder, file, known):
                content = encode_parquet(_small_table(folder, file), REPORT_STYLE)
                folder.write_bytes(file.path, content)
                known = sha256_hex(content)
            checksums[file.path] = known
    return checksums


def _is_current(folder: DataFolder, file: SmallFile, checksum: str) -> bool:
    if not folder.exists(file.path) or file_sha256(folder, file.path) != checksum:
        return False
    metadata = open_parquet(folder, file.path).schema_arrow.metadata or {}
    return bool(metadata.get(SOURCE_DIGEST) == file.made_of.encode())


def _small_table(folder: DataFolder, file: SmallFile) -> Any:
    import pyarrow as pa

    def read(record: ShardRecord) -> Any:
        with named_damage(folder.address(record.file)):
            parquet = open_parquet(folder, record.file)
            table = parquet.read(columns=_plain_columns(parquet.schema), use_threads=False)
        # The fields of structs are columns by dotted names.
        while any(pa.types.is_struct(data_type) for data_type in table.schema.types):
            table = table.flatten()
        return table

    workers = min(os.cpu_count() or 1, _READERS) if folder.is_local else _READERS
    tables = list(in_threads(read, file.records, workers))
    # Columns that differ between shards are read from the shards.
    every = [dict(zip(table.schema.names, table.schema.types, strict=True)) for table in tables]
    names = [
        field.name
        for field in tables[0].schema
        if all(types.get(field.name) == field.type for types in every)
    ]
    table = pa.concat_tables([table.select(names).replace_schema_metadata(None) for table in tables])
    return table.combine_chunks().replace_schema_metadata({SOURCE_DIGEST: file.made_of.encode()})


def _plain_columns(schema: Any) -> list[str]:
    """Return the paths of columns of one value for each row: no lists, no pictures or clips."""
    columns = (schema.column(index) for index in range(len(schema.names)))
    return [
        column.path
        for column in columns
        if column.max_repetition_level == 0
        and (column.physical_type != "BYTE_ARRAY" or column.logical_type.type == "STRING")
    ]
