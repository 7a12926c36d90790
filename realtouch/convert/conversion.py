"""Conversions: source, rows, the step for a row, tables that index files, and how a conversion is run.

It is planned from footers, and each shard is made from its own rows, block by block. An interrupted
conversion continues where it stopped. The same source and options give byte-identical Parquet for any number
of workers; see ``tactile_toolkit.store``.
"""

from __future__ import annotations

import operator
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import accumulate, chain
from os import PathLike, fspath
from typing import Any, NamedTuple, Protocol, Unpack

import pyarrow as pa

from realtouch import contact, kind, touch_card
from realtouch.kind import KIND
from realtouch.touches import datasets, schema, stored_round
from tactile_toolkit import catalog, errors, places, read, run, store, touch
from tactile_toolkit.json_types import JsonObject

_READERS = 4  # threads that read footers
Made = tuple[pa.Table, Mapping[str, bytes]]
"""New rows, and the files that lie next to them, by path."""
Pack = Callable[[store.ShardName, pa.Table, Sequence[store.Skipped]], Made]
"""Makes files of the new rows of a shard and an index, which the shard keeps; picklable."""
WriteFiles = Callable[[store.DataFolder, store.Manifest], Mapping[str, str]]
"""Writes the files that follow from all rows, and returns their checksums by path."""

# Prefixes of the columns ``file`` and ``sha256`` of an index, which names up to two files for each row.
_PREFIXES = ("", "meta_")
_IMAGES_PER_MEDIA: dict[schema.Kind, int] = {"seq": 64, "single": 1}  # by size: clips are a few dozen images

# Unpacked rows that a worker may hold.
_SHARD_BYTES = 256 << 20

# A touch read at random unpacks its whole row group.
_GROUP_BYTES = 32 << 20
_PAGE_BYTES = 256 << 10  # images of a round do not compress better in larger pages
_MAX_ROWS_PER_SHARD = 64


def parts_of(data_set: places.Place, split: str | None) -> tuple[str, ...]:
    """Return the named split, or all splits."""
    return data_set.splits if split is None else (split,)


@dataclass(frozen=True)
class Source:
    """A data set to convert: its name as the user gave it, its kind, and the shards of each split."""

    name: str
    shards: Mapping[str, tuple[read.Shard, ...]]
    kind: schema.Kind
    unfinished: str = ""

    @classmethod
    def open(cls, name: places.Name | places.Place, split: str | None = None) -> Source:
        """Find the splits of a data set (or the one given), fetching them first where they are on the Hub.

        Reads footers. Raises as :func:`realtouch.load`.
        """
        data_set = places.open_place(name).require_complete(split)
        splits = parts_of(data_set, split)
        shards = {part: data_set.shards(part, kind=KIND) for part in splits}
        for files in shards.values():
            deque(run.in_threads(schema.require_types, files, _READERS), maxlen=0)
        return cls(
            data_set.name,
            shards,
            schema.media_kind(shards[splits[0]][0].schema, data_set.name),
            data_set.unfinished,
        )

    @property
    def schema(self) -> pa.Schema:
        """Arrow schema of the first shard."""
        return next(iter(self.shards.values()))[0].schema

    @property
    def class_names(self) -> tuple[str, ...]:
        """Name of each class; empty without labels."""
        return schema.class_names_of(self._files())

    def require_frame(self, method: contact.ContactMethod) -> None:
        """Raise InputError unless the frames of clips can be chosen by a method."""
        schema.require_poses_for(method, read.column_types(self.schema), self.name)

    def manifest(self) -> store.Manifest | None:
        """Return the manifest next to the shards, if any."""
        return catalog.manifest_beside(next(iter(self.shards.values()))[0].path)

    def row_bytes(self) -> int:
        """Return the size of a row unpacked, on average over the data set; at least 1."""
        chunks = chain.from_iterable(run.in_threads(read.Shard.column_chunks, self._files(), _READERS))
        size: int = sum(chunk.total_uncompressed_size for chunk in chunks)
        return max(size // max(sum(map(len, self._files())), 1), 1)

    def media_bytes(self) -> int:
        """Return the size of an image or clip, on average over the data set; at least 1."""
        sizes = run.in_threads(
            partial(_media_bytes, f"{schema.MEDIA_COLUMN[self.kind]}."), self._files(), _READERS
        )
        count, size = map(sum, zip(*sizes, strict=True))
        return max(size // max(count, 1), 1)

    def image_bytes(self) -> int:
        """Return the approximate size of an image, or of a frame of a clip; at least 1."""
        return self.media_bytes() // _IMAGES_PER_MEDIA[self.kind] or 1

    def _files(self) -> Iterator[read.Shard]:
        return chain.from_iterable(self.shards.values())

    def fingerprint(self) -> dict[str, list[dict[str, str | int]]]:
        """Return JSON values that identify the rows: names, sizes and footers of the files.

        The footer holds offset and size of every column chunk: other content gives another footer, and
        reading 28 GB to plan a conversion would cost minutes.
        """
        return {
            split: list(run.in_threads(read.Shard.fingerprint, files, _READERS))
            for split, files in self.shards.items()
        }


def _media_bytes(column: str, shard: read.Shard) -> tuple[int, int]:
    """Return the number of values of a column of bytes, and the size of the column unpacked."""
    chosen = [chunk for chunk in shard.column_chunks() if chunk.path_in_schema.startswith(column)]
    values = sum(chunk.num_values for chunk in chosen if chunk.path_in_schema.endswith(".bytes"))
    return values, sum(chunk.total_uncompressed_size for chunk in chosen)


class RowChoice(NamedTuple):
    """A row that a conversion takes: its number in the split, and which touches (None: all).

    ``is_repeated``: an earlier row has the same id, so that files of both would have the same name.
    """

    row: int
    touches: tuple[int, ...] | None = None
    is_repeated: bool = False


Choices = Mapping[str, Sequence[RowChoice]]
"""The rows of each split that a conversion takes, in order."""


class Step(Protocol):
    """Step of a conversion for one row; small and picklable."""

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the flat schema of the result, given that of the source."""
        ...

    def apply(self, row: stored_round.StoredRound, choice: RowChoice, split: str) -> Made:
        """Return the new rows as a table of that schema, and new files.

        Rows that raise IntegrityError are left out and listed.
        """
        ...


@dataclass(frozen=True)
class Conversion:
    """A conversion and the rows that it takes.

    ``options`` are JSON values. ``rows_per_shard`` and ``rows_per_group`` follow from the size of the rows of
    the source if they are None. ``extra_dirs`` are the folders of files next to the rows; ``write_files``
    writes files that follow from all rows; see :class:`tactile_toolkit.store.BuildPlan`.
    """

    source: Source
    operation: str
    options: JsonObject
    step: Step
    choices: Choices
    rows_per_shard: int | None = None
    rows_per_group: int | None = None
    extra_dirs: tuple[str, ...] = ()
    write_files: WriteFiles = field(default=lambda _folder, _manifest: {}, repr=False)
    pack: Pack | None = None


def first_rows(source: Source, limit: int | None) -> dict[str, list[RowChoice]]:
    """Choose the first ``limit`` rows of each split; all of them for None."""
    counts = {split: sum(map(len, shards)) for split, shards in source.shards.items()}
    return {split: list(map(RowChoice, range(count)[:limit])) for split, count in counts.items()}


def require_limit(limit: int | None, name: str = "limit") -> int | None:
    """Return a limit; InputError if it is below 1."""
    if limit is None:
        return None
    if limit < 1:
        raise errors.InputError(f"the {name} is {limit}; expected an integer of at least 1")
    return operator.index(limit)


def marked_repetitions(source: Source, choices: Choices) -> Choices:
    """Mark rows with a duplicate id in their split; reads the column of ids only."""
    marked = {}
    for split, chosen in choices.items():
        ids = datasets.dataset_of(source.shards[split]).ids
        first: dict[object, int] = {}
        rows = (first.setdefault(ids[choice.row], choice.row) for choice in chosen)
        marked[split] = [
            choice._replace(is_repeated=row != choice.row) for choice, row in zip(chosen, rows, strict=True)
        ]
    return marked


def with_files(
    index: pa.Table, files: Mapping[str, bytes], named: Sequence[Sequence[str]] | None = None
) -> Made:
    """Return the files of a shard and its index, which names up to two files for each row."""
    digests = {path: store.sha256_hex(content) for path, content in files.items()}
    columns = named or [[path] * len(index) for path in files]
    for prefix, paths in zip(_PREFIXES, columns, strict=False):
        for name, values in (("file", paths), ("sha256", [digests[path] for path in paths])):
            index = index.append_column(f"{prefix}{name}", pa.array(values, pa.string()))
    return index, files


def files_of(folder: store.DataFolder, path: str) -> dict[str, str]:
    """Return the checksum of each file that the index of a finished shard names, by path."""
    shard = read.Shard(folder.address(path))
    checksums_of: dict[str, str] = {}
    for prefix in _PREFIXES:
        names = [f"{prefix}file", f"{prefix}sha256"]
        if all(name in shard.types for name in names):
            paths, digests = (column.to_pylist() for column in shard.read(columns=names).columns)
            checksums_of |= dict(zip(paths, digests, strict=True))
    return checksums_of


def checksums(folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
    """Return the checksum of each file that the shards name, for the manifest."""
    return {
        path: sha256 for record in manifest.shards for path, sha256 in files_of(folder, record.file).items()
    }


def schema_of(source: pa.Schema, wanted: Mapping[str, tuple[pa.DataType, Collection[str]]]) -> pa.Schema:
    """Return the wanted columns that a source can fill.

    ``wanted`` maps each column to its type and to columns of the source, one of which is needed; without any,
    the column is always kept.
    """
    known = read.column_types(source)
    return pa.schema(
        (name, data_type)
        for name, (data_type, needed) in wanted.items()
        if not needed or any(column in known for column in needed)
    )


def table_of_columns(schema: pa.Schema, columns: Mapping[str, Any]) -> pa.Table:
    """Return the columns of a schema as a table; columns that are not given hold nulls."""
    unknown = [None] * len(columns["id"])

    def packed(field: pa.Field) -> pa.Array:
        values = columns.get(field.name, unknown)
        return values.cast(field.type) if isinstance(values, pa.Array) else pa.array(values, field.type)

    return pa.table(list(map(packed, schema)), schema=schema)


def write_changed(folder: store.DataFolder, files: Mapping[str, bytes]) -> dict[str, str]:
    """Write the files that changed and return the checksums of all; unchanged files are not rewritten."""
    digests = {path: store.sha256_hex(content) for path, content in files.items()}
    for path, content in files.items():
        if not folder.has_sha256(path, digests[path]):
            folder.write_bytes(path, content)
    return digests


@dataclass(frozen=True, eq=False)
class _ConvertRows:
    """Makes shards of a conversion; picklable.

    ``shards`` are the files of the source with the rows, ``start`` is the number of their first row.
    """

    shards: Sequence[read.Shard]
    start: int
    step: Step
    schema: pa.Schema
    pack: Pack | None

    def __call__(self, shard: store.ShardName, choices: Sequence[RowChoice]) -> store.ShardContent:
        """Convert rows; damaged ones are left out and listed."""
        tables = [self.schema.empty_table()]
        skipped = []
        files: dict[str, bytes] = {}
        for choice, row in self._rows(choices):
            try:
                if choice.is_repeated:
                    raise row.damaged(
                        "id",
                        f"{row.value('id')!r} is also the id of an earlier round of split {shard.split!r}; "
                        "expected unique ids",
                    )
                # Checked for all steps: those that copy a column do not read it.
                row.require_touches()
                made, beside = self.step.apply(row, choice, shard.split)
                # Cast: Arrow names the items of lists in several ways, and a file has one schema.
                tables.append(made.cast(self.schema))
                files |= beside
            except errors.IntegrityError as error:
                message = str(error)
                for source_shard in self.shards:  # as the manifest names them: their folder may be private
                    message = message.replace(source_shard.path, source_shard.path.rpartition("/")[2])
                skipped.append(store.Skipped(choice.row, store.Skipped.DAMAGED, message))
        kept = pa.concat_tables(tables)
        if self.pack is not None:
            kept, packed = self.pack(shard, kept, skipped)
            files |= packed
        # Arrow's own allocator takes many times as long for hundreds of megabytes.
        whole = kept.combine_chunks(memory_pool=pa.system_memory_pool())
        return store.ShardContent(whole, tuple(skipped), files=files)

    def _rows(self, choices: Sequence[RowChoice]) -> Iterator[tuple[RowChoice, stored_round.StoredRound]]:
        """Read the blocks that hold chosen rows, one at a time, in order."""
        # Row groups without a chosen row are not read at all.
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
                            yield wanted[number], stored_round.StoredRound(group, position)
            start += len(shard)


def plan_conversion(conversion: Conversion) -> store.BuildPlan:
    """Divide rows into shards; reads footers only. InputError if nothing is left to convert."""
    source, step = conversion.source, conversion.step
    names = source.class_names
    wanted = touch.with_features(step.schema(schema.flat_schema(source.schema)), names)
    row_bytes = source.row_bytes()
    per_shard = conversion.rows_per_shard or max(1, min(_MAX_ROWS_PER_SHARD, _SHARD_BYTES // row_bytes))
    per_group = conversion.rows_per_group or max(1, min(per_shard, _GROUP_BYTES // row_bytes))
    tasks = []
    for split, choices in conversion.choices.items():
        shards = source.shards[split]
        starts = [0, *accumulate(map(len, shards))]
        size = per_shard
        if conversion.rows_per_shard is None:  # a large split gets shards as large as a worker can hold
            most = max(per_shard, _SHARD_BYTES // row_bytes)
            size = min(store.rows_per_shard(len(choices), per_shard), most)
        chunks = [choices[start : start + size] for start in range(0, len(choices), size)]
        for index, chunk in enumerate(chunks):
            first, last = (bisect_right(starts, chunk[end].row) - 1 for end in (0, -1))
            work = _ConvertRows(shards[first : last + 1], starts[first], step, wanted, conversion.pack)
            tasks.append(store.ShardTask(store.ShardName(split, index, len(chunks)), chunk, work))
    if not tasks:
        raise errors.InputError(
            f"nothing is left of {source.name!r} after {conversion.operation!r}", next="choose fewer filters"
        )
    spec = {
        "operation": conversion.operation,
        "options": dict(conversion.options),
        "rows_per_shard": per_shard,
        "source": source.fingerprint(),
    }
    # JPEG does not compress again, and a dictionary or statistics of pictures would only take space.
    encodings: tuple[tuple[str, str], ...] = ()
    per_page = None
    if conversion.pack is None:
        lists = [f"{name}.list.element" for name in schema.MEDIA_COLUMN.values() if name in wanted.names]
        single = [name for name in wanted.names if wanted.field(name).type == touch.MEDIA_TYPE]
        encodings = tuple((f"{name}.bytes", "PLAIN") for name in [*lists, *single])
        if lists:
            per_page = max(1, _PAGE_BYTES // source.media_bytes())
    return store.BuildPlan(
        kind.KIND.name,
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
    """Options of all conversions; see :func:`realtouch.clips_to_images`."""

    split: str | None
    limit: int | None


def write_conversion(
    source: places.Name | places.Place,
    out: str | PathLike[str],
    plan: Callable[[Source, int | None], Conversion],
    *,
    split: str | None = None,
    limit: int | None = None,
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Write a conversion as a data set folder with a card; an interrupted one continues where it stopped.

    ``plan`` is a function of the source and the greatest number of rounds of each split.
    """
    opened = Source.open(source, split=split)
    folder = store.open_folder(fspath(out))
    conversion = plan(opened, require_limit(limit))
    folder.refuse_source(opened.name, (shard.path for files in opened.shards.values() for shard in files))
    origin = schema.origin_of(opened.schema, opened.manifest())
    # Recorded here, as pictures do not show whether touches were imported or rendered; rounds do.
    if opened.unfinished:
        conversion = replace(conversion, options={**conversion.options, "unfinished": opened.unfinished})
    if origin == "imported" or (origin == "synthetic" and conversion.operation in ("frames", "export")):
        conversion = replace(conversion, options={**conversion.options, "touches": origin})
    return store.build(folder, plan_conversion(conversion), write_card=touch_card.write_card, **run)
