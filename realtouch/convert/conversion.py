"""Basics of all conversions: source, rows, the step for a row, and tables that index files."""

from __future__ import annotations

import operator
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from typing import Any, NamedTuple, Protocol

import pyarrow as pa

from realtouch import contact, integrity, schema, stored_round, touch_dataset
from realtouch.kind import KIND
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


_IMAGES_PER_MEDIA: dict[touch.Kind, int] = {"seq": 64, "single": 1}  # by size: clips are a few dozen images


def parts_of(place: places.Place, split: str | None) -> tuple[str, ...]:
    """Return the named split, or all splits."""
    return place.splits if split is None else (split,)


@dataclass(frozen=True)
class Source:
    """A data set to convert: its name as the user gave it, its kind, and the shards of each split."""

    name: str
    shards: Mapping[str, tuple[read.Shard, ...]]
    kind: touch.Kind
    unfinished: str = ""

    @classmethod
    def open(cls, name: places.Name | places.Place, split: str | None = None) -> Source:
        """Find the splits of a data set (or the one given), fetching them first where they are on the Hub.

        Reads footers. Raises as :func:`realtouch.load`.
        """
        place = places.open_place(name).require_complete(split)
        splits = parts_of(place, split)
        shards = {each: place.shards(each, kind=KIND) for each in splits}
        for found in shards.values():
            deque(run.in_threads(schema.require_types, found, _READERS), maxlen=0)
        return cls(
            place.name, shards, schema.media_kind(shards[splits[0]][0].schema, place.name), place.unfinished
        )

    @property
    def schema(self) -> pa.Schema:
        """Arrow schema of the first shard."""
        return next(iter(self.shards.values()))[0].schema

    @property
    def class_names(self) -> tuple[str, ...]:
        """Name of each class; empty without labels."""
        return integrity.class_names_of(self._files())

    def require_frame(self, method: contact.ContactMethod) -> None:
        """Raise InputError unless the frames of clips can be chosen by a method."""
        schema.require_poses_for(method, read.column_types(self.schema), self.name)

    def manifest(self) -> store.Manifest | None:
        """Return the manifest next to the shards, if any."""
        return catalog.manifest_beside(next(iter(self.shards.values()))[0])

    def row_bytes(self) -> int:
        """Return the size of a row unpacked, on average over the data set; at least 1."""
        chunks = chain.from_iterable(run.in_threads(read.Shard.column_chunks, self._files(), _READERS))
        size: int = sum(chunk.total_uncompressed_size for chunk in chunks)
        return max(size // max(sum(map(len, self._files())), 1), 1)

    def media_bytes(self) -> int:
        """Return the size of an image or clip, on average over the data set; at least 1."""
        found = run.in_threads(
            partial(_media_bytes, f"{touch.MEDIA_COLUMN[self.kind]}."), self._files(), _READERS
        )
        count, size = map(sum, zip(*found, strict=True))
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
            split: list(run.in_threads(read.Shard.fingerprint, found, _READERS))
            for split, found in self.shards.items()
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
        ids = touch_dataset.dataset_of(source.shards[split]).ids
        first: dict[object, int] = {}
        rows = (first.setdefault(ids[each.row], each.row) for each in chosen)
        marked[split] = [
            each._replace(is_repeated=row != each.row) for each, row in zip(chosen, rows, strict=True)
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
    """Return the wanted columns that a source can fill.

    ``wanted`` maps each column to its type and to columns of the source, one of which is needed; without any,
    the column is always kept.
    """
    known = read.column_types(source)
    return pa.schema(
        (name, data_type)
        for name, (data_type, needed) in wanted.items()
        if not needed or any(each in known for each in needed)
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
