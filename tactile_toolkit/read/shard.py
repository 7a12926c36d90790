"""One Parquet file of a data set: random access to its rows, and whether it is still the same file.

Reading one row of Parquet requires decoding its row group. Each row group is therefore decoded on first use
into Arrow files in the cache folder, which are mapped into memory; after that a row takes microseconds, in
all processes on the machine. Large row groups are unpacked in blocks of rows, so that memory is bounded and
no Arrow array exceeds its 32-bit offsets.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import re
import warnings
from array import array
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import accumulate
from typing import IO, TYPE_CHECKING, TypeAlias

import pyarrow as pa

from tactile_toolkit import cache, errors, store
from tactile_toolkit.read import blocks, schemas
from tactile_toolkit.read.record import RowGroup
from tactile_toolkit.read.schemas import class_names, column_types

if TYPE_CHECKING:
    from pyarrow import parquet

_BLOCK_BYTES = 64 << 20
# Unpacked sizes of physical types of Parquet; others take at least four bytes, a number or an offset.
_VALUE_BYTES = {"BOOLEAN": 1, "INT64": 8, "DOUBLE": 8, "INT96": 12}
# A row group that expands by more than this might be a single row; padding of clips expands about 20 times.
_MAX_EXPANSION = 500

Footer: TypeAlias = "tuple[parquet.FileMetaData, pa.Schema]"

# Metadata and Arrow schema by content and stated rows, some hundred kB for a large shard. The schema object
# of the metadata is not kept, because both refer to each other and would wait for the garbage collector.
_FOOTERS: cache.MemoryCache[tuple[str, int | None], Footer] = cache.MemoryCache(128)


@dataclass(frozen=True)
class Shard:
    """One Parquet file of a data set, local or at any fsspec address.

    ``rows`` and ``size_bytes`` are those of the manifest, if there is one: then rows are counted without
    opening the file, and a file with other values is refused. ``failures`` returns a context for reading a
    remote file, which converts errors of its store; it is pickled with the shard.
    """

    path: str
    rows: int | None = None
    failures: Callable[[], contextlib.AbstractContextManager[None]] = field(
        default=contextlib.nullcontext, repr=False, compare=False
    )
    size_bytes: int | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        # The identity of local files is cheap and noted now; a missing file is an error when it is read.
        if not self.is_remote:
            with contextlib.suppress(errors.ToolkitError):
                _ = self.identity

    @property
    def _footer(self) -> Footer:
        footer = _FOOTERS.get((self.digest, self.rows))
        if footer is None:
            with self._named_damage():
                footer = self._open()[1]
        return footer

    @property
    def metadata(self) -> parquet.FileMetaData:
        """The Parquet footer: row groups, columns, schema; read again if it was evicted.

        Raises IntegrityError if the file has none, or differs from the manifest in size.
        """
        return self._footer[0]

    def column_chunks(self) -> Iterator[pa.ChunkedArray]:
        """Yield what the footer says of each column chunk."""
        groups = map(self.metadata.row_group, range(self.metadata.num_row_groups))
        return (group.column(index) for group in groups for index in range(group.num_columns))

    @property
    def schema(self) -> pa.Schema:
        """The Arrow schema with supported types, to which rows are converted when decoded."""
        return self._footer[1]

    @property
    def types(self) -> dict[str, pa.DataType]:
        """Arrow type of each column, and of each struct, by dotted name."""
        return column_types(self.schema)

    @cached_property
    def class_names(self) -> tuple[str, ...] | None:
        """Class names that `datasets` stored, if any; IntegrityError if they cannot be read."""
        return class_names(self.schema, None, self.path)

    @cached_property
    def group_starts(self) -> array[int]:
        """First row of each row group, and the number of rows at the end."""
        metadata = self.metadata
        counts = (metadata.row_group(index).num_rows for index in range(metadata.num_row_groups))
        return array("q", [0, *accumulate(counts)])

    @cached_property
    def block_rows(self) -> array[int]:
        """Number of rows in a block of each row group; depends only on the file."""
        metadata = self.metadata
        groups = [metadata.row_group(index) for index in range(metadata.num_row_groups)]
        fitting = [_BLOCK_BYTES * group.num_rows // max(group.total_byte_size, 1) for group in groups]
        rows = (max(1, min(group.num_rows, rows)) for group, rows in zip(groups, fitting, strict=True))
        return array("q", rows)

    def __len__(self) -> int:
        return int(self.metadata.num_rows) if self.rows is None else self.rows

    def read(self, columns: Sequence[str] | None = None, groups: Sequence[int] | None = None) -> pa.Table:
        """Decode row groups, with all columns or those named (fields of structs by dotted name)."""
        with self._named_damage():
            parquet, (metadata, _) = self._open()
            wanted = range(metadata.num_row_groups) if groups is None else groups
            if columns is None:  # columns are not larger than their rows
                for index in wanted:
                    self._require_bounded(metadata, index)
            # No threads of Arrow, because shards are already read in parallel.
            return schemas.supported_table(
                parquet.read_row_groups(list(wanted), columns=columns, use_threads=False)
            )

    def column(self, name: str) -> pa.Array:
        """Read one column of all rows as an Arrow array, by dotted name; KeyError if it does not exist."""
        return RowGroup(self.read(columns=[name]), self.path).arrow(name)

    def locate(self, row: int) -> tuple[RowGroup, int]:
        """Return the row group, or block of one, that holds a row, and the index of the row in it."""
        group = bisect_right(self.group_starts, row) - 1
        number, index = divmod(row - self.group_starts[group], self.block_rows[group])
        return blocks.BLOCKS.get((self.digest, group, number)) or self.block(group, number), index

    def block(self, index: int, number: int) -> RowGroup:
        """Map one block of a row group into memory, unpacking the row group into the cache on its first use.

        If the cache cannot be written (full, read-only), the most recently used blocks are kept in the memory
        of this process.
        """
        key = self.digest, index, number

        def make() -> RowGroup:
            mapped = self._mapped(key) or (self._unpacked(index) and self._mapped(key))
            return mapped or self._decoded(index, number)

        return blocks.BLOCKS.get_or_make(key, make)

    def _mapped(self, key: blocks.Key) -> RowGroup | None:
        """Map a block of the cache; None if it is missing, or damaged and therefore removed."""
        file = blocks.block_file(key)
        try:
            table, size_bytes = blocks.map_block(file)
        except FileNotFoundError:
            return None
        except (ValueError, OSError) as error:
            if store.resource_shortage(error) is None:
                blocks.UNPACKED.drop(file)
            return None
        blocks.UNPACKED.mark_used(file)
        _, index, number = key
        first_row = self.group_starts[index] + number * self.block_rows[index]
        return RowGroup(table, self.path, first_row, size_bytes)

    def unpack(self, index: int) -> int:
        """Unpack a row group into the cache unless it is there; return its size in bytes, 0 on failure.

        One process of the machine unpacks it, others wait.
        """
        if not self._unpacked(index):
            return 0
        return max(1, int(self.metadata.row_group(index).total_byte_size))

    def _unpacked(self, index: int) -> bool:
        rows = self.group_starts[index + 1] - self.group_starts[index]
        numbers = range(-(-rows // self.block_rows[index]))
        files = [blocks.block_file((self.digest, index, number)) for number in numbers]
        if blocks.UNPACKED.is_given_up or blocks.are_kept(files):
            return not blocks.UNPACKED.is_given_up
        with contextlib.ExitStack() as stack:
            # 256 lock files for all row groups, because lock files stay in the cache.
            lock = cache.cache_folder() / cache.LOCKS / self.digest[:2]
            try:
                lock.parent.mkdir(parents=True, exist_ok=True)
                patience_s = 0.0 if lock in blocks.HELD_UP else None
                stack.enter_context(store.locked(lock, patience_s=patience_s, is_patient=True))
            except OSError:
                pass  # without locks, processes do not wait
            except errors.BusyError as error:
                if lock not in blocks.HELD_UP:
                    warnings.warn(
                        f"{error.what}; this process stops waiting for it", RuntimeWarning, stacklevel=2
                    )
                blocks.HELD_UP.add(lock)
            # Read each time, because a notebook may set the variable at any time.
            blocks.UNPACKED.limit_bytes = cache.cache_limit_bytes()
            # The previous holder of the lock may have unpacked all or part of it.
            return blocks.are_kept(files) or all(
                file.exists()
                or blocks.UNPACKED.write(
                    file.name, int(group.table.nbytes), partial(blocks.write_block, file.name, group.table)
                )
                for file, group in zip(files, self.blocks(index), strict=True)
            )

    def _decoded(self, index: int, number: int) -> RowGroup:
        """Decode a block, and some blocks before and after it in the row group."""
        found: RowGroup
        for reached, group in enumerate(self.blocks(index)):
            blocks.BLOCKS.put((self.digest, index, reached), group)
            if reached == number:
                found = group
            if reached + 1 == number + blocks.IN_MEMORY:
                break
        return found

    @cached_property
    def digest(self) -> str:
        """Digest of the identity of the file when it was first accessed."""
        return hashlib.sha256(repr((blocks.LAYOUT, self.identity)).encode()).hexdigest()[:32]

    def blocks(self, index: int, columns: Sequence[str] | None = None) -> Iterator[RowGroup]:
        """Decode the blocks of a row group one by one, without caching; all columns or those named."""
        first_row = self.group_starts[index]
        for table in self._block_tables(index, columns):
            yield RowGroup(table, self.path, first_row)
            first_row += len(table)
        if first_row != self.group_starts[index + 1]:  # a damaged page may end early without an error
            found = first_row - self.group_starts[index]
            expected = self.metadata.row_group(index).num_rows
            problem = f" is damaged, row group {index} holds {found} rows; expected {expected} by its footer"
            raise errors.IntegrityError.in_file(self.path, problem)

    def _require_bounded(self, metadata: parquet.FileMetaData, index: int) -> None:
        """Refuse rows that would exceed the limit when unpacked, according to the footer."""
        # A large row group is harmless, because it is unpacked in blocks, unless it may consist of one row.
        if not self.is_remote:
            store.require_sound_columns(self.path, metadata, [index])
        group = metadata.row_group(index)
        columns = [group.column(number) for number in range(group.num_columns)]
        size_bytes = sum(
            max(column.total_uncompressed_size, column.num_values * _VALUE_BYTES.get(column.physical_type, 4))
            for column in columns
        )
        stored = sum(column.total_compressed_size for column in columns)
        if size_bytes <= _MAX_EXPANSION * stored:
            size_bytes //= max(group.num_rows, 1)
        cache.require_unpackable(size_bytes, f"{self.path!r}, rows from {self.group_starts[index]}:")

    def _block_tables(self, index: int, columns: Sequence[str] | None) -> Iterator[pa.Table]:
        rows = self.block_rows[index]
        waiting = None
        with self._named_damage():
            parquet, (metadata, _) = self._open()
            self._require_bounded(metadata, index)
            for batch in parquet.iter_batches(rows, [index], columns, use_threads=False):
                # The reader may return fewer rows than requested; blocks must be complete to be found again.
                table = schemas.supported_table(pa.Table.from_batches([batch]))
                waiting = table if waiting is None else pa.concat_tables([waiting, table])
                while len(waiting) >= rows:
                    yield waiting.slice(0, rows).combine_chunks()
                    waiting = waiting.slice(rows)
        if waiting is not None and len(waiting):
            yield waiting.combine_chunks()

    @cached_property
    def identity(self) -> tuple[object, ...]:
        """Identity of the file when it was first accessed; compared whenever it is opened.

        Hashing gigabytes would cost more, and only deliberate changes keep the identity.
        """
        if not self.is_remote:
            with contextlib.suppress(OSError):
                return self._found_now()
        with self._named_damage():
            return self._opened(None)[1]

    def _found_now(self) -> tuple[int, str, int, int, int]:
        """Return the identity of the local file now."""
        facts = os.stat(self.path)  # noqa: PTH116
        # With the name, because machines that share a cache may have other files with the same numbers.
        name = self.path.rpartition("/")[2]
        return facts.st_dev, name, facts.st_ino, facts.st_size, facts.st_mtime_ns

    @property
    def part_sizes(self) -> Sequence[int]:
        """Rows of the parts that training shuffles: the file is one part."""
        return (len(self),)

    @cached_property
    def split(self) -> str:
        """Split, from the file name; empty if it states none."""
        name = store.ShardName.parse(self.path.rpartition("/")[2])
        return "" if name is None else name.split

    @property
    def set_name(self) -> tuple[str, str]:
        """Folder and split, or file name without a split; shards of one set have one schema."""
        folder, _, name = self.path.rpartition("/")
        return folder, self.split or name

    @property
    def origin(self) -> tuple[str, str]:
        """Name in quotes and split of the data set: a repository of the Hub, or a folder."""
        # hf://datasets/USER/NAME@COMMIT, or datasets--USER--NAME in the cache of the Hub's client.
        on_hub = re.search(r"(?:^hf://datasets/|/datasets--)([^/]+?)(?:/|--)([^/@]+)(?:@[^/]*)?/", self.path)
        if on_hub is not None:
            return repr(f"{on_hub[1]}/{on_hub[2]}"), self.split
        folders = (self.path if self.is_remote else os.path.abspath(self.path)).split("/")[:-1]  # noqa: PTH100
        named = [part for part in folders if part not in ("", ".", store.DATA_FOLDER)] or folders
        return repr(named[-1]), self.split

    @property
    def is_remote(self) -> bool:
        """Whether the path is an address."""
        return "://" in self.path

    def _opened(
        self, metadata: parquet.FileMetaData | None
    ) -> tuple[parquet.ParquetFile, tuple[object, ...], int]:
        """Open the file, whose footer may be known; return it with its identity and size in bytes."""
        if not self.is_remote:
            # After opening, so that the identity is not that of an earlier file.
            return store.open_checked(self.path, metadata), (found := self._found_now()), found[-2]
        stream, identity, size_bytes = self._stream()
        return store.open_checked(stream, metadata), identity, size_bytes

    def _stream(self) -> tuple[IO[bytes], tuple[object, ...], int]:
        """Open the bytes of the file; return them with identity and size in bytes."""
        files, name = store.split_uri(self.path)
        stream = files.open(name)
        if not self.is_remote:
            return stream, (found := self._found_now()), found[-2]
        facts = getattr(stream, "details", None) or files.info(name) or {}
        versions = [(key, str(facts[key])) for key in store.VERSION_KEYS if key in facts]
        return stream, (self.path, *versions), facts["size"]

    @contextlib.contextmanager
    def stored(self) -> Iterator[IO[bytes]]:
        """Open the bytes of the file; IntegrityError if the file was replaced since the first access."""
        known = self.identity
        with self._named_damage():
            stream, identity, _ = self._stream()
            with stream:
                self._require_same(identity, known)
                yield stream

    def fingerprint(self) -> dict[str, str | int]:
        """Return JSON values that identify the rows; the footer holds the size of each column.

        From now on, a file that replaces this one is refused.
        """
        with self.stored() as stream:
            # A Parquet file ends with the length of its footer and the letters PAR1.
            size_bytes = stream.seek(-8, io.SEEK_END) + 8
            footer_bytes = int.from_bytes(stream.read(4), "little")
            stream.seek(-8 - footer_bytes, io.SEEK_END)
            footer = stream.read(footer_bytes)
        digest = hashlib.sha256(footer).hexdigest()
        name = self.path.rpartition("/")[2]
        return {"file": name, "rows": len(self), "bytes": size_bytes, "footer_sha256": digest}

    def _open(self) -> tuple[parquet.ParquetFile, Footer]:
        """Open the file, check that it was not replaced, and return it with its footer.

        The caller names the errors of a damaged file.
        """
        key = (self.digest, self.rows)
        footer = _FOOTERS.get(key)
        parquet, identity, size_bytes = self._opened(footer and footer[0])
        self._require_same(identity, self.identity)
        metadata = parquet.metadata
        found = {"rows": metadata.num_rows, "bytes": size_bytes}
        for unit, stated in (("rows", self.rows), ("bytes", self.size_bytes)):
            if stated not in (None, found[unit]):  # such as a shard of a set that is being overwritten
                problem = f": {found[unit]} {unit}; expected {stated} by the manifest"
                raise errors.IntegrityError.in_file(self.path, problem)
        return parquet, footer or _FOOTERS.put(
            key, (metadata, schemas.supported_schema(parquet.schema_arrow))
        )

    def _require_same(self, found: tuple[object, ...], known: tuple[object, ...]) -> None:
        # Without the device, which differs between machines that share a file system.
        if found[1:] != known[1:]:
            raise errors.IntegrityError(
                f"{self.path!r} was replaced or changed after the data set was loaded: none of its rows were "
                "read, because old and new ones would mix",
                next="load the data set again",
            )

    @contextlib.contextmanager
    def _named_damage(self) -> Iterator[None]:
        with store.named_damage(self.path), self.failures():
            yield
