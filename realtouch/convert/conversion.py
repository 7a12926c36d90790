"""What all conversions share: their source, the rows they take, and what becomes of one row."""

from __future__ import annotations

import operator
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from typing import Any, NamedTuple, Protocol

import pyarrow as pa

from realtouch.kind import KIND
from realtouch.schema import media_kind, require_types
from realtouch.stored_round import StoredRound
from realtouch.touch_dataset import dataset_of
from tactile_toolkit import catalog, places, read, store
from tactile_toolkit.errors import InputError
from tactile_toolkit.run import in_threads
from tactile_toolkit.touch import MEDIA_COLUMN, Kind

_READERS = 4  # threads that read footers

Made = tuple[pa.Table, Mapping[str, bytes]]
"""New rows, and the files that lie next to them, by path."""

Pack = Callable[[store.ShardName, pa.Table, Sequence[store.Skipped]], Made]
"""What makes files of all new rows of a shard, and an index of them, which the shard keeps; picklable."""


def parts_of(place: places.Place, split: str | None) -> tuple[str, ...]:
    """Return the splits that are meant: the one named, or all."""
    if split is None:
        return place.splits
    return (split,)


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
        splits = parts_of(place, split)
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
        sizes = in_threads(_unpacked_bytes, self._files(), _READERS)
        return max(sum(sizes) // max(sum(map(len, self._files())), 1), 1)

    def media_bytes(self) -> int:
        """Return the size of an image or clip, on average over the data set; at least 1."""
        column = f"{MEDIA_COLUMN[self.kind]}."
        found = in_threads(partial(_media_bytes, column), self._files(), _READERS)
        count, size = map(sum, zip(*found, strict=True))
        return max(size // max(count, 1), 1)

    def _files(self) -> Iterator[read.Shard]:
        return chain.from_iterable(self.shards.values())

    def fingerprint(self) -> dict[str, list[dict[str, Any]]]:
        """Return JSON values that identify the rows: names, sizes and footers of the files.

        The footer holds offset and size of every column chunk: other content gives another footer, and
        reading 28 GB to plan a conversion would cost minutes.
        """
        return {
            split: list(in_threads(read.Shard.fingerprint, found, _READERS))
            for split, found in self.shards.items()
        }


def _chunks(shard: read.Shard) -> Iterator[Any]:
    """Yield what the footer says of each column chunk of a file."""
    groups = map(shard.metadata.row_group, range(shard.metadata.num_row_groups))
    return (group.column(index) for group in groups for index in range(group.num_columns))


def _unpacked_bytes(shard: read.Shard) -> int:
    return sum(chunk.total_uncompressed_size for chunk in _chunks(shard))


def _media_bytes(column: str, shard: read.Shard) -> tuple[int, int]:
    """Return the number of values of a column of bytes, and the size of the column unpacked."""
    chosen = [chunk for chunk in _chunks(shard) if chunk.path_in_schema.startswith(column)]
    values = sum(chunk.num_values for chunk in chosen if chunk.path_in_schema.endswith(".bytes"))
    return values, sum(chunk.total_uncompressed_size for chunk in chosen)


class RowChoice(NamedTuple):
    """A row that a conversion takes: its number in the split, and which touches (None: all).

    ``is_repeated``: its id stands in a row before it, so that files of both would have one name.
    """

    row: int
    touches: tuple[int, ...] | None = None
    is_repeated: bool = False


Choices = Mapping[str, Sequence[RowChoice]]
"""The rows of each split that a conversion takes, in order."""


WriteFiles = Callable[[store.DataFolder, store.Manifest], Mapping[str, str]]
"""Writes the files that follow from all rows, and returns their checksums by path."""


class Step(Protocol):
    """What a conversion does to one row; small and picklable."""

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the flat schema that it writes, for the flat schema that it reads."""
        ...

    def apply(self, row: StoredRound, choice: RowChoice, split: str) -> Made:
        """Return the new rows as a table of that schema, with files where it makes some.

        A row that raises IntegrityError is left out and listed.
        """
        ...


@dataclass(frozen=True)
class Conversion:
    """A conversion, decided down to its rows.

    ``options`` are JSON values; the layout follows from the size of the source's rows where it is None.
    ``extra_dirs`` names where files next to the rows lie; ``write_files`` writes what follows from all rows,
    see :class:`tactile_toolkit.store.job.BuildPlan`.
    """

    source: Source
    operation: str
    options: Mapping[str, Any]
    step: Step
    choices: Choices
    rows_per_shard: int | None = None
    rows_per_group: int | None = None
    extra_dirs: tuple[str, ...] = ()
    write_files: WriteFiles = field(default=lambda _folder, _manifest: {}, repr=False)
    pack: Pack | None = None


def first_rows(source: Source, limit: int | None) -> dict[str, list[RowChoice]]:
    """Choose the first so many rows of each split; all for None."""
    counts = {split: sum(map(len, shards)) for split, shards in source.shards.items()}
    return {split: list(map(RowChoice, range(count)[:limit])) for split, count in counts.items()}


def require_limit(limit: int | None, name: str = "limit") -> int | None:
    """Return a limit; InputError where it is below 1."""
    if limit is None:
        return None
    if limit < 1:
        raise InputError(f"the {name} is {limit}; expected an integer of at least 1")
    return operator.index(limit)


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
