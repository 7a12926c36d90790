"""What all conversions share: the source, the rows, the tasks, and the finished folder.

A conversion is planned from footers and small columns alone; each task reads its own rows, block by block,
and makes one shard. See :mod:`tactile_toolkit.store.build` for resuming and byte-identical results.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import accumulate, chain
from os import PathLike, fspath
from typing import Any, NamedTuple, Protocol

import pyarrow as pa

from realtouch.columns.per_touch import require_touches
from realtouch.names import open_shards
from tactile_toolkit.catalog.kinds import place_of
from tactile_toolkit.catalog.locate import splits_of
from tactile_toolkit.errors import InputError, IntegrityError, ItemError
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.read.source import file_fingerprint, manifest_beside
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import ParquetStyle
from tactile_toolkit.store.plan import BuildPlan, ShardContent
from tactile_toolkit.store.shards import DAMAGED, ShardName, ShardRecord, Skipped, rows_per_shard
from tactile_toolkit.touch.schema import (
    MEDIA_COLUMN,
    MEDIA_TYPE,
    Kind,
    class_names,
    flat_schema,
    kind_of,
    require_types,
    with_features,
)

KIND = "realtouch"

# What a worker may hold, unpacked.
_SHARD_BYTES = 256 << 20
# A touch read at random unpacks its whole row group.
_GROUP_BYTES = 32 << 20
_MOST_ROWS_PER_SHARD = 64
_READERS = 4  # threads that read footers


@dataclass(frozen=True)
class Source:
    """A data set to convert: its name as the user gave it, the shards of each split, and what it holds."""

    name: str
    shards: Mapping[str, tuple[Shard, ...]]
    kind: Kind

    @classmethod
    def open(cls, name: str | PathLike[str], revision: str | None = None, split: str | None = None) -> Source:
        """Find the splits of a data set (or the one given), fetching them first where they are on the Hub.

        Reads footers. Raises as :func:`realtouch.load`.
        """
        name = fspath(name)
        splits = (split,) if split is not None else splits_of(place_of(name), revision=revision)
        shards = {each: open_shards(name, each, revision=revision) for each in splits}
        for found in shards.values():
            deque(in_threads(require_types, found, _READERS), maxlen=0)
        return cls(name, shards, kind_of(shards[splits[0]][0].schema, name))

    @property
    def schema(self) -> pa.Schema:
        """Arrow schema of the first shard."""
        return next(iter(self.shards.values()))[0].schema

    def manifest(self) -> Manifest | None:
        """Return the manifest next to the shards, where there is one."""
        return manifest_beside(next(iter(self.shards.values()))[0])

    def row_bytes(self) -> int:
        """Return the size of a row unpacked, on average over the data set; at least 1."""
        return self._average("")

    def media_bytes(self) -> int:
        """Return the size of an image or clip, on average over the data set; at least 1."""
        return self._average(f"{MEDIA_COLUMN[self.kind]}.")

    def _average(self, column: str) -> int:
        shards = chain.from_iterable(self.shards.values())
        measured = in_threads(partial(_count_and_bytes, column=column), shards, _READERS)
        count, size = map(sum, zip(*measured, strict=True))
        return max(size // max(count, 1), 1)

    def fingerprint(self) -> dict[str, list[dict[str, Any]]]:
        """Return JSON values that identify the rows: names, sizes and footers of the files.

        The footer holds offset and size of every column chunk: other content gives another footer, and
        reading 28 GB to plan a conversion would cost minutes.
        """
        return {
            split: list(in_threads(file_fingerprint, found, _READERS)) for split, found in self.shards.items()
        }


def _count_and_bytes(shard: Shard, column: str) -> tuple[int, int]:
    """Return the rows of a file, or the values of a column of bytes in it, and their size unpacked."""
    metadata = shard.metadata
    groups = [metadata.row_group(index) for index in range(metadata.num_row_groups)]
    chunks = [group.column(index) for group in groups for index in range(group.num_columns)]
    chosen = [chunk for chunk in chunks if chunk.path_in_schema.startswith(column)]
    values = sum(chunk.num_values for chunk in chosen if chunk.path_in_schema.endswith(".bytes"))
    return values if column else metadata.num_rows, sum(chunk.total_uncompressed_size for chunk in chosen)


class RowChoice(NamedTuple):
    """A row that a conversion takes: its number in the split, and which touches (None: all)."""

    row: int
    touches: tuple[int, ...] | None = None


Made = tuple[pa.Table, Mapping[str, bytes]]
"""New rows, and the files that lie next to them, by path."""


class Step(Protocol):
    """What a conversion does to one row; small and picklable."""

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the flat schema that it writes, for the flat schema that it reads."""
        ...

    def apply(self, row: Row, choice: RowChoice, split: str) -> Made:
        """Return the new rows as a table of that schema, with files where it makes some.

        A row that raises IntegrityError or ItemError is left out and listed.
        """
        ...


class Pack(Protocol):
    """What an exchange format does to all new rows of a shard at once; small and picklable."""

    def schema(self, rows: pa.Schema) -> pa.Schema:
        """Return the schema of what the shard keeps, for that of the new rows."""
        ...

    def apply(self, shard: ShardName, rows: pa.Table, skipped: Sequence[Skipped]) -> Made:
        """Return what the shard keeps, an index, with the files of the foreign format."""
        ...


@dataclass(frozen=True)
class Conversion:
    """A conversion, decided down to its rows.

    ``options`` are JSON values, ``choices`` the rows of each split in order; the layout follows from the size
    of the source's rows where it is None. ``extra_dirs`` names where the step's files lie, ``is_current``
    says whether those of a finished shard are unchanged; ``write_files`` writes what follows from all rows,
    see :class:`tactile_toolkit.store.plan.BuildPlan`. ``pack`` gets the new rows of a whole shard, where they
    are not what the shard keeps.
    """

    source: Source
    operation: str
    options: Mapping[str, Any]
    step: Step
    choices: Mapping[str, Sequence[RowChoice]]
    rows_per_shard: int | None = None
    rows_per_group: int | None = None
    extra_dirs: tuple[str, ...] = ()
    is_current: Callable[[DataFolder, ShardRecord, bool], bool] | None = field(default=None, repr=False)
    write_files: Callable[[DataFolder, Manifest], Mapping[str, str]] = field(
        default=lambda _folder, _manifest: {}, repr=False
    )
    pack: Pack | None = None


@dataclass(frozen=True, eq=False)
class _ConvertShard:
    """Picklable: make one shard of a conversion.

    ``paths`` are the files of the source that hold its rows, ``start`` is the number of their first row.
    """

    shard: ShardName
    paths: tuple[str, ...] = field(repr=False)
    start: int
    choices: Sequence[RowChoice] = field(repr=False)
    step: Step = field(repr=False)
    schema: pa.Schema = field(repr=False)
    pack: Pack | None = field(default=None, repr=False)

    @property
    def size(self) -> int:
        """How many rows it works on."""
        return len(self.choices)

    def make(self) -> ShardContent:
        """Convert the rows; damaged ones are left out and listed."""
        tables, skipped = [self.schema.empty_table()], []
        files: dict[str, bytes] = {}
        for choice, row in self._rows():
            try:
                # Here for all steps: one that copies a column would pass on what it never looked at.
                require_touches(row)
                made, beside = self.step.apply(row, choice, self.shard.split)
                # Cast: Arrow names the items of lists in several ways, and a file has one schema.
                tables.append(made.cast(self.schema))
                files |= beside
            except (IntegrityError, ItemError) as error:
                reason, message = error.args if isinstance(error, ItemError) else (DAMAGED, str(error))
                skipped.append(Skipped(choice.row, reason, self._without_folders(message)))
        kept = pa.concat_tables(tables)
        if self.pack is not None:
            kept, packed = self.pack.apply(self.shard, kept, skipped)
            files |= packed
        return ShardContent(kept.combine_chunks(), tuple(skipped), files=files)

    def _without_folders(self, message: str) -> str:
        """Name files of the source as the manifest does, without their folder, which may be private."""
        for path in self.paths:
            message = message.replace(path, path.rpartition("/")[2])
        return message

    def _rows(self) -> Iterator[tuple[RowChoice, Row]]:
        """Read the blocks that hold chosen rows, one at a time, in order."""
        # Row groups without a chosen row are not read at all.
        wanted = {choice.row: choice for choice in self.choices}
        first, last = min(wanted), max(wanted)
        start = self.start
        for shard in map(Shard, self.paths):
            for index, group_start in enumerate(shard.group_starts[:-1]):
                if start + shard.group_starts[index + 1] <= first or start + group_start > last:
                    continue
                for group in shard.blocks(index):
                    for position in range(len(group.table)):
                        number = start + group.first_row + position
                        if number in wanted:
                            yield wanted[number], Row(group, position)
            start += len(shard)


def plan_conversion(conversion: Conversion) -> BuildPlan:
    """Decide which shards hold which rows; reads footers only. InputError when nothing is left to convert."""
    source, step = conversion.source, conversion.step
    names = class_names(source.schema)
    schema = with_features(step.schema(flat_schema(source.schema)), names)
    stored = schema if conversion.pack is None else with_features(conversion.pack.schema(schema), names)
    row_bytes = source.row_bytes()
    per_shard = conversion.rows_per_shard or max(1, min(_MOST_ROWS_PER_SHARD, _SHARD_BYTES // row_bytes))
    per_group = conversion.rows_per_group or max(1, min(per_shard, _GROUP_BYTES // row_bytes))
    tasks = []
    for split, choices in conversion.choices.items():
        shards = source.shards[split]
        starts = [0, *accumulate(map(len, shards))]
        size = per_shard
        if conversion.rows_per_shard is None:  # of many rows, as many as a worker can hold
            most = max(per_shard, _SHARD_BYTES // row_bytes)
            size = min(rows_per_shard(len(choices), per_shard), most)
        chunks = [choices[start : start + size] for start in range(0, len(choices), size)]
        for index, chunk in enumerate(chunks):
            first, last = (bisect_right(starts, chunk[end].row) - 1 for end in (0, -1))
            paths = tuple(shard.path for shard in shards[first : last + 1])
            name = ShardName(split, index, len(chunks))
            tasks.append(_ConvertShard(name, paths, starts[first], chunk, step, schema, conversion.pack))
    if not tasks:
        raise InputError(
            f"nothing is left of {source.name!r} after {conversion.operation!r}", next="choose fewer filters"
        )
    spec = {
        "operation": conversion.operation,
        "options": dict(conversion.options),
        "rows_per_shard": per_shard,
        "source": source.fingerprint(),
    }
    # JPEG does not compress again, and a dictionary or statistics of pictures would only take space.
    media = [name for name in MEDIA_COLUMN.values() if stored.get_field_index(name) >= 0]
    encodings = tuple((f"{name}.list.element.bytes", "PLAIN") for name in media)
    encodings += tuple((f"{field.name}.bytes", "PLAIN") for field in stored if field.type == MEDIA_TYPE)
    return BuildPlan(
        KIND,
        spec,
        tuple(source.shards),
        tuple(tasks),
        ParquetStyle(per_group, compression_level=3, encodings=encodings),
        extra_dirs=conversion.extra_dirs,
        is_current=conversion.is_current,
        libraries=("numpy", "pillow", "pyarrow", "simplejpeg"),
        write_files=conversion.write_files,
    )
