"""What all conversions share: the source, the rows, the tasks, and the finished folder.

A conversion is planned from footers and small columns alone; each task reads its own rows, block by block,
and makes one shard. See :mod:`tactile_toolkit.store.building` for resuming and byte-identical results.
"""

from __future__ import annotations

import operator
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, chain
from os import PathLike, fspath
from typing import Any, NamedTuple, Protocol, Unpack

import pyarrow as pa

from realtouch.card import write_card
from realtouch.columns import TouchRow
from realtouch.dataset import dataset_of
from realtouch.kind import KIND
from realtouch.schema import flat_schema, media_kind, origin_of, require_types
from tactile_toolkit import catalog, places, read, store
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.run import in_threads
from tactile_toolkit.touch import CLASS_NAMES, MEDIA_COLUMN, MEDIA_TYPE, Kind, with_features

# What a worker may hold, unpacked.
_SHARD_BYTES = 256 << 20
# A touch read at random unpacks its whole row group.
_GROUP_BYTES = 32 << 20
_PAGE_BYTES = 256 << 10  # of the images of a round, which do not compress any better together
_MOST_ROWS_PER_SHARD = 64
_READERS = 4  # threads that read footers


@dataclass(frozen=True)
class Source:
    """A data set to convert: its name as the user gave it, the shards of each split, and what it holds."""

    name: str
    shards: Mapping[str, tuple[read.Shard, ...]]
    kind: Kind
    unfinished: str = ""

    @classmethod
    def open(cls, name: places.Name | places.Place, split: str | None = None) -> Source:
        """Find the splits of a data set (or the one given), fetching them first where they are on the Hub.

        Reads footers. Raises as :func:`realtouch.load`.
        """
        place = places.open_place(name).require_complete(split)
        splits = (split,) if split is not None else place.splits
        shards = {each: place.shards(each, kind=KIND) for each in splits}
        for found in shards.values():
            deque(in_threads(require_types, found, _READERS), maxlen=0)
        return cls(place.name, shards, media_kind(shards[splits[0]][0].schema, place.name), place.unfinished)

    @property
    def schema(self) -> pa.Schema:
        """Arrow schema of the first shard."""
        return next(iter(self.shards.values()))[0].schema

    def manifest(self) -> store.Manifest | None:
        """Return the manifest next to the shards, where there is one."""
        return catalog.manifest_beside(next(iter(self.shards.values()))[0])

    def row_bytes(self) -> int:
        """Return the size of a row unpacked, on average over the data set; at least 1."""
        return self._average("")

    def media_bytes(self) -> int:
        """Return the size of an image or clip, on average over the data set; at least 1."""
        return self._average(f"{MEDIA_COLUMN[self.kind]}.")

    def _average(self, column: str) -> int:
        def measured(shard: read.Shard) -> tuple[int, int]:
            """Return the rows of a file, or the values of a column of bytes, and their size unpacked."""
            groups = map(shard.metadata.row_group, range(shard.metadata.num_row_groups))
            chunks = [group.column(index) for group in groups for index in range(group.num_columns)]
            chosen = [chunk for chunk in chunks if chunk.path_in_schema.startswith(column)]
            values = sum(chunk.num_values for chunk in chosen if chunk.path_in_schema.endswith(".bytes"))
            size = sum(chunk.total_uncompressed_size for chunk in chosen)
            return values if column else len(shard), size

        found = in_threads(measured, chain.from_iterable(self.shards.values()), _READERS)
        count, size = map(sum, zip(*found, strict=True))
        return max(size // max(count, 1), 1)

    def fingerprint(self) -> dict[str, list[dict[str, Any]]]:
        """Return JSON values that identify the rows: names, sizes and footers of the files.

        The footer holds offset and size of every column chunk: other content gives another footer, and
        reading 28 GB to plan a conversion would cost minutes.
        """
        return {
            split: list(in_threads(read.Shard.fingerprint, found, _READERS))
            for split, found in self.shards.items()
        }


class RowChoice(NamedTuple):
    """A row that a conversion takes: its number in the split, and which touches (None: all).

    ``is_repeated``: its id stands in a row before it, so that files of both would have one name.
    """

    row: int
    touches: tuple[int, ...] | None = None
    is_repeated: bool = False


Choices = Mapping[str, Sequence[RowChoice]]
"""The rows of each split that a conversion takes, in order."""

Made = tuple[pa.Table, Mapping[str, bytes]]
"""New rows, and the files that lie next to them, by path."""

Pack = Callable[[store.ShardName, pa.Table, Sequence[store.Skipped]], Made]
"""What makes files of all new rows of a shard, and an index of them, which the shard keeps; picklable."""


class Step(Protocol):
    """What a conversion does to one row; small and picklable."""

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the flat schema that it writes, for the flat schema that it reads."""
        ...

    def apply(self, row: TouchRow, choice: RowChoice, split: str) -> Made:
        """Return the new rows as a table of that schema, with files where it makes some.

        A row that raises IntegrityError is left out and listed.
        """
        ...


@dataclass(frozen=True)
class Conversion:
    """A conversion, decided down to its rows.

    ``options`` are JSON values; the layout follows from the size of the source's rows where it is None.
    ``extra_dirs`` names where files next to the rows lie; ``write_files`` writes what follows from all rows,
    see :class:`tactile_toolkit.store.BuildPlan`.
    """

    source: Source
    operation: str
    options: Mapping[str, Any]
    step: Step
    choices: Choices
    rows_per_shard: int | None = None
    rows_per_group: int | None = None
    extra_dirs: tuple[str, ...] = ()
    write_files: Callable[[store.DataFolder, store.Manifest], Mapping[str, str]] = field(
        default=lambda _folder, _manifest: {}, repr=False
    )
    pack: Pack | None = None


@dataclass(frozen=True, eq=False)
class _ConvertRows:
    """Picklable: makes shards of a conversion.

    ``shards`` are the files of the source that hold the rows, ``start`` is the number of their first row.
    """

    shards: Sequence[read.Shard]
    start: int
    step: Step
    schema: pa.Schema
    pack: Pack | None

    def __call__(self, shard: store.ShardName, choices: Sequence[RowChoice]) -> store.ShardContent:
        """Convert rows; damaged ones are left out and listed."""
        tables, skipped = [self.schema.empty_table()], []
        files: dict[str, bytes] = {}
        for choice, row in self._rows(choices):
            try:
                if choice.is_repeated:
                    problem = f"{row.value('id')!r} stands in an earlier round of split {shard.split!r}"
                    raise row.damaged("id", f"{problem} too; expected ids that differ")
                # Here for all steps: one that copies a column would pass on what it never looked at.
                row.require_touches()
                made, beside = self.step.apply(row, choice, shard.split)
                # Cast: Arrow names the items of lists in several ways, and a file has one schema.
                tables.append(made.cast(self.schema))
                files |= beside
            except IntegrityError as error:
                message = str(error)
                for each in self.shards:  # as the manifest names them: their folder may be private
                    message = message.replace(each.path, each.path.rpartition("/")[2])
                skipped.append(store.Skipped(choice.row, store.DAMAGED, message))
        kept = pa.concat_tables(tables)
        if self.pack is not None:
            kept, packed = self.pack(shard, kept, skipped)
            files |= packed
        return store.ShardContent(kept.combine_chunks(), tuple(skipped), files=files)

    def _rows(self, choices: Sequence[RowChoice]) -> Iterator[tuple[RowChoice, TouchRow]]:
        """Read the blocks that hold chosen rows, one at a time, in order."""
        # TouchRow groups without a chosen row are not read at all.
        wanted = {choice.row: choice for choice in choices}
        first, last = min(wanted), max(wanted)
        start = self.start
        for shard in self.shards:
            for index, group_start in enumerate(shard.group_starts[:-1]):
                if start + shard.group_starts[index + 1] <= first or start + group_start > last:
                    continue
                for group in shard.blocks(index):
                    for position in range(len(group.table)):
                        number = start + group.first_row + position
                        if number in wanted:
                            yield wanted[number], TouchRow(group, position)
            start += len(shard)


def plan_conversion(conversion: Conversion) -> store.BuildPlan:
    """Decide which shards hold which rows; reads footers only. InputError when nothing is left to convert."""
    source, step = conversion.source, conversion.step
    names = read.class_names(source.schema, CLASS_NAMES)
    schema = with_features(step.schema(flat_schema(source.schema)), names)
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
            size = min(store.rows_per_shard(len(choices), per_shard), most)
        chunks = [choices[start : start + size] for start in range(0, len(choices), size)]
        for index, chunk in enumerate(chunks):
            first, last = (bisect_right(starts, chunk[end].row) - 1 for end in (0, -1))
            work = _ConvertRows(shards[first : last + 1], starts[first], step, schema, conversion.pack)
            tasks.append(store.ShardTask(store.ShardName(split, index, len(chunks)), chunk, work))
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
    stored = schema.names if conversion.pack is None else ()
    media = [f"{name}.list.element" for name in MEDIA_COLUMN.values() if name in stored]
    media += [name for name in stored if schema.field(name).type == MEDIA_TYPE]
    encodings = tuple((f"{name}.bytes", "PLAIN") for name in media)
    is_flat = not any(name.endswith(".element") for name in media)
    per_page = None if is_flat else max(1, _PAGE_BYTES // source.media_bytes())
    return store.BuildPlan(
        KIND.name,
        spec,
        tuple(source.shards),
        tuple(tasks),
        store.ParquetStyle(per_group, compression_level=3, encodings=encodings, values_per_page=per_page),
        extra_dirs=conversion.extra_dirs,
        files_of=files_of,
        libraries=("numpy", "pillow", "pyarrow", "simplejpeg"),
        write_files=conversion.write_files,
    )


class JobOptions(store.RunKeywords, total=False):
    """How any conversion is done; see :func:`realtouch.clips_to_images`."""

    split: str | None
    limit: int | None


def convert(
    source: places.Name | places.Place,
    out: str | PathLike[str],
    plan: Callable[[Source, int | None], Conversion],
    *,
    split: str | None = None,
    limit: int | None = None,
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Write a conversion as a data set folder with a card; an interrupted one continues where it stopped.

    ``plan`` takes the source and the number of rounds of each split to take at most.
    """
    opened, folder = Source.open(source, split=split), store.open_folder(fspath(out))
    conversion = plan(opened, require_limit(limit))
    catalog.refuse_source(folder, opened.name, chain.from_iterable(opened.shards.values()))
    origin = origin_of(opened.schema, opened.manifest())
    # The terms are those of the source; columns of rounds say by themselves that they were rendered.
    if opened.unfinished:
        conversion = replace(conversion, options={**conversion.options, "unfinished": opened.unfinished})
    if origin == "imported" or (origin == "synthetic" and conversion.operation in ("frames", "export")):
        conversion = replace(conversion, options={**conversion.options, "touches": origin})
    return store.build(folder, plan_conversion(conversion), write_card=write_card, **run)


def first_rows(source: Source, limit: int | None) -> dict[str, list[RowChoice]]:
    """Choose the first so many rows of each split; all for None."""
    counts = {split: sum(map(len, shards)) for split, shards in source.shards.items()}
    return {split: list(map(RowChoice, range(count)[:limit])) for split, count in counts.items()}


def require_limit(limit: int | None, name: str = "limit") -> int | None:
    """Return a limit; InputError where it is below 1."""
    if limit is not None and limit < 1:
        raise InputError(f"the {name} is {limit}; expected an integer of at least 1")
    return None if limit is None else operator.index(limit)


def marked_repetitions(source: Source, choices: Choices) -> Choices:
    """Mark the rows of each split whose id stands in a row before them; reads the column of ids only."""
    marked = {}
    for split, chosen in choices.items():
        ids = dataset_of(source.shards[split]).ids
        first: dict[Any, int] = {}
        rows = (first.setdefault(ids[each.row], each.row) for each in chosen)
        marked[split] = [
            each._replace(is_repeated=row != each.row) for each, row in zip(chosen, rows, strict=True)
        ]
    return marked


# Of the columns ``file`` and ``sha256`` of an index, which name up to two files for each row.
_PREFIXES = ("", "meta_")


def with_files(
    index: pa.Table, files: Mapping[str, bytes], named: Sequence[Sequence[str]] | None = None
) -> Made:
    """Return the files of a shard with its index, which names up to two for each row: by default all."""
    digests = {path: store.sha256_hex(content) for path, content in files.items()}
    columns = [[path] * len(index) for path in files] if named is None else named
    for prefix, paths in zip(_PREFIXES, columns, strict=False):
        for name, values in (("file", paths), ("sha256", [digests[path] for path in paths])):
            index = index.append_column(f"{prefix}{name}", pa.array(values, pa.string()))
    return index, files


def files_of(folder: store.DataFolder, record: store.ShardRecord) -> dict[str, str]:
    """Return the checksum of each file that the index of a finished shard names, by path."""
    shard = read.Shard(folder.address(record.shard.data_path))
    found: dict[str, str] = {}
    for prefix in _PREFIXES:
        names = [f"{prefix}file", f"{prefix}sha256"]
        if all(name in shard.types for name in names):
            paths, digests = (column.to_pylist() for column in shard.read(columns=names).columns)
            found |= dict(zip(paths, digests, strict=True))
    return found


def checksums(folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
    """Return the checksum of each file that the shards name, for the manifest."""
    return {path: sha256 for record in manifest.shards for path, sha256 in files_of(folder, record).items()}


def schema_of(source: pa.Schema, wanted: Mapping[str, tuple[pa.DataType, Collection[str]]]) -> pa.Schema:
    """Return those of the wanted columns that a source can fill.

    With the type of each stand columns of the source, of which one is needed; without any it is always there.
    """
    known = read.column_types(source)
    return pa.schema(
        (name, data_type)
        for name, (data_type, needed) in wanted.items()
        if not needed or any(each in known for each in needed)
    )


def table_of(schema: pa.Schema, columns: Mapping[str, Any]) -> pa.Table:
    """Return the columns of a schema as a table; those that are not given have no values."""
    unknown = [None] * len(columns["id"])
    return pa.table([pa.array(columns.get(each.name, unknown), each.type) for each in schema], schema=schema)


def write_changed(folder: store.DataFolder, path: str, content: bytes) -> str:
    """Write a file only where it differs: a run over a finished set changes nothing. Return its checksum."""
    sha256 = store.sha256_hex(content)
    if not store.is_unchanged(folder, path, sha256):
        folder.write_bytes(path, content)
    return sha256
