"""Sources of rows, several of them under one numbering, and streams of rows."""

from __future__ import annotations

import sys
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, chain, islice
from typing import TYPE_CHECKING, Any, Generic, NoReturn, Protocol, Self, TypeVar

import numpy as np
import pyarrow as pa

from tactile_toolkit import run, wording
from tactile_toolkit.read import schemas
from tactile_toolkit.read.record import FieldAccess, RowGroup, numpy_values
from tactile_toolkit.read.shard import Shard
from tactile_toolkit.value_types import AnyArray, Int64

T = TypeVar("T")
_FEW_SHARDS = 8
_READERS = 16  # most of them wait for a disk or a network


def _in_threads(function: Callable[[RowSource], T], shards: Sequence[RowSource]) -> Iterator[T]:
    """Yield the result of a function for each shard, in order; shards are read in parallel."""
    return run.in_threads(function, shards, 1 if len(shards) < _FEW_SHARDS else _READERS)


@dataclass(frozen=True)
class ShardedTable:
    """The rows of several sources, such as shards, in order; nothing is read until needed."""

    shards: tuple[RowSource, ...]

    @property
    def files(self) -> tuple[Shard, ...]:
        """The sources that are entire files."""
        return tuple(shard for shard in self.shards if isinstance(shard, Shard))

    @cached_property
    def _starts(self) -> list[int]:
        return [0, *accumulate(map(len, self.shards))]

    @cached_property
    def _columns(self) -> dict[str, AnyArray]:
        return {}

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle as paths; the other process opens maps again."""
        return type(self), (self.shards,)

    def __len__(self) -> int:
        return self._starts[-1]

    @property
    def schema(self) -> pa.Schema:
        """Arrow schema of the first shard, or None without shards."""
        return self.shards[0].schema if self.shards else None

    @property
    def schemas(self) -> list[pa.Schema]:
        """Arrow schemas of the first shard of each set (a split of a data set), or of all merged shards."""
        # Each file that is not named as a shard is its own set.
        first = {shard.set_name: shard for shard in reversed(self.shards)}
        chosen = list(reversed(first.values()))
        # Merged shards lack different columns.
        if any(schemas.absent_columns(shard.schema) is not None for shard in chosen):
            chosen = list(self.shards)
        return [shard.schema for shard in chosen]

    @property
    def part_starts(self) -> Int64:
        """First row of each part that training shuffles, such as a shard, and the number of rows."""
        sizes = chain.from_iterable(shard.part_sizes for shard in self.shards)
        return np.array([0, *accumulate(sizes)], np.int64)

    @property
    def identity(self) -> str:
        """Text that identifies these rows, which changes when files are replaced."""
        return repr([shard.identity for shard in self.shards])

    @property
    def origins(self) -> list[tuple[str, str]]:
        """Name of the data set and split, if known, of each shard, from its path."""
        return [shard.origin for shard in self.shards]

    def described(self, things: str) -> list[str]:
        """Describe the data sets and splits of ``things``, such as ``20 rows``."""
        names = dict.fromkeys(name for name, _ in self.origins)
        splits = dict.fromkeys(f"split {split}" for _, split in self.origins if split)
        return [f"{things} of {' and '.join(names)}" if names else things, *splits]

    def locate(self, row: int) -> tuple[RowGroup, int]:
        """Return the row group (or block of one) that holds a row, and the row's index in it."""
        index = bisect_right(self._starts, row) - 1
        return self.shards[index].locate(row - self._starts[index])

    def row_groups(self, rows: Int64) -> list[tuple[RowSource, int]]:
        """Return the row groups of ascending rows; opens no other shard."""
        sources: list[tuple[RowSource, int]] = []
        if not self.shards:
            return sources
        owners = np.searchsorted(self._starts, rows, "right") - 1
        for owner in np.unique(owners).tolist():
            shard = self.shards[owner]
            inner = rows[owners == owner] - self._starts[owner]
            groups = np.unique(np.searchsorted(shard.group_starts, inner, "right") - 1)
            sources += [(shard, group) for group in groups.tolist()]
        return sources

    def blocks(self, columns: Sequence[str] | None = None) -> Iterator[RowGroup]:
        """Read all rows in blocks, as :meth:`RowSource.blocks`."""
        return (
            block for source, index in _row_groups(self.shards) for block in source.blocks(index, columns)
        )

    def column(self, name: str) -> AnyArray:
        """Read one plain column of all rows by dotted name, and no other; cached."""
        return self._kept(
            f"column {name}", map(numpy_values, _in_threads(lambda shard: shard.column(name), self.shards))
        )

    def per_shard(self, key: str, compute: Callable[[RowSource], Sequence[AnyArray]]) -> AnyArray:
        """Concatenate values computed from each shard; cached under ``key``."""
        return self._kept(key, chain.from_iterable(_in_threads(compute, self.shards)))

    def _kept(self, key: str, parts: Iterable[AnyArray]) -> AnyArray:
        if key not in self._columns:
            values = np.concatenate(list(parts) or [np.zeros(0)])
            # Read-only, because the cached array is returned.
            values.setflags(write=False)
            self._columns.setdefault(key, values)
        return self._columns[key]


class RowSource(Protocol):
    """RowGroup, numbered from 0, in row groups; picklable."""

    @property
    def path(self) -> str:
        """File of the rows; empty if there is none."""

    @property
    def schema(self) -> pa.Schema:
        """Arrow schema of the rows."""

    @property
    def class_names(self) -> tuple[str, ...] | None:
        """Class names, None if none are stated."""

    @property
    def identity(self) -> tuple[object, ...]:
        """Values that identify the rows, which change when the file is replaced."""

    @property
    def origin(self) -> tuple[str, str]:
        """Displayed name of the data set, and its split, which may be empty."""

    @property
    def set_name(self) -> tuple[str, str]:
        """Folder and split; sources with equal values have one schema, unless they were merged."""

    @property
    def group_starts(self) -> Sequence[int]:
        """First row of each row group, and the number of rows at the end."""

    @property
    def part_sizes(self) -> Sequence[int]:
        """Rows of the parts that training shuffles."""

    def __len__(self) -> int:
        """Return the number of rows."""

    def locate(self, row: int) -> tuple[RowGroup, int]:
        """Return rows that contain a row, with all columns, and its index in them."""

    def blocks(self, index: int, columns: Sequence[str] | None = None) -> Iterator[RowGroup]:
        """Read a row group in blocks, one by one, without caching; all columns or those named."""

    def column(self, name: str) -> pa.Array:
        """Read one column of all rows as an Arrow array, by dotted name; KeyError when it is not there."""

    def unpack(self, index: int) -> int:
        """Prepare a row group for random access; return its size in bytes, 0 on failure."""


S = TypeVar("S", bound=RowSource)


def _row_groups(sources: Iterable[S]) -> Iterator[tuple[S, int]]:
    """Yield the row groups of sources in order, each as its source and number."""
    return ((source, index) for source in sources for index in range(len(source.group_starts) - 1))


def loader_worker() -> Any:
    """Return the torch worker information of this process; None if it is not a worker of a loader."""
    torch_data = sys.modules.get("torch.utils.data")
    if torch_data is None:
        return None
    return torch_data.get_worker_info()


def explain_batches() -> None:
    """Make torch name the class that makes batches where records are given to its ``default_collate``."""
    collate = sys.modules.get("torch.utils.data._utils.collate")
    if collate is not None:
        collate.default_collate_fn_map.setdefault(FieldAccess, _refuse_records)


def _refuse_records(records: Sequence[FieldAccess], **_: object) -> NoReturn:
    raise TypeError(
        f"torch cannot make a batch of {type(records[0]).__name__} records; next: give the DataLoader "
        f"{records[0].TENSORS}(data), or a collate_fn that makes tensors of the fields"
    )


class RowStream(Generic[S]):
    """Base class of streams. Each pass reads from the beginning, a bounded block of rows at a time.

    For torch, a stream is an ``IterableDataset``: give it to ``DataLoader(stream, batch_size=None)``. Workers
    of a loader share the shards, or the row groups if there are fewer shards than workers.

    Parameters
    ----------
    shards : tuple of RowSource
        Shards, read in order.
    """

    def __init__(self, shards: tuple[S, ...]) -> None:
        self.shards = shards

    if not TYPE_CHECKING:

        @property
        def __class__(self) -> type[Self]:
            # Loaders call `isinstance`, which reads this attribute. The class is registered here, because
            # torch takes seconds to import and may be imported after the stream was created.
            if "torch.utils.data" in sys.modules:
                explain_batches()
                sys.modules["torch.utils.data"].IterableDataset.register(type(self))
            return type(self)

    def row_groups(self) -> Iterator[tuple[S, int]]:
        """Yield the row groups of all shards, or those of this worker of a loader."""
        worker = loader_worker()
        if worker is None:
            return _row_groups(self.shards)
        if worker.num_workers <= len(self.shards):
            return _row_groups(self.shards[worker.id :: worker.num_workers])
        return islice(_row_groups(self.shards), worker.id, None, worker.num_workers)

    def _described(self, items: str) -> str:
        words = ShardedTable(self.shards).described(wording.with_count(len(self.shards), "shards"))
        return f"{type(self).__name__}({items}, {', '.join(words)})"
