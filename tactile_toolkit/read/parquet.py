"""Random access to Parquet: row groups unpacked once into memory-mapped Arrow files.

Parquet must decode a whole row group to give one row. Each row group is therefore decoded on its first use
into an Arrow file in the cache folder and mapped into memory; from then on a row costs microseconds, in this
process and in every other one on the machine. Nothing is unpacked that nobody asked for. Large row groups are
unpacked in blocks of some rows, so that memory stays bounded and no Arrow array outgrows its 32-bit offsets.
"""

from __future__ import annotations

import contextlib
import hashlib
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.cache import CACHE_VARIABLE, DiskCache, MemoryCache, cache_folder
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.read.columns import (
    RowGroup,
    column_types,
    plain_schema,
    plain_table,
    stored_class_names,
)
from tactile_toolkit.store.folder import DataFolder

__all__ = ["CACHE_VARIABLE", "RowGroup", "Shard", "ShardedTable", "cache_folder"]

_BLOCK_BYTES = 64 << 20


class MemoryBlocks(MemoryCache[tuple[str, int], RowGroup]):
    """Blocks by name of their row group and number, where no cache folder can be written."""

    def _begin(self) -> None:
        super()._begin()
        self._under_way: tuple[str, int, Iterator[RowGroup]] | None = None

    def block(self, name: str, number: int, decode: Callable[[], Iterator[RowGroup]]) -> RowGroup:
        """Return a block, decoding no more of its row group than it takes; ``decode`` starts at the first.

        Raises IndexError when the row group has fewer blocks.
        """
        with self._lock:  # held while decoding: two threads would decode the same blocks
            kept = self.get((name, number))
            if kept is not None:
                return kept
            under_way, self._under_way = self._under_way, None
            if under_way is not None and under_way[0] == name and under_way[1] <= number:
                _, reached, groups = under_way  # goes on where decoding stopped, as a full pass does
            else:
                reached, groups = 0, decode()
            for group in groups:
                self.put((name, reached), group)
                reached += 1
                if reached > number:
                    self._under_way = (name, reached, groups)
                    return group
        message = f"block {number} of {name!r}; the row group has {reached}"
        raise IndexError(message)


MEMORY = MemoryBlocks(512 << 20, lambda group: int(group.table.nbytes))
"""The blocks of this process: eight blocks of the usual size, 64 MB each."""

_UNPACKED = DiskCache(
    "blocks",
    32 << 30,
    warning="row groups cannot be kept unpacked, {problem}; what was used last stays in the memory of this "
    "process, all else is decoded again",
)


@dataclass(frozen=True)
class Shard:
    """One Parquet file of a data set, local or at any fsspec address.

    ``rows`` is its number of rows where that is known beforehand, which saves opening the file to count.
    ``failures``, pickled with it, makes the context in which the bytes of a remote file are read: there,
    whoever knows the store names what goes wrong with it.
    """

    path: str
    rows: int | None = None
    failures: Callable[[], contextlib.AbstractContextManager[None]] = field(
        default=contextlib.nullcontext, repr=False, compare=False
    )

    @cached_property
    def metadata(self) -> Any:
        """The Parquet footer: row groups, columns, schema; IntegrityError where the file has none."""
        return self._parquet().metadata

    @cached_property
    def schema(self) -> Any:
        """The Arrow schema, extension types as what they are stored as."""
        return plain_schema(self.metadata.schema.to_arrow_schema())

    @cached_property
    def types(self) -> dict[str, Any]:
        """Arrow type of each column, and of each struct, by dotted name."""
        return column_types(self.schema)

    @cached_property
    def class_names(self) -> tuple[str, ...] | None:
        """Names of the classes, where `datasets` stored them; IntegrityError where they cannot be read."""
        return stored_class_names(self.schema, self.path)

    @cached_property
    def group_starts(self) -> list[int]:
        """First row of each row group, and the number of rows at the end."""
        counts = [self.metadata.row_group(index).num_rows for index in range(self.metadata.num_row_groups)]
        return [0, *accumulate(counts)]

    def __getstate__(self) -> dict[str, Any]:
        """Pickle without footers; they are read again where needed."""
        return {"path": self.path, "rows": self.rows, "failures": self.failures}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return int(self.metadata.num_rows) if self.rows is None else self.rows

    def read(self, columns: Sequence[str] | None = None, groups: Sequence[int] | None = None) -> Any:
        """Decode row groups, all columns or those named (a struct's fields by dotted name)."""
        parquet = self._parquet()
        wanted = range(self.metadata.num_row_groups) if groups is None else groups
        with self._named_damage():
            table = parquet.read_row_groups(list(wanted), columns=columns, use_threads=False)
        return plain_table(table)

    def column(self, name: str) -> Any:
        """Read one column of all rows as an Arrow array, by dotted name; KeyError when it is not there."""
        return RowGroup(self.read(columns=[name]), self.path).arrow(name)

    @cached_property
    def block_rows(self) -> list[int]:
        """How many rows of each row group are unpacked together; follows from the file alone."""
        groups = [self.metadata.row_group(index) for index in range(self.metadata.num_row_groups)]
        fitting = [_BLOCK_BYTES * group.num_rows // max(group.total_byte_size, 1) for group in groups]
        return [max(1, min(group.num_rows, rows)) for group, rows in zip(groups, fitting, strict=True)]

    def block(self, index: int, block: int) -> RowGroup:
        """Map one block of a row group into memory, unpacking the row group into the cache on its first use.

        A cache that cannot be written (full, read-only) costs speed, never the data: the blocks used last are
        then kept in the memory of this process, see :class:`MemoryBlocks`.
        """
        name = f"{self._identity}-{index:05d}"
        kept = MEMORY.get((name, block))
        if kept is not None:
            return kept
        table = _mapped_table(name, block)
        if table is None and self._unpack(name, index):
            table = _mapped_table(name, block)
        if table is None:
            return MEMORY.block(name, block, lambda: self.blocks(index))
        first_row = self.group_starts[index] + block * self.block_rows[index]
        return RowGroup(table, self.path, first_row, mapped=True)

    def _unpack(self, name: str, index: int) -> bool:
        import pyarrow as pa

        def fill(stream: Any) -> None:
            with pa.ipc.new_file(stream, self.schema) as writer:
                for group in self.blocks(index):  # each becomes one record batch
                    writer.write_table(group.table)

        size_bytes = int(self.metadata.row_group(index).total_byte_size)
        return _UNPACKED.write(f"{name}.arrow", size_bytes, fill)

    def blocks(self, index: int, columns: Sequence[str] | None = None) -> Iterator[RowGroup]:
        """Decode the blocks of a row group one after another, keeping none; all columns or those named."""
        first_row = self.group_starts[index]
        for table in self._block_tables(index, columns):
            yield RowGroup(table, self.path, first_row)
            first_row += len(table)
        if first_row != self.group_starts[index + 1]:  # a damaged page may end early without a word
            found, expected = first_row - self.group_starts[index], self.metadata.row_group(index).num_rows
            message = (
                f"{self.path!r} is damaged, row group {index} holds {found} rows; expected {expected} by its "
                "footer; next: run `verify` on the data set, then generate or download it again"
            )
            raise IntegrityError(message)

    def _block_tables(self, index: int, columns: Sequence[str] | None) -> Iterator[Any]:
        import pyarrow as pa

        rows = self.block_rows[index]
        waiting = None
        with self._named_damage():
            for batch in self._parquet().iter_batches(rows, [index], columns, use_threads=False):
                # The reader may give less than asked for; blocks have to be whole to be found again.
                table = plain_table(pa.Table.from_batches([batch]))
                waiting = table if waiting is None else pa.concat_tables([waiting, table])
                while len(waiting) >= rows:
                    yield waiting.slice(0, rows).combine_chunks()
                    waiting = waiting.slice(rows)
        if waiting is not None and len(waiting):
            yield waiting.combine_chunks()

    @cached_property
    def _identity(self) -> str:
        # Content changes without a change of size or time only on purpose; hashing gigabytes would cost more.
        parts: list[object] = [self.path]
        if "://" not in self.path:
            real = Path(self.path).resolve()
            with self._named_damage():
                facts = real.stat()
            parts = [str(real), facts.st_size, facts.st_mtime_ns, facts.st_ino]
        return hashlib.sha256(repr(parts).encode()).hexdigest()[:32]

    def _parquet(self) -> Any:
        import pyarrow.parquet as pq

        folder, _, name = self.path.rpartition("/")
        with self._named_damage():
            # Buffering ahead starts a thread of Arrow's, which aborts about 1 % of interpreters at their end.
            if "://" in self.path:
                return pq.ParquetFile(DataFolder(folder).open(name), pre_buffer=False)
            return pq.ParquetFile(self.path, memory_map=True, pre_buffer=False)

    @contextlib.contextmanager
    def _named_damage(self) -> Iterator[None]:
        import pyarrow as pa

        try:
            with self.failures():
                yield
        except FileNotFoundError as error:
            message = f"{self.path!r} is missing; next: generate or download the data set again"
            raise IntegrityError(message) from error
        except (pa.ArrowInvalid, OSError) as error:
            message = (
                f"{self.path!r} is damaged, a whole Parquet file was expected ({error}); next: run `verify` "
                "on the data set, then generate or download it again"
            )
            raise IntegrityError(message) from error


def _mapped_table(name: str, number: int) -> Any:
    """Map one block of an unpacked row group; None when it is not there, or was damaged (it goes)."""
    import pyarrow as pa

    path = _UNPACKED.path(f"{name}.arrow")
    try:
        # From the map's own buffer, still without a copy: from the map, Arrow would read in its own threads.
        batch = pa.ipc.open_file(pa.memory_map(str(path)).read_buffer()).get_batch(number)
    except FileNotFoundError:
        return None
    except (pa.ArrowInvalid, IndexError, OSError):
        _UNPACKED.drop(path)
        return None
    _UNPACKED.mark_used(path)
    return pa.Table.from_batches([batch])


@dataclass(frozen=True)
class ShardedTable:
    """The rows of several shards, in their order, under one numbering; reads nothing until asked."""

    shards: tuple[Shard, ...]

    @cached_property
    def _starts(self) -> list[int]:
        return [0, *accumulate(map(len, self.shards))]

    @cached_property
    def _groups(self) -> dict[tuple[int, int, int], RowGroup]:
        return {}

    @cached_property
    def _columns(self) -> dict[str, NDArray[Any]]:
        return {}

    def __getstate__(self) -> dict[str, Any]:
        """Pickle as paths; maps are opened again in the other process."""
        return {"shards": self.shards}

    def __setstate__(self, state: dict[str, Any]) -> None:
        object.__setattr__(self, "shards", state["shards"])

    def __len__(self) -> int:
        return self._starts[-1]

    @property
    def schema(self) -> Any:
        """Arrow schema of the first shard, or None without shards."""
        return self.shards[0].schema if self.shards else None

    def locate(self, row: int) -> tuple[RowGroup, int]:
        """Return the row group (or block of one) that holds a row, and the row's index in it."""
        shard_index = bisect_right(self._starts, row) - 1
        shard = self.shards[shard_index]
        inner = row - self._starts[shard_index]
        group_index = bisect_right(shard.group_starts, inner) - 1
        block, index = divmod(inner - shard.group_starts[group_index], shard.block_rows[group_index])
        key = (shard_index, group_index, block)
        group = self._groups.get(key)
        if group is None:
            group = shard.block(group_index, block)
            if group.mapped:  # what lies in memory is kept by MEMORY alone, which knows a limit
                group = self._groups.setdefault(key, group)
        return group, index

    def derive(
        self, key: str, columns: Sequence[str], compute: Callable[[RowGroup], NDArray[Any]]
    ) -> NDArray[Any]:
        """Compute something small of a few columns, reading no other; kept under ``key`` for the next call.

        What ``compute`` gives of some rows is joined along the first axis.
        """
        return self.per_shard(
            key,
            lambda shard: [
                compute(group)
                for index in range(shard.metadata.num_row_groups)
                for group in shard.blocks(index, columns)
            ],
        )

    def column(self, name: str) -> NDArray[Any]:
        """Read one plain column of all rows by dotted name, and only that column; kept for the next call."""
        return self.per_shard(name, lambda shard: [shard.column(name).to_numpy(zero_copy_only=False)])

    def per_shard(self, key: str, compute: Callable[[Shard], Sequence[NDArray[Any]]]) -> NDArray[Any]:
        """Join along the first axis what is computed of each shard; kept under ``key`` for the next call."""
        values = self._columns.get(key)
        if values is None:
            parts = [part for shard in self.shards for part in compute(shard)]
            values = np.concatenate(parts) if parts else np.zeros(0)
            values.setflags(write=False)
            values = self._columns.setdefault(key, values)
        return values
