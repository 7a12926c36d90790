"""Random access to Parquet: row groups unpacked once into memory-mapped Arrow files.

Parquet must decode a whole row group to give one row. Each row group is therefore decoded on its first use
into an Arrow file in the cache folder and mapped into memory; from then on a row costs microseconds, in this
process and in every other one on the machine. Nothing is unpacked that nobody asked for.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dataset_store.columns import RaggedColumn, column_names, ragged_column
from dataset_store.errors import IntegrityError, StorageError
from dataset_store.storage import DataFolder

__all__ = ["CACHE_VARIABLE", "RowGroup", "Shard", "ShardedTable", "cache_folder"]

CACHE_VARIABLE = "TACTILE_TOOLKIT_CACHE"
"""Environment variable that names the folder of unpacked row groups."""

_CACHE_LIMIT_BYTES = 32 << 30


def cache_folder() -> Path:
    """Return the folder of unpacked row groups: ``$TACTILE_TOOLKIT_CACHE`` or the user's cache folder."""
    named = os.environ.get(CACHE_VARIABLE)
    if named:
        return Path(named).expanduser()
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base).expanduser() / "tactile-toolkit"


@dataclass(frozen=True, eq=False)
class RowGroup:
    """One unpacked row group: columns as numpy views of mapped memory.

    Parameters
    ----------
    table : pyarrow.Table
        The rows, one chunk per column.
    """

    table: Any
    _ragged: dict[str, RaggedColumn] = field(default_factory=dict, repr=False)
    _flat: dict[str, NDArray[Any]] = field(default_factory=dict, repr=False)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Columns by dotted name."""
        return column_names(self.table.schema)

    def ragged(self, name: str) -> RaggedColumn:
        """Return a column of arrays of shape (n_i, width), by dotted name."""
        column = self._ragged.get(name)
        if column is None:
            column = self._ragged.setdefault(name, ragged_column(self.arrow(name)))
        return column

    def flat(self, name: str) -> NDArray[Any]:
        """Return a column of plain values as a numpy array."""
        column = self._flat.get(name)
        if column is None:
            column = self._flat.setdefault(name, self.arrow(name).to_numpy(zero_copy_only=False))
        return column

    def arrow(self, name: str) -> Any:
        """Return a column as an Arrow array, by dotted name, whether stored flat or as a struct's field.

        Raises
        ------
        KeyError
            When there is no such column.
        """
        import pyarrow as pa

        if name in self.table.column_names:
            return _one_chunk(self.table.column(name))
        outer, _, inner = name.partition(".")
        if outer in self.table.column_names:
            struct = _one_chunk(self.table.column(outer))
            if pa.types.is_struct(struct.type) and struct.type.get_field_index(inner) >= 0:
                return struct.flatten()[struct.type.get_field_index(inner)]
        raise KeyError(name)


def _one_chunk(column: Any) -> Any:
    return column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()


@dataclass(frozen=True)
class Shard:
    """One Parquet file of a data set.

    Parameters
    ----------
    path : str
        Local path, or any fsspec address.
    rows : int or None
        Number of rows where it is known beforehand; saves opening the file to count.
    """

    path: str
    rows: int | None = None

    @cached_property
    def metadata(self) -> Any:
        """The Parquet footer: row groups, columns, schema; reads no row.

        Raises
        ------
        IntegrityError
            When the file is missing, cut short or no Parquet.
        """
        return self._parquet().metadata

    @cached_property
    def schema(self) -> Any:
        """The Arrow schema."""
        return self.metadata.schema.to_arrow_schema()

    @cached_property
    def group_starts(self) -> list[int]:
        """First row of each row group, and the number of rows at the end."""
        counts = [self.metadata.row_group(index).num_rows for index in range(self.metadata.num_row_groups)]
        return [0, *np.cumsum(counts).tolist()]

    def __getstate__(self) -> dict[str, Any]:
        """Pickle as path and row count; footers are read again where needed."""
        return {"path": self.path, "rows": self.rows}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return int(self.metadata.num_rows) if self.rows is None else self.rows

    def read(self, columns: Sequence[str] | None = None, groups: Sequence[int] | None = None) -> Any:
        """Decode row groups, all columns or those named (a struct's fields by dotted name)."""
        parquet = self._parquet()
        wanted = range(self.metadata.num_row_groups) if groups is None else groups
        with _named_damage(self.path):
            return parquet.read_row_groups(list(wanted), columns=columns, use_threads=False)

    def group(self, index: int) -> RowGroup:
        """Map one row group into memory, unpacking it into the cache on its first use.

        A cache that cannot be written (full, read-only) costs speed, never the data: the rows are then kept
        in the memory of this process.
        """
        place = cache_folder() / "row-groups" / f"{self._identity}-{index:05d}.arrow"
        table = _mapped(place)
        if table is None:
            table = self.read(groups=[index])
            with contextlib.suppress(StorageError):
                _write_arrow(place, table)
                table = _mapped(place) or table
        return RowGroup(table)

    @cached_property
    def _identity(self) -> str:
        # Content changes without a change of size or time only on purpose; hashing gigabytes would cost more.
        parts: list[object] = [self.path]
        if "://" not in self.path:
            real = Path(self.path).resolve()
            facts = real.stat()
            parts = [str(real), facts.st_size, facts.st_mtime_ns, facts.st_ino]
        return hashlib.sha256(repr(parts).encode()).hexdigest()[:32]

    def _parquet(self) -> Any:
        import pyarrow.parquet as pq

        folder, _, name = self.path.rpartition("/")
        with _named_damage(self.path):
            if "://" in self.path:
                return pq.ParquetFile(DataFolder(folder).open(name))
            return pq.ParquetFile(self.path, memory_map=True)


@contextlib.contextmanager
def _named_damage(path: str) -> Any:
    import pyarrow as pa

    try:
        yield
    except FileNotFoundError as error:
        message = f"{path!r} is missing; next: generate or download the data set again"
        raise IntegrityError(message) from error
    except (pa.ArrowInvalid, OSError) as error:
        message = (
            f"{path!r} is damaged, a whole Parquet file was expected ({error}); next: run `verify` on the "
            "data set, then generate or download it again"
        )
        raise IntegrityError(message) from error


def _mapped(path: Path) -> Any:
    """Map an unpacked row group; None when it is not there, or was damaged (it is then removed)."""
    import pyarrow as pa

    try:
        table = pa.ipc.open_file(pa.memory_map(str(path))).read_all()
    except FileNotFoundError:
        return None
    except (pa.ArrowInvalid, OSError):
        path.unlink(missing_ok=True)
        return None
    with contextlib.suppress(OSError):
        os.utime(path)  # the time of last use decides what leaves a full cache first
    return table


def _write_arrow(place: Path, table: Any) -> None:
    import pyarrow as pa

    stream = pa.BufferOutputStream()
    with pa.ipc.new_file(stream, table.schema) as writer:
        writer.write_table(table.combine_chunks())
    _make_room(place.parent, len(stream.getvalue()))
    DataFolder(str(place.parent)).write_bytes(place.name, stream.getvalue())


def _make_room(folder: Path, needed_bytes: int) -> None:
    """Drop the files used longest ago when the cache would pass its limit; open maps stay valid."""
    if not folder.is_dir():
        return
    files = sorted(((f.stat().st_mtime_ns, f.stat().st_size, f) for f in folder.glob("*.arrow")), key=lambda f: f[0])
    excess = sum(size for _, size, _ in files) + needed_bytes - _CACHE_LIMIT_BYTES
    for _, size, file in files:
        if excess <= 0:
            return
        file.unlink(missing_ok=True)
        excess -= size


@dataclass(frozen=True)
class ShardedTable:
    """The rows of several shards under one numbering; reads nothing until asked.

    Parameters
    ----------
    shards : tuple of Shard
        In row order.
    """

    shards: tuple[Shard, ...]

    @cached_property
    def _starts(self) -> list[int]:
        return [0, *np.cumsum([len(shard) for shard in self.shards]).tolist()]

    @cached_property
    def _groups(self) -> dict[tuple[int, int], RowGroup]:
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
        """Return the row group that holds a row, and the row's place in it."""
        shard_index = bisect_right(self._starts, row) - 1
        shard = self.shards[shard_index]
        inner = row - self._starts[shard_index]
        group_index = bisect_right(shard.group_starts, inner) - 1
        group = self._groups.get((shard_index, group_index))
        if group is None:
            group = self._groups.setdefault((shard_index, group_index), shard.group(group_index))
        return group, inner - shard.group_starts[group_index]

    def column(self, name: str) -> NDArray[Any]:
        """Read one plain column of all rows, and only that column; kept for the next call."""
        values = self._columns.get(name)
        if values is None:
            parts = [shard.read(columns=[name]).column(0).to_numpy() for shard in self.shards]
            values = np.concatenate(parts) if parts else np.zeros(0)
            values.setflags(write=False)
            values = self._columns.setdefault(name, values)
        return values
