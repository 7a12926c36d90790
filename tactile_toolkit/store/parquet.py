"""Parquet files: encoded from Arrow tables, opened so that damage is noticed, and merged into reports."""

from __future__ import annotations

import contextlib
import hashlib
import io
import struct
import zlib
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import IO, TYPE_CHECKING

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.store.files import open_regular, unreadable
from tactile_toolkit.store.folder import PENDING_FOLDER, DataFolder
from tactile_toolkit.store.manifest import Manifest, ShardName, ShardRecord

if TYPE_CHECKING:
    from typing_extensions import Buffer


_TAIL = struct.Struct("<I4s")  # length of the footer and Parquet's mark: how a file ends
_FOOTER_CHECKSUM = struct.Struct("<4sI")

# Precedes the CRC-32 of the footer that follows. Parquet has checksums of pages, but none of the footer;
# readers skip bytes between the two.
_FOOTER_MARK = b"TTFC"
_TAIL_BYTES = 1 << 16
_PAGE_BYTES = 1 << 20
_SMALL_PAGE_BYTES = 32 << 10
_CONTENT_CHUNKS = {"min_chunk_size": 1 << 10, "max_chunk_size": 1 << 20}
_BUFFER_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class ParquetStyle:
    """Parquet layout of a kind of data set.

    Row groups stay well under 100 MB, so that reading one row is cheap. Columns with an entry in
    ``encodings`` (path, encoding) get neither a dictionary nor statistics.

    A page ends at 1 MiB. With ``values_per_page`` it ends with the row that completes this number of values,
    once it has 32 KiB: then a changed row leaves later pages unchanged. With ``chunks_by_content`` Arrow ends
    pages by their content, at least eight rows apart: for rows of at most about 100 kB that differ in size.
    With ``page_index`` the file has an index of its pages.
    """

    rows_per_group: int
    compression: str = "zstd"
    compression_level: int | None = 9
    encodings: tuple[tuple[str, str], ...] = ()
    values_per_page: int | None = None
    chunks_by_content: bool = False
    page_index: bool = True

    def encode(self, table: pa.Table) -> bytes:
        """Encode an Arrow table as the bytes of a Parquet file; equal tables, equal bytes."""
        stream = io.BytesIO()
        _write(stream.write, table.schema, [table], self)
        return stream.getvalue()


# Reports are small, and read as a whole.
REPORT_STYLE = ParquetStyle(rows_per_group=1 << 16, page_index=False)


def stream_parquet(stream: IO[bytes], tables: Iterable[pa.Table], style: ParquetStyle) -> str:
    """Write tables, one after another, as the bytes of :meth:`ParquetStyle.encode` for all of them together.

    Only one row group is in memory at a time. Returns the SHA-256 of the bytes.
    """
    digest = hashlib.sha256()

    def write(content: bytes | memoryview) -> None:
        digest.update(content)
        stream.write(content)

    groups = _whole_groups(tables, style.rows_per_group)
    first = next(groups)
    _write(write, first.schema, chain([first], groups), style)
    return digest.hexdigest()


def _whole_groups(tables: Iterable[pa.Table], rows: int) -> Iterator[pa.Table]:
    """Yield tables of this number of rows, the last of fewer."""
    held: list[pa.Table] = []
    for table in tables:
        held.append(table)
        while sum(map(len, held)) > rows:
            whole = pa.concat_tables(held)
            yield whole.slice(0, rows)
            held = [whole.slice(rows)]
    yield pa.concat_tables(held)


def _write(
    write: Callable[[bytes | memoryview], object],
    schema: pa.Schema,
    groups: Iterable[pa.Table],
    style: ParquetStyle,
) -> None:
    """Write tables of complete row groups as one file, forward only."""
    encodings = dict(style.encodings)
    others: list[str] | bool = True
    if encodings:
        others = [path for path in _paths(schema) if path not in encodings]
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
        write_batch_size=style.values_per_page,  # Arrow checks after these whether the page is full
        use_content_defined_chunking=style.chunks_by_content and _CONTENT_CHUNKS,
        write_page_index=style.page_index,
        write_page_checksum=True,
    ) as writer:
        for table in groups:
            writer.write_table(table, row_group_size=style.rows_per_group)
        sink.tail = bytearray()
    sink.finish()


class _Sink(io.RawIOBase):
    """A stream that inserts the checksum of the footer before the footer."""

    def __init__(self, write: Callable[[bytes | memoryview], object]) -> None:
        super().__init__()
        self._write = write
        self.tail: bytearray | None = None
        """Holds back what is written, if set: the footer."""

    def writable(self) -> bool:
        return True

    def write(self, content: Buffer) -> int:
        view = memoryview(content)
        if self.tail is not None:
            self.tail += view
        else:
            self._write(view)
        return view.nbytes

    def finish(self) -> None:
        """Write the footer that was held back."""
        tail = bytes(self.tail or b"")
        start = len(tail) - _TAIL.size - _TAIL.unpack_from(tail, len(tail) - _TAIL.size)[0]
        checksum = _FOOTER_CHECKSUM.pack(_FOOTER_MARK, zlib.crc32(memoryview(tail)[start : -_TAIL.size]))
        self._write(b"".join((tail[:start], checksum, tail[start:])))


@contextlib.contextmanager
def named_damage(address: str) -> Iterator[None]:
    """Turn Arrow's errors about a Parquet file into an IntegrityError that names it.

    Raises InputError if the file cannot be read for another reason than its content.
    """
    try:
        yield
    except GeneratorExit:  # an unfinished iteration, perhaps at exit, when Arrow's names are gone
        raise
    except FileNotFoundError as error:
        raise IntegrityError(
            f"{address!r} is missing", next="generate or download the data set again"
        ) from error
    except UnicodeEncodeError as error:
        raise InputError(
            f"the name of {address!r} is not valid UTF-8, and Arrow opens no such file", next="rename it"
        ) from error
    except (pa.ArrowException, OSError, MemoryError, UnicodeDecodeError) as error:
        refused = unreadable(address, error)
        if refused is not None:
            raise refused from error
        problem = f" is damaged, an intact Parquet file was expected ({error})"
        raise IntegrityError.in_file(address, problem) from error


def open_checked(
    source: str | IO[bytes], metadata: pq.FileMetaData | None = None, *, checks_columns: bool = False
) -> pq.ParquetFile:
    """Open a Parquet file, by its path or as a stream, so that reading compares checksums.

    Otherwise a flipped bit may unpack to other numbers silently. ``metadata`` is the footer, if it was read
    and checked before. Raises pyarrow.ArrowInvalid for a footer that does not match its checksum, and
    IntegrityError for a pipe or a device; reading pages that do not match their checksums raises OSError.
    With ``checks_columns``, all columns are checked as by :func:`require_sound_columns`.
    """
    if metadata is None:
        _require_checked_footer(source)
    # No memory map: truncating the file while it is read would end the process. Pre-buffering starts a thread
    # of Arrow, which aborts about 1 % of interpreters at exit.
    file = pq.ParquetFile(
        source,
        metadata=metadata,
        buffer_size=_BUFFER_BYTES if isinstance(source, str) else 0,  # streams buffer themselves
        pre_buffer=False,
        page_checksum_verification=True,
    )
    if checks_columns:
        require_sound_columns(source, file.metadata, range(file.num_row_groups))
    return file


def require_sound_columns(source: str | IO[bytes], metadata: pq.FileMetaData, groups: Iterable[int]) -> None:
    """Raise OSError if a footer contradicts the type of a column.

    Arrow aborts the process when the statistics of such a column are read from the footer, but not when the
    column itself is read. So the column is read here, but no row of it. (Found in pyarrow 26.0.1, by changing
    bytes of files.)
    """
    # A buffer is needed: without one, Arrow reads whole columns at once, even if no row is asked for.
    with pq.ParquetFile(source, metadata=metadata, buffer_size=_BUFFER_BYTES, pre_buffer=False) as file:
        for group in groups:
            next(file.reader.iter_batches(0, [group], column_indices=None, use_threads=False), None)


def _require_checked_footer(source: str | IO[bytes]) -> None:
    with open_regular(source) if isinstance(source, str) else contextlib.nullcontext(source) as stream:
        size = stream.seek(0, io.SEEK_END)
        # One read: remote streams fetch at least this much.
        stream.seek(max(0, size - _TAIL_BYTES))
        tail = stream.read()
        length = _TAIL.unpack_from(tail, len(tail) - _TAIL.size)[0] if len(tail) > _TAIL.size else 0
        needed_bytes = _FOOTER_CHECKSUM.size + length + _TAIL.size
        if len(tail) < needed_bytes <= size:
            stream.seek(size - needed_bytes)
            tail = stream.read()
        if needed_bytes <= len(tail):
            mark, checksum = _FOOTER_CHECKSUM.unpack_from(tail, len(tail) - needed_bytes)
            footer = memoryview(tail)[len(tail) - _TAIL.size - length : -_TAIL.size]
            if mark == _FOOTER_MARK and zlib.crc32(footer) != checksum:
                raise pa.ArrowInvalid("the footer does not match its checksum")


def _paths(schema: pa.Schema) -> list[str]:
    """Return the paths of a schema's columns in a Parquet file."""
    file = io.BytesIO()
    pq.write_table(schema.empty_table(), file)
    columns = pq.ParquetFile(file).schema
    return [columns.column(index).path for index in range(len(columns))]


def report_pieces(folder: DataFolder, path: str, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
    """Yield a report, or some of its columns, as Arrow tables, one for each row group.

    Raises IntegrityError when the file is missing or damaged.
    """
    address = folder.address(path)
    with contextlib.ExitStack() as stack, named_damage(address):
        source = address if folder.is_local else stack.enter_context(folder.open(path))
        parquet = stack.enter_context(open_checked(source))
        for group in range(parquet.num_row_groups):
            # Arrow's threads are not started, see open_checked.
            yield parquet.read_row_group(group, columns=columns, use_threads=False)


def merge_reports(folder: DataFolder, path: str, manifest: Manifest) -> str | None:
    """Write one report over all shards of the manifest and return its checksum; None if no shard has one.

    Rows of shards from an earlier run are copied from its report. The order is that of the manifest, so the
    bytes do not depend on the order of the work. A report of the same shards is not rewritten. Raises
    IntegrityError if rows are missing.
    """
    records = [record for record in manifest.shards if record.report_sha256]
    if not records:
        return None
    names = set(folder.names(PENDING_FOLDER))
    paths = {record.shard: record.shard.report_path for record in records}
    pending = {shard: path for shard, path in paths.items() if path.rpartition("/")[2] in names}
    known = manifest.files.get(path)
    if known and not pending and folder.has_sha256(path, known):
        return known

    def write(stream: IO[bytes]) -> str:
        # The old file is closed before the new one replaces it.
        with contextlib.closing(_stored_rows(folder, path)) as stored:
            return stream_parquet(stream, _tables(folder, records, pending, stored), REPORT_STYLE)

    try:
        return folder.write(path, write)
    except IntegrityError as error:
        raise IntegrityError(
            f"{error.what}; nothing was changed", next="run the same command again with --repair"
        ) from error


def _tables(
    folder: DataFolder,
    records: Sequence[ShardRecord],
    pending: Mapping[ShardName, str],
    stored: Iterator[tuple[str, pa.Table]],
) -> Iterator[pa.Table]:
    """Yield the report rows of shards in order; ``pending`` are the files of those not merged yet."""
    contents = folder.read_many(list(pending.values()))
    for record in records:
        content = next(contents) if record.shard in pending else None
        table = None
        # The content may be missing, if another run of the same job has just merged it.
        if content is not None and hashlib.sha256(content).hexdigest() == record.report_sha256:
            with contextlib.suppress(IntegrityError), named_damage(pending[record.shard]):
                table = open_checked(io.BytesIO(content)).read(use_threads=False)
        if table is None and record.rows:
            table = next((rows for name, rows in stored if name == str(record.shard)), None)
            row_count = len(table or ())
            if row_count != record.rows:
                raise IntegrityError(
                    f"the report holds {row_count:,} rows of shard {record.shard}, expected {record.rows:,}"
                )
        if table is not None:
            yield table


def _stored_rows(folder: DataFolder, path: str) -> Generator[tuple[str, pa.Table], None, None]:
    """Yield the name of each shard in a merged report with its rows, which are contiguous."""
    last = ""
    held: list[pa.Table] = []
    for piece in report_pieces(folder, path):
        runs = pc.run_end_encode(piece["shard"].combine_chunks())
        start = 0
        for name, end in zip(runs.values.to_pylist(), runs.run_ends.to_pylist(), strict=True):
            if name != last and held:
                yield last, pa.concat_tables(held)
                held = []
            held.append(piece.slice(start, end - start))
            last, start = name, end
    if held:
        yield last, pa.concat_tables(held)
