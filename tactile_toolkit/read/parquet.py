"""Random access to Parquet: row groups unpacked once into memory-mapped Arrow files.

Parquet must decode a whole row group to give one row. Each row group is therefore decoded on its first use
into an Arrow file in the cache folder and mapped into memory; from then on a row costs microseconds, in this
process and in every other one on the machine. Nothing is unpacked that nobody asked for. Large row groups are
unpacked in blocks of some rows, so that memory stays bounded and no Arrow array outgrows its 32-bit offsets.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import stat
from array import array
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import accumulate, chain, groupby
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.bounds import cache_limit_bytes, require_unpackable
from tactile_toolkit.cache import LOCKS, DiskCache, MemoryCache, cache_folder
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.read.blocks import MappedBlock, identity_of, map_block, write_blocks
from tactile_toolkit.read.columns import RowGroup, column_types, plain_schema, plain_table
from tactile_toolkit.read.features import stored_class_names
from tactile_toolkit.run.system import locked
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.files import of_the_process, readable
from tactile_toolkit.store.folder import VERSION_KEYS, file_at
from tactile_toolkit.store.parquet import open_checked
from tactile_toolkit.store.shards import DATA_FOLDER, ShardName
from tactile_toolkit.store.small_columns import MADE_OF

__all__ = ["Shard", "ShardedTable"]

_BLOCK_BYTES = 64 << 20
# Unpacked sizes of Parquet's physical types; all others take four bytes at least, a number or an offset.
_VALUE_BYTES = {"BOOLEAN": 1, "INT64": 8, "DOUBLE": 8, "INT96": 12}
# Rows take at most so many times the bytes that are stored of them, or might be one row; padding of clips
# takes about 20 times.
_MOST_EXPANSION = 500


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
    durable=False,  # its blocks have checksums: what a power cut leaves is seen, and unpacked again
    warning="row groups cannot be kept unpacked, {problem}; what was used last stays in the memory of this "
    "process, all else is decoded again",
)


# The blocks that a table has mapped are let go above so many bytes, or 4,096 of them: a process may have
# 65,530 maps, each takes some 7 kB, and what it holds open takes room on the disk after its file has left the
# cache. To map a block again is quick, however many there are.
_MAPPED_BYTES = 4 << 30
_LEAST_MAPPED_BYTES = 1 << 20

_FEW_SHARDS = 8
_REMOTE_READERS = 16

T = TypeVar("T")

_FOOTERS_KEPT = 128  # of a large shard, one takes some hundred kB


@dataclass(frozen=True, eq=False)
class _Footer:
    """The footer of a Parquet file, and what follows from it."""

    metadata: Any
    stored_schema: Any
    path: str

    @cached_property
    def schema(self) -> Any:
        # That of the metadata would hold them, and they it: megabytes that wait for the garbage collector.
        return plain_schema(self.stored_schema)

    @cached_property
    def types(self) -> dict[str, Any]:
        return column_types(self.schema)

    @cached_property
    def class_names(self) -> tuple[str, ...] | None:
        return stored_class_names(self.schema, self.path)


_FOOTERS: MemoryCache[Any, _Footer] = MemoryCache(_FOOTERS_KEPT)


@dataclass(frozen=True)
class Shard:
    """One Parquet file of a data set, local or at any fsspec address.

    ``rows`` is its number of rows where that is known beforehand, which saves opening the file to count.
    ``small`` is the file in which its small columns lie beside those of its neighbours, and what that file
    must say that it was made of. ``failures``, pickled with it, makes the context in which the bytes of a
    remote file are read: there, whoever knows the store names what goes wrong with it.
    """

    path: str
    rows: int | None = None
    failures: Callable[[], contextlib.AbstractContextManager[None]] = field(
        default=contextlib.nullcontext, repr=False, compare=False
    )
    small: tuple[Shard, str] | None = field(default=None, repr=False, compare=False)

    @property
    def metadata(self) -> Any:
        """The Parquet footer: row groups, columns, schema; read again when it was not asked for in a while.

        Raises IntegrityError where the file has none, or another number of rows than was said beforehand.
        """
        return self._footer.metadata

    @property
    def _footer(self) -> _Footer:
        # The rows too: another manifest may expect another number of the same file.
        key = (self.path, self.rows, self.identity)
        return _FOOTERS.get(key) or self._keep_footer(key, self._parquet())

    def _keep_footer(self, key: Any, parquet: Any) -> _Footer:
        metadata = parquet.metadata
        if self.rows not in (None, metadata.num_rows):
            message = (
                f"{self.path!r}: {metadata.num_rows} rows; expected {self.rows} by the manifest; next: run "
                "`verify` on the data set, then generate, convert or download it again"
            )
            raise IntegrityError(message)
        footer = _Footer(metadata, parquet.schema_arrow, self.path)
        _FOOTERS.put(key, footer)
        return footer

    @property
    def schema(self) -> Any:
        """The Arrow schema, extension types as what they are stored as."""
        return self._footer.schema

    @property
    def types(self) -> dict[str, Any]:
        """Arrow type of each column, and of each struct, by dotted name."""
        return self._footer.types

    @property
    def class_names(self) -> tuple[str, ...] | None:
        """Names of the classes, where `datasets` stored them; IntegrityError where they cannot be read."""
        return self._footer.class_names

    @cached_property
    def group_starts(self) -> array[int]:
        """First row of each row group, and the number of rows at the end."""
        metadata = self.metadata
        counts = (metadata.row_group(index).num_rows for index in range(metadata.num_row_groups))
        return array("q", [0, *accumulate(counts)])

    def __len__(self) -> int:
        return int(self.metadata.num_rows) if self.rows is None else self.rows

    def read(self, columns: Sequence[str] | None = None, groups: Sequence[int] | None = None) -> Any:
        """Decode row groups, all columns or those named (a struct's fields by dotted name)."""
        parquet = self._parquet()
        # What it says of itself is looked at once, although it may have left the footers that are kept.
        metadata = self._keep_footer((self.path, self.rows, self.identity), parquet).metadata
        wanted = range(metadata.num_row_groups) if groups is None else groups
        for index in wanted if columns is None else ():  # a plain column is no larger than its rows
            self._require_bounded(index)
        with self._named_damage():
            # Arrow's threads would be as many again: shards are read side by side already.
            table = parquet.read_row_groups(list(wanted), columns=columns, use_threads=False)
        return plain_table(table)

    def column(self, name: str) -> Any:
        """Read one column of all rows as an Arrow array, by dotted name; KeyError when it is not there."""
        return RowGroup(self.read(columns=[name]), self.path).arrow(name)

    @cached_property
    def block_rows(self) -> array[int]:
        """How many rows of each row group are unpacked together; follows from the file alone."""
        metadata = self.metadata
        groups = [metadata.row_group(index) for index in range(metadata.num_row_groups)]
        fitting = [_BLOCK_BYTES * group.num_rows // max(group.total_byte_size, 1) for group in groups]
        rows = (max(1, min(group.num_rows, rows)) for group, rows in zip(groups, fitting, strict=True))
        return array("q", rows)

    def block(self, index: int, block: int) -> RowGroup:
        """Map one block of a row group into memory, unpacking the row group into the cache on its first use.

        A cache that cannot be written (full, read-only) costs speed, never the data: the blocks used last are
        then kept in the memory of this process, see :class:`MemoryBlocks`.
        """
        name = self._unpacked_name(index)
        # Empty, and quick to ask, wherever the cache folder can be written.
        kept = MEMORY.get((name, block))
        if kept is not None:
            return kept
        path = _UNPACKED.path(name)
        mapped = _mapped(path, block)
        if mapped is None and self.unpack(index):
            mapped = _mapped(path, block)
        if mapped is None:
            return MEMORY.block(name, block, lambda: self.blocks(index))
        first_row = self.group_starts[index] + block * self.block_rows[index]
        return RowGroup(mapped.table, self.path, first_row, mapped.size_bytes)

    def unpack(self, index: int) -> bool:
        """See to it that a row group lies unpacked in the cache; tell whether it does.

        One process of the machine unpacks it, others wait for that one.
        """

        def fill(stream: IO[bytes]) -> None:
            write_blocks(stream, path.name, self.schema, (group.table for group in self.blocks(index)))

        path = _UNPACKED.path(self._unpacked_name(index))
        _UNPACKED.mark_used(path)
        if path.exists():
            return True
        # Asked anew: a notebook may set the variable at any time.
        _UNPACKED.limit_bytes = cache_limit_bytes()
        with _lock_of(path.name):
            # Whoever held the lock may have unpacked it meanwhile.
            return path.exists() or _UNPACKED.write(path.name, self.unpacked_bytes(index), fill)

    def unpacked_bytes(self, index: int) -> int:
        """About how much a row group takes when it is unpacked, by the footer."""
        return int(self.metadata.row_group(index).total_byte_size)

    def _unpacked_name(self, index: int) -> str:
        return f"{self._digest}-{index:05d}.arrow"

    @cached_property
    def _digest(self) -> str:
        return hashlib.sha256(repr(self.identity).encode()).hexdigest()[:32]

    def blocks(self, index: int, columns: Sequence[str] | None = None) -> Iterator[RowGroup]:
        """Decode the blocks of a row group one after another, keeping none; all columns or those named."""
        self._require_bounded(index)
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

    def _require_bounded(self, index: int) -> None:
        """Refuse rows that unpack to more than the limit, by what the footer says of them."""
        # A large row group is no harm, for blocks of it are unpacked; one of which next to nothing is stored
        # may be a single row.
        group = self.metadata.row_group(index)
        columns = [group.column(number) for number in range(group.num_columns)]
        unpacked = sum(
            max(column.total_uncompressed_size, column.num_values * _VALUE_BYTES.get(column.physical_type, 4))
            for column in columns
        )
        stored = sum(column.total_compressed_size for column in columns)
        if unpacked <= _MOST_EXPANSION * stored:
            unpacked //= max(group.num_rows, 1)
        require_unpackable(unpacked, f"{self.path!r}, rows from {self.group_starts[index]}:")

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
    def identity(self) -> tuple[object, ...]:
        """What told the file from any other when it was met first; it is compared whenever it is opened.

        Content changes without it on purpose only; hashing gigabytes would cost more.
        """
        with self._named_damage():
            return self._opened()[1] if self._is_remote else self._found_now()

    def _found_now(self) -> tuple[object, ...]:
        path = self.path
        # One call for most files: only of a link is asked where it leads.
        facts = os.lstat(path)
        if stat.S_ISLNK(facts.st_mode) or path[0] != "/":
            real = os.path.realpath(path)
            return real, *identity_of(Path(real).stat())
        # What is known of one file saves asking for each folder above each of 50,000.
        folder, _, name = path.rpartition("/")
        return f"{_real_folder(folder)}/{name}", *identity_of(facts)

    def _opened(self, metadata: Any = None) -> tuple[Any, tuple[object, ...]]:
        """Open the file, whose footer may be known, and return with it what tells it from any other."""
        if not self._is_remote:
            # After opening: what takes its place from now on is not what was opened.
            return open_checked(self.path, metadata), self._found_now()
        store, name = file_at(self.path)
        stream = store.open(name)
        facts = getattr(stream, "details", None) or store.facts(name)
        return open_checked(stream, metadata), (
            self.path,
            *((key, str(facts[key])) for key in VERSION_KEYS if key in facts),
        )

    @property
    def _is_remote(self) -> bool:
        return "://" in self.path

    def _parquet(self) -> Any:
        expected = self.identity
        kept = _FOOTERS.get((self.path, self.rows, expected))
        with self._named_damage():
            parquet, found = self._opened(None if kept is None else kept.metadata)
        if found != expected:
            message = (
                f"{self.path!r} was replaced or changed after the data set was loaded: none of its rows were "
                "read, for old and new ones would mix; next: load the data set again"
            )
            raise IntegrityError(message)
        return parquet

    @contextlib.contextmanager
    def _named_damage(self) -> Iterator[None]:
        import pyarrow as pa

        try:
            with readable(self.path), self.failures():
                yield
        except GeneratorExit:  # a pass left in its middle, maybe at exit, when Arrow's names are gone
            raise
        except FileNotFoundError as error:
            message = f"{self.path!r} is missing; next: generate or download the data set again"
            raise IntegrityError(message) from error
        except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
            message = (
                f"{self.path!r} is damaged, a whole Parquet file was expected ({error}); next: run `verify` "
                "on the data set, then generate or download it again"
            )
            raise IntegrityError(message) from error


@contextlib.contextmanager
def _lock_of(name: str) -> Iterator[None]:
    """Hold the lock of a file of the cache, one of a few for all of them; without locks nobody waits."""
    folder = cache_folder() / LOCKS
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            # 256 files for all row groups: one each would stay in the cache for good.
            stack.enter_context(locked(folder / name[:2]))
        yield


def _in_threads(function: Callable[[Shard], T], shards: Sequence[Shard]) -> Iterator[T]:
    """Yield what a function gives for each shard, in order; many are read at once, those afar above all."""
    if len(shards) < _FEW_SHARDS:
        return map(function, shards)
    workers = _REMOTE_READERS if "://" in shards[0].path else os.cpu_count() or 1
    return in_threads(function, shards, workers)


def _small_column(file: Shard, made_of: str, shards: Sequence[Shard], name: str) -> Any:
    """Read a column of some shards from their file of small columns; None where it is to be asked of them."""
    # What is wrong with it costs speed only; `verify` names it.
    with contextlib.suppress(IntegrityError):
        is_theirs = (file.schema.metadata or {}).get(MADE_OF) == made_of.encode()
        if is_theirs and name in file.schema.names and sum(map(len, shards)) == len(file):
            return file.column(name)
    return None


@lru_cache(maxsize=256)
def _real_folder(folder: str) -> str:
    return os.path.realpath(f"{folder}/").rstrip("/")


def _mapped(path: Path, number: int) -> MappedBlock | None:
    """Map one block of an unpacked row group; None when it is not there, or damaged (then it is removed)."""
    try:
        mapped = map_block(path, number)
    except FileNotFoundError:
        return None
    except (ValueError, OSError) as error:
        if of_the_process(error) is None:
            _UNPACKED.drop(path)
        return None
    _UNPACKED.mark_used(path)
    return mapped


def _origin(path: str) -> tuple[str, str]:
    """Return name in quotes and split of the data set of a shard: a repository of the Hub, or a folder."""
    shard = ShardName.parse(path.rpartition("/")[2])
    split = "" if shard is None else shard.split
    # hf://datasets/USER/NAME@COMMIT, or datasets--USER--NAME in the cache of the Hub's client.
    on_hub = re.search(r"(?:^hf://datasets/|/datasets--)([^/]+?)(?:/|--)([^/@]+)(?:@[^/]*)?/", path)
    if on_hub is not None:
        return repr(f"{on_hub[1]}/{on_hub[2]}"), split
    folders = [part for part in path.split("/")[:-1] if part not in ("", ".")]
    if "://" not in path:
        folders = list(Path(path).absolute().parts[:-1])
    if len(folders) > 1 and folders[-1] == DATA_FOLDER:
        folders.pop()
    return repr(folders[-1]), split


@dataclass(frozen=True)
class ShardedTable:
    """The rows of several shards, in their order, under one numbering; reads nothing until asked."""

    shards: tuple[Shard, ...]

    def __post_init__(self) -> None:
        # Which file is there now is noted where that costs next to nothing.
        for shard in self.shards:
            if "identity" not in shard.__dict__ and "://" not in shard.path:
                try:
                    shard.__dict__["identity"] = shard._found_now()
                except OSError:  # what is missing is named when it is asked for
                    continue

    @cached_property
    def _starts(self) -> list[int]:
        return [0, *accumulate(map(len, self.shards))]

    @cached_property
    def _groups(self) -> MemoryCache[tuple[int, int, int], RowGroup]:
        return MemoryCache(_MAPPED_BYTES, lambda group: max(_LEAST_MAPPED_BYTES, group.mapped_bytes))

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

    @property
    def identity(self) -> str:
        """What tells these rows from all others, also from later ones of the same files."""
        return repr([shard.identity for shard in self.shards])

    @property
    def origins(self) -> list[tuple[str, str]]:
        """Name of the data set, and split where that is known, of each shard, by where it lies."""
        return [_origin(shard.path) for shard in self.shards]

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
            group = made = shard.block(group_index, block)
            if made.mapped_bytes:  # what lies in memory is kept by MEMORY
                group = self._groups.get_or_make(key, lambda: made)
        return group, index

    def row_groups(self, rows: NDArray[np.int64]) -> list[tuple[Shard, int]]:
        """Return the row groups that hold some rows, which rise; opens no other shard."""
        if not self.shards:
            return []
        owners = np.searchsorted(self._starts, rows, "right") - 1
        return [
            (self.shards[owner], group)
            for owner in np.unique(owners).tolist()
            for group in np.unique(
                np.searchsorted(
                    self.shards[owner].group_starts, rows[owners == owner] - self._starts[owner], "right"
                )
                - 1
            ).tolist()
        ]

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
        return self.per_array(name, name, lambda array: array.to_numpy(zero_copy_only=False))

    def per_array(self, key: str, name: str, compute: Callable[[Any], NDArray[Any]]) -> NDArray[Any]:
        """Join what is computed of the Arrow arrays of a column; kept under ``key`` for the next call."""
        return self._kept(key, lambda: map(compute, self._arrays(name)))

    def per_shard(self, key: str, compute: Callable[[Shard], Sequence[NDArray[Any]]]) -> NDArray[Any]:
        """Join along the first axis what is computed of each shard; kept under ``key`` for the next call."""
        return self._kept(key, lambda: chain.from_iterable(_in_threads(compute, self.shards)))

    def _kept(self, key: str, parts: Callable[[], Iterable[NDArray[Any]]]) -> NDArray[Any]:
        values = self._columns.get(key)
        if values is None:
            arrays = list(parts())
            values = np.concatenate(arrays) if arrays else np.zeros(0)
            # It is kept as it is handed out.
            values.setflags(write=False)
            values = self._columns.setdefault(key, values)
        return values

    def _arrays(self, name: str) -> Iterator[Any]:
        """Yield the Arrow arrays of one column in order, from few files where the data set has such."""
        for small, neighbours in groupby(self.shards, key=lambda shard: shard.small):
            shards = list(neighbours)
            column = None if small is None else _small_column(small[0], small[1], shards, name)
            if column is None:
                yield from _in_threads(lambda shard: shard.column(name), shards)
            else:
                yield column
