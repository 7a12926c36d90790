"""Shards: their names, which split a Parquet file belongs to, and the records that prove what was written."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import zip_longest
from typing import Annotated

import msgspec

from tactile_toolkit import redaction, shown_text
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.json_types import JsonDict, JsonObject, JsonValue
from tactile_toolkit.store.folder import PENDING_FOLDER
from tactile_toolkit.store.sealed_json import LARGEST, Count, Sha256

DAMAGED = "damaged"
"""Reason to leave out an item whose stored data is damaged."""

_CAUSES_SHOWN = 3
DATA_FOLDER = "data"
VIEWER_FOLDER = "viewer"
"""Repeats the rows for the Hub's page (`tactile_toolkit.exchange.copies`); copies may leave it out."""
MAX_ROWS = 1 << 40
"""Largest number of rows that a shard may state, more than any disk holds."""

_MANY_SHARDS = 8192

# Numbers have five digits, or more if five are too few; so a shard has one name.
_NUMBER = "([0-9]{5}|[1-9][0-9]{5,11})"
_SHARD_PATTERN = re.compile(rf"(\w+)-{_NUMBER}-of-{_NUMBER}\.parquet")


class ShardName(msgspec.Struct, frozen=True, order=True):
    """Name of a shard: split, index from 0, and number of shards, as in ``train-00000-of-00024``."""

    split: str
    index: int
    count: int

    def __str__(self) -> str:
        return f"{self.split}-{self.index:05d}-of-{self.count:05d}"

    @property
    def data_path(self) -> str:
        """Path of the rows inside the data set folder."""
        return f"{DATA_FOLDER}/{self.split}-{self.index:05d}-of-{self.count:05d}.parquet"

    @property
    def record_path(self) -> str:
        """Path of the shard's record while a run is under way."""
        return f"{PENDING_FOLDER}/{self}.json"

    @property
    def report_path(self) -> str:
        """Path of the shard's report rows while a run is under way."""
        return f"{PENDING_FOLDER}/report-{self}.parquet"

    @classmethod
    def parse(cls, file_name: str) -> ShardName | None:
        """Read the name of a shard file; None for any other name."""
        match = _SHARD_PATTERN.fullmatch(file_name)
        if match is None:
            return None
        split, index, count = match.groups()
        return cls(split, int(index), int(count))

    @property
    def can_be_read_back(self) -> bool:
        """Whether parsing the name gives the same shard."""
        return self.index < self.count and self.parse(f"{self}.parquet") == self


def rows_per_shard(rows: int, usual: int) -> int:
    """Return the size of the shards of a split with this many rows.

    It is ``usual`` up to 8,192 shards. Larger splits have larger shards, twice the size for every factor of
    four, because each shard costs a request and a record.
    """
    growth = 1
    while rows > _MANY_SHARDS * usual * growth**2:
        growth *= 2
    return usual * growth


def shard_ranges(
    split: str, rows: int, *, smallest: int, largest: int, wanted: int, together: int = 1
) -> list[tuple[ShardName, range]]:
    """Divide the rows of a split into about ``wanted`` shards of ``smallest`` to ``largest`` rows.

    The sizes follow from the split only, so any number of workers agrees on them. A shard is what a worker
    holds in memory and what is lost if it is killed; even a small run has several for each worker. Shards end
    after a multiple of ``together`` rows, if the largest size allows it.
    """
    size = max(smallest, -(-rows // wanted))
    size = min(rows_per_shard(rows, largest), -(-size // together) * together)
    starts = range(0, rows, size)
    return [
        (ShardName(split, index, len(starts)), range(start, min(start + size, rows)))
        for index, start in enumerate(starts)
    ]


class Skipped(msgspec.Struct, frozen=True):
    """An item of a source that gave no row: a stable word for counting, and a message without secrets."""

    id: Annotated[int, msgspec.Meta(ge=-LARGEST - 1, le=LARGEST)]
    reason: str
    message: str

    def __post_init__(self) -> None:
        msgspec.structs.force_setattr(self, "message", shown_text.printable(redaction.redact(self.message)))


class ShardRecord(msgspec.Struct, frozen=True, dict=True):
    """Facts about a finished shard, as manifests and pending records store them.

    ``report_sha256`` is the checksum of its report rows, where there are any. ``statistics`` are counts over
    its rows that add up over shards, see :func:`add_up`. ``unpacked_bytes`` is the size of its rows in
    memory, for the card. ``source_digest`` is the checksum of what it was made of, where the specification
    does not identify that.
    """

    file: str
    split: str
    rows: Annotated[int, msgspec.Meta(ge=0, le=MAX_ROWS)]
    bytes: Count
    sha256: Sha256
    report_sha256: Sha256 | None = None
    skipped: tuple[Skipped, ...] = ()
    statistics: JsonDict | None = None
    unpacked_bytes: Count = 0
    source_digest: Sha256 | None = None

    @classmethod
    def of(cls, shard: ShardName, rows: int, size_bytes: int, sha256: str, **more: JsonValue) -> ShardRecord:
        """Return the record of a shard."""
        return cls(shard.data_path, shard.split, rows, size_bytes, sha256, **more)

    @cached_property
    def shard(self) -> ShardName:
        """Shard of the record; ValueError if the file does not have the name of a shard."""
        folder, _, name = self.file.rpartition("/")
        shard = ShardName.parse(name)
        if shard is None or folder != DATA_FOLDER or shard.index >= shard.count or shard.split != self.split:
            raise ValueError(f"found file {self.file[:80]!r}, expected a shard's name and split")
        return shard

    def is_size_of(self, sizes: Mapping[str, int]) -> bool:
        """Return whether ``sizes``, those of the files in ``data``, has the shard's file with its size."""
        return sizes.get(self.file.rpartition("/")[2]) == self.bytes

    def to_dict(self) -> JsonDict:
        """Return JSON values."""
        values: JsonDict = msgspec.to_builtins(self)
        for name in ("statistics", "source_digest"):
            if values[name] is None:
                del values[name]
        return values


@dataclass(frozen=True, slots=True)
class Finding:
    """One problem: a path inside the folder, and what was found and expected."""

    file: str
    problem: str


def add_up(parts: Sequence[JsonObject]) -> JsonDict:
    """Add the counts of several shards, key by key; lists add by index, a missing entry counts 0.

    Values are numbers, lists of numbers, or mappings of them by name; keys keep the order of their first
    occurrence.
    """
    names = dict.fromkeys(name for part in parts for name in part)
    total: JsonDict = {}
    for name in names:
        values = [part[name] for part in parts if name in part]
        if isinstance(values[0], Mapping):
            total[name] = add_up(values)
        elif isinstance(values[0], Sequence):
            total[name] = [sum(column) for column in zip_longest(*values, fillvalue=0)]
        else:
            total[name] = sum(values)
    return total


def require_rows(shards: Sequence[tuple[int, Sequence[Skipped]]]) -> None:
    """Refuse a run that left every item out: then its source is wrong, not its items.

    Takes the number of rows of each shard, and its skipped items.
    """
    skipped = [item for _, left_out in shards for item in left_out]
    if skipped and not any(rows for rows, _ in shards):
        first = {item.reason: item.message for item in reversed(skipped)}
        causes = [f"{reason}: {first[reason]}" for reason in dict.fromkeys(item.reason for item in skipped)]
        raise (IntegrityError if set(first) == {DAMAGED} else InputError)(
            f"no row is left: all {len(skipped):,} were left out, nothing was written; the first of each "
            f"reason: {'; '.join(causes[:_CAUSES_SHOWN])}",
            next="correct the source, or choose another one",
        )
