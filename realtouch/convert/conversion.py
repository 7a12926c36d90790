"""Conversions: source, rows, the step for a row, tables that index files, and how a conversion is run.

A conversion is planned from footers, and each shard is made from its own rows, block by block. An interrupted
conversion continues where it stopped. The same source and options give byte-identical Parquet for any number
of workers; see ``tactile_toolkit.store``.
"""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, groupby, pairwise
from os import PathLike, fspath
from typing import IO, Any, NamedTuple, Protocol, TypeVar, Unpack

import pyarrow as pa

from realtouch import kind, touch_card
from realtouch.touches import datasets, loading, schema, stored_round
from tactile_toolkit import cards, catalog, checked_fields, errors, places, read, store, touch
from tactile_toolkit.value_types import JsonObject

T = TypeVar("T")
Made = tuple[pa.Table, Mapping[str, bytes]]
"""New rows, and the files that lie next to them, by path."""
Pack = Callable[[store.ShardName, pa.Table, Sequence[store.Skipped]], Made]
"""Makes files of the new rows of a shard and an index, which the shard keeps; picklable."""
WriteFiles = Callable[[store.DataFolder, store.Manifest], Mapping[str, str]]
"""Writes the files that follow from all rows, and returns their checksums by path."""

# Prefixes of the columns ``file`` and ``sha256`` of an index, which names up to two files for each row.
_PREFIXES = ("", "meta_")

# Unpacked rows that a worker may hold.
_SHARD_BYTES = 256 << 20

# A touch read at random unpacks its whole row group.
_GROUP_BYTES = 32 << 20
_PAGE_BYTES = 256 << 10  # images of a round do not compress better in larger pages
_MAX_ROWS_PER_SHARD = 64
_IN_MEMORY_BYTES = 64 << 20  # of a file that is made before it is written
_ROW_OPTIONS = ("split", "ids", "labels", "per_class", "limit")


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

    source: loading.Source
    operation: str
    options: JsonObject
    step: Step
    choices: Choices
    rows_per_shard: int | None = None
    rows_per_group: int | None = None
    extra_dirs: tuple[str, ...] = ()
    write_files: WriteFiles = field(default=lambda _folder, _manifest: {}, repr=False)
    pack: Pack | None = None


Plan = Callable[[loading.Source, catalog.RowFilter], Conversion]
"""Plans a conversion of some rows of a source."""


def chosen_rows(source: loading.Source, rows: catalog.RowFilter) -> dict[str, list[RowChoice]]:
    """Choose rows of each split; reads small columns only, and none without filters.

    InputError: the touches have no labels or objects to choose by, or no row is chosen.
    """
    by_split = {split: datasets.dataset_of(shards) for split, shards in source.shards.items()}
    names = source.class_names
    if (rows.labels or rows.per_class) and not names:
        raise errors.InputError(
            f"the touches of {source.name!r} have no labels, by which some could be chosen",
            next="choose by --ids, or import them again with --map label=COLUMN",
        )
    has_numbers = any(not isinstance(chosen_id, str) for chosen_id in rows.ids or ())
    if has_numbers and "object_id" not in read.column_types(source.schema):
        raise errors.InputError(
            f"{source.name!r} has no column 'object_id'",
            next="choose by --labels, or import it again with --map object=COLUMN",
        )
    labels = rows.labels and [_label_name(label, names) for label in rows.labels]
    chosen = replace(rows, labels=labels).choose(by_split.items())
    return {split: list(map(RowChoice, numbers.tolist())) for split, _, numbers in chosen}


def _label_name(label: int | str, names: Sequence[str]) -> str:
    """Return the name of a class that was given by its name or its number."""
    text = str(label)
    if text not in names and text.isdecimal() and int(text) < len(names):
        return names[int(text)]
    return text


def marked_repetitions(source: loading.Source, choices: Choices) -> Choices:
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
    digests = {path: hashlib.sha256(content).hexdigest() for path, content in files.items()}
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


def schema_of(source: pa.Schema, columns: Mapping[str, tuple[pa.DataType, Collection[str]]]) -> pa.Schema:
    """Return those columns of a table that a source can fill.

    ``columns`` maps each column to its type and to columns of the source, one of which is needed; without
    any, the column is always kept.
    """
    known = read.column_types(source)
    return pa.schema(
        (name, data_type)
        for name, (data_type, needed) in columns.items()
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
    digests = {path: hashlib.sha256(content).hexdigest() for path, content in files.items()}
    for path, content in files.items():
        if not folder.has_sha256(path, digests[path]):
            folder.write_bytes(path, content)
    return digests


def write_stream(folder: store.DataFolder, path: str, fill: Callable[[IO[bytes]], T]) -> tuple[T, str]:
    """Write a large file as :func:`write_changed` does; return what ``fill`` returns, and the checksum.

    ``fill`` writes to a stream in which it may go back, which the streams of folders cannot.
    """
    with tempfile.SpooledTemporaryFile(_IN_MEMORY_BYTES) as made:
        filled = fill(made)
        made.seek(0)
        digest = hashlib.file_digest(made, "sha256").hexdigest()

        def copy(target: IO[bytes]) -> None:
            made.seek(0)  # it may be written again
            shutil.copyfileobj(made, target)

        if not folder.has_sha256(path, digest):
            folder.write(path, copy)
    return filled, digest


@dataclass(frozen=True, eq=False)
class _ConvertRows:
    """Makes shards of a conversion; picklable.

    ``shards`` are the files of the source with the rows, ``start`` is the number of their first row;
    ``absent`` are the columns that rows of a merged set lack.
    """

    shards: Sequence[read.Shard]
    start: int
    step: Step
    schema: pa.Schema
    pack: Pack | None
    absent: tuple[str, ...] | None = None

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
        if self.absent is not None:
            present = {name for name in kept.column_names if kept[name].null_count < len(kept)}
            new_schema = read.with_absent(self.schema, set(self.absent) - present)
            kept = kept.replace_schema_metadata(new_schema.metadata)
        if self.pack is not None:
            kept, packed = self.pack(shard, kept, skipped)
            files |= packed
        # Arrow's own allocator takes many times as long for hundreds of megabytes.
        whole = kept.combine_chunks(memory_pool=pa.system_memory_pool())
        return store.ShardContent(whole, tuple(skipped), files=files)

    def _rows(self, choices: Sequence[RowChoice]) -> Iterator[tuple[RowChoice, stored_round.StoredRound]]:
        """Read the blocks that hold chosen rows, one at a time, in order."""
        # Row groups without a chosen row are not read at all.
        chosen = {choice.row: choice for choice in choices}
        first, last = min(chosen), max(chosen)
        start = self.start
        for shard in self.shards:
            for index, group_start in enumerate(shard.group_starts[:-1]):
                if start + shard.group_starts[index + 1] <= first or start + group_start > last:
                    continue
                for group in shard.blocks(index):
                    for position in range(len(group.table)):
                        number = start + group.first_row + position
                        if number in chosen:
                            yield chosen[number], stored_round.StoredRound(group, position)
            start += len(shard)


def _chunks(
    choices: Sequence[RowChoice], size: int, absent: Sequence[tuple[str, ...] | None]
) -> list[Sequence[RowChoice]]:
    """Divide rows into shards; all rows of a shard lack the same columns, those of ``absent``."""
    ends = [0, *accumulate(len(list(alike)) for _, alike in groupby(absent))]
    return [
        choices[start : min(start + size, stop)]
        for run_start, stop in pairwise(ends)
        for start in range(run_start, stop, size)
    ]


def _file_of(starts: Sequence[int], choice: RowChoice) -> int:
    """Return the number of the file with a row, by the first row of each file."""
    return bisect_right(starts, choice.row) - 1


def plan_conversion(conversion: Conversion) -> store.BuildPlan:
    """Divide rows into shards; reads footers only."""
    source, step = conversion.source, conversion.step
    names = source.class_names
    new_schema = touch.with_features(step.schema(source.flat_schema), names)
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
        absent = [shard.absent_columns for shard in shards]
        chunks = _chunks(choices, size, [absent[_file_of(starts, choice)] for choice in choices])
        for index, chunk in enumerate(chunks):
            first, last = (_file_of(starts, chunk[end]) for end in (0, -1))
            convert_rows = _ConvertRows(
                shards[first : last + 1],
                starts[first],
                step,
                new_schema,
                conversion.pack,
                absent[first],
            )
            tasks.append(store.ShardTask(store.ShardName(split, index, len(chunks)), chunk, convert_rows))
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
        lists = [f"{name}.list.element" for name in schema.MEDIA_COLUMN.values() if name in new_schema.names]
        single = [name for name in new_schema.names if new_schema.field(name).type == touch.MEDIA_TYPE]
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
    ids: catalog.IdChoice | None
    labels: Sequence[int | str] | None
    per_class: int | None
    limit: int | None


def write_conversion(
    source: places.Name | places.Place, out: str | PathLike[str], plan: Plan, **job: Unpack[JobOptions]
) -> store.Manifest:
    """Write a conversion as a data set folder with a card; an interrupted one continues where it stopped."""
    run: dict[str, Any] = {**job}
    rows = catalog.RowFilter(**{name: run.pop(name) for name in _ROW_OPTIONS if name in run})
    return store.build(
        store.open_folder(fspath(out)),
        plan_build(source, out, plan, rows),
        write_card=touch_card.write_card,
        **run,
    )


def plan_build(
    source: places.Name | places.Place, out: str | PathLike[str], plan: Plan, rows: catalog.RowFilter
) -> store.BuildPlan:
    """Plan the conversion of some rows into a folder; writes nothing."""
    checked_fields.check_fields(rows, "the rows")
    opened = loading.Source.open(source, split=rows.split)
    conversion = plan(opened, rows)
    folder = store.open_folder(fspath(out))
    folder.refuse_source(opened.name, (shard.path for files in opened.shards.values() for shard in files))
    filters = {name: getattr(rows, name) for name in ("ids", "labels", "per_class")}
    options = {
        **conversion.options,
        "limit": rows.limit,
        **{name: value for name, value in filters.items() if value is not None},
        **cards.inherited_options([opened.place]),
    }
    origin = schema.origin_of(opened.schema, opened.manifest())
    # Recorded here, as pictures do not show whether touches were imported or rendered; rounds do.
    if origin == "imported" or (origin == "synthetic" and conversion.operation == "export"):
        options["touches"] = origin
    sensor = schema.sensor_of(opened.schema, opened.manifest())
    if sensor is not None and sensor != touch.GELSIGHT_MINI:
        options.setdefault("sensor", {"name": sensor})
    return plan_conversion(replace(conversion, options=options))
