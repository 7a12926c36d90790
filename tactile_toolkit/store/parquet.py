"""The Parquet bytes of shards and reports: encoding and opening."""

from __future__ import annotations

import contextlib
import hashlib
import io
import struct
import zlib
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import IO, Any

from tactile_toolkit import run
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.store.files import readable
from tactile_toolkit.store.folder import PENDING_FOLDER, DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.shards import ShardName, ShardRecord
from tactile_toolkit.system import usable_cores

_TAIL = struct.Struct("<I4s")  # length of the footer and Parquet's mark: how a file ends
_FOOTER_CHECKSUM = struct.Struct("<4sI")
# Stands before the CRC-32 of the footer that follows. Parquet has checksums of pages, none of the footer;
# what lies between them is passed over by readers that do not know of it.
_FOOTER_MARK = b"TTFC"
_TAIL_BYTES = 1 << 16
_PAGE_BYTES = 1 << 20
_SMALL_PAGE_BYTES = 32 << 10
_CONTENT_CHUNKS = {"min_chunk_size": 1 << 10, "max_chunk_size": 1 << 20}
_BUFFER_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class ParquetStyle:
    """How a kind of data set is laid out in Parquet.

    Row groups stay well under 100 MB so that reading one row is cheap. Columns with an encoding of their own
    (path, encoding) get neither a dictionary nor statistics.

    A page ends at 1 MiB; with ``values_per_page``, with the row in which it has so many values of its column,
    if that is 32 KiB at least: a changed row then leaves the pages after its own as they were. With
    ``chunks_by_content`` Arrow ends pages where the content requires it, eight rows apart or more: for rows
    of some 100 kB at most, several of which differ in size. With ``page_index`` the file has an index of its
    pages.
    """

    rows_per_group: int
    compression: str = "zstd"
    compression_level: int | None = 9
    encodings: tuple[tuple[str, str], ...] = ()
    values_per_page: int | None = None
    chunks_by_content: bool = False
    page_index: bool = True


REPORT_STYLE = ParquetStyle(rows_per_group=1 << 16, page_index=False)  # reports are small, and read whole


def encode_parquet(table: Any, style: ParquetStyle) -> bytes:
    """Encode an Arrow table as the bytes of a Parquet file; equal tables, equal bytes."""
    stream = io.BytesIO()
    _write(stream.write, table.schema, [table], style)
    return stream.getvalue()


def stream_parquet(stream: IO[bytes], tables: Iterable[Any], style: ParquetStyle) -> str:
    """Write tables, one after another, as the bytes that :func:`encode_parquet` gives of all of them at once.

    Only a row group is held at a time. Returns the SHA-256 of what was written.
    """
    digest = hashlib.sha256()

    def write(content: Any) -> None:
        digest.update(content)
        stream.write(content)

    groups = _whole_groups(tables, style.rows_per_group)
    first = next(groups)
    _write(write, first.schema, chain([first], groups), style)
    return digest.hexdigest()


def _whole_groups(tables: Iterable[Any], rows: int) -> Iterator[Any]:
    """Yield tables of so many rows each, the last of fewer."""
    import pyarrow as pa

    held: list[Any] = []
    for table in tables:
        held.append(table)
        while sum(map(len, held)) > rows:
            whole = pa.concat_tables(held)
            yield whole.slice(0, rows)
            held = [whole.slice(rows)]
    yield pa.concat_tables(held)


def _write(write: Callable[[bytes], object], schema: Any, groups: Iterable[Any], style: ParquetStyle) -> None:
    """Write tables of complete row groups as one file, forward only."""
    import pyarrow.parquet as pq

    encodings = dict(style.encodings)
    others = [path for path in _paths(schema) if path not in encodings] if encodings else True
    sink = _Sink(write)
    with pq.ParquetWriter(
        sink,
        schema,
        compression=style.compression,
        compression_level=style.compression_level,
        use_dictionary=others,
        column_encoding=encodings or None,
        write_statistics=others,
        data_page_size=_PAGE_BYTES if style.values_per_page is None else _SMALL_PAGE_BYTES,
        write_batch_size=style.values_per_page,  # after so many values Arrow looks whether the page is full
        use_content_defined_chunking=_CONTENT_CHUNKS if style.chunks_by_content else False,
        write_page_index=style.page_index,
        write_page_checksum=True,
    ) as writer:
        for table in groups:
            writer.write_table(table, row_group_size=style.rows_per_group)
        sink.tail = bytearray()
    sink.finish()


class _Sink(io.RawIOBase):
    """Passes on what is written, and puts the checksum of the footer before the footer."""

    def __init__(self, write: Callable[[bytes], object]) -> None:
        super().__init__()
        self._write = write
        self.tail: bytearray | None = None
        """Keeps back what is written, once it is there: the footer."""

    def writable(self) -> bool:
        return True

    def write(self, content: Any) -> int:
        if self.tail is not None:
            self.tail += content
        else:
            self._write(content)
        return len(content)

    def finish(self) -> None:
        """Write what was kept back."""
        tail = bytes(self.tail or b"")
        start = len(tail) - _TAIL.size - _TAIL.unpack_from(tail, len(tail) - _TAIL.size)[0]
        checksum = _FOOTER_CHECKSUM.pack(_FOOTER_MARK, zlib.crc32(memoryview(tail)[start : -_TAIL.size]))
        self._write(b"".join((tail[:start], checksum, tail[start:])))


@contextlib.contextmanager
def named_damage(address: str) -> Iterator[None]:
    """Turn Arrow's errors about a Parquet file into an IntegrityError that names it.

    Raises InputError where the file cannot be read for another reason than its content.
    """
    import pyarrow as pa

    try:
        with readable(address):
            yield
    except GeneratorExit:  # a pass left in its middle, maybe at exit, when Arrow's names are gone
        raise
    except FileNotFoundError as error:
        raise IntegrityError(
            f"{address!r} is missing", next="generate or download the data set again"
        ) from error
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        problem = f" is damaged, an intact Parquet file was expected ({error})"
        raise IntegrityError.in_file(address, problem) from error


def open_parquet(folder: DataFolder, path: str) -> Any:
    """Open a stored Parquet file; IntegrityError when it is missing or damaged."""
    with named_damage(folder.address(path)):
        return open_checked(folder.address(path) if folder.is_local else io.BytesIO(folder.read_bytes(path)))


def open_checked(source: str | IO[bytes], metadata: Any = None) -> Any:
    """Open a Parquet file, by its path or as a stream, so that what was damaged is refused when it is read.

    A flipped bit may unpack to other numbers without a word. ``metadata`` is the footer where it was read
    and checked before. Raises pyarrow.ArrowInvalid for a footer that
    does not match its checksum; reading pages that do not match theirs raises OSError.
    """
    import pyarrow.parquet as pq

    if metadata is None:
        _require_checked_footer(source)
    # Not mapped: a file that is cut while it is read would end the process. Buffering ahead starts a thread
    # of Arrow's, which aborts about 1 % of interpreters at their end.
    return pq.ParquetFile(
        source,
        metadata=metadata,
        buffer_size=_BUFFER_BYTES if isinstance(source, str) else 0,  # streams buffer themselves
        pre_buffer=False,
        page_checksum_verification=True,
    )


def _require_checked_footer(source: str | IO[bytes]) -> None:
    import pyarrow as pa

    with Path(source).open("rb") if isinstance(source, str) else contextlib.nullcontext(source) as stream:
        size = stream.seek(0, io.SEEK_END)
        # One read: streams from afar fetch this much at least.
        stream.seek(max(0, size - _TAIL_BYTES))
        tail = stream.read()
        length = _TAIL.unpack_from(tail, len(tail) - _TAIL.size)[0] if len(tail) > _TAIL.size else 0
        wanted = _FOOTER_CHECKSUM.size + length + _TAIL.size
        if len(tail) < wanted <= size:
            stream.seek(size - wanted)
            tail = stream.read()
        if wanted <= len(tail):
            mark, checksum = _FOOTER_CHECKSUM.unpack_from(tail, len(tail) - wanted)
            footer = memoryview(tail)[len(tail) - _TAIL.size - length : -_TAIL.size]
            if mark == _FOOTER_MARK and zlib.crc32(footer) != checksum:
                raise pa.ArrowInvalid("the footer does not match its checksum")


def sha256_hex(content: bytes) -> str:
    """Return the SHA-256 of bytes in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def file_sha256(folder: DataFolder, path: str) -> str:
    """Return the SHA-256 of a stored file, read in pieces."""
    with folder.open(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()  # type: ignore[arg-type]


def is_unchanged(folder: DataFolder, path: str, sha256: str) -> bool:
    """Return whether there is a file with some content."""
    return folder.exists(path) and file_sha256(folder, path) == sha256


def _paths(schema: Any) -> list[str]:
    """Return the paths of a schema's columns in a file, by which pyarrow takes them."""
    import pyarrow.parquet as pq

    file = io.BytesIO()
    pq.write_table(schema.empty_table(), file)
    columns = pq.ParquetFile(file).schema
    return [columns.column(index).path for index in range(len(columns))]


SOURCE_DIGEST = b"made_of"
"""Key of the schema's metadata: the checksum of the checksums of the shards."""

_SHARDS_TOGETHER = 1024
# Threads that read shards, which lie on other machines where there are many of them.
_READERS = 16


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
    if known and not pending and is_unchanged(folder, path, known):
        return known

    def write(stream: IO[bytes]) -> str:
        # What is read is let go before the new file takes its place.
        with contextlib.closing(_stored_rows(folder, path)) as stored:
            return stream_parquet(stream, _tables(folder, records, pending, stored), REPORT_STYLE)

    try:
        return folder.write(path, write)
    except IntegrityError as error:
        raise IntegrityError(
            f"{error.what}; nothing was changed", next="run the same command again with --check"
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
    is_whole = is_unchanged(folder, file.path, checksum)
    metadata = open_parquet(folder, file.path).schema_arrow.metadata if is_whole else None
    return bool((metadata or {}).get(SOURCE_DIGEST) == file.made_of.encode())


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

    workers = min(usable_cores(), _READERS) if folder.is_local else _READERS
    tables = list(run.in_threads(read, file.records, workers))
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
