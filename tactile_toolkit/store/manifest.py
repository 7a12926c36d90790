"""Documents of a data set folder, sealed with a digest of themselves: records of shards, and the manifest."""

from __future__ import annotations

import contextlib
import gc
import hashlib
import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import zip_longest
from pathlib import PurePath
from typing import Annotated, Any, ClassVar, TypeVar, cast

import msgspec

from tactile_toolkit import errors, kind, wording
from tactile_toolkit.store.files import names_inside
from tactile_toolkit.store.folder import PENDING_FOLDER, DataFolder
from tactile_toolkit.value_types import JsonDict, JsonObject

MANIFEST_FILE = "manifest.json"
DATA_FOLDER = "data"
CARD_FILE = "README.md"
"""The data card."""
SCHEMA_VERSION = 3
"""The only version that is written and read."""
T = TypeVar("T")

_FIRST_LINE = "{\n"
# Fields that manifests have and files of that name of other programs lack.
_FIELDS = (b'"sha256_of_all_below"', b'"schema_version"', b'"shards"')
# Fields that are left out of the text if they are empty.
_OPTIONAL = ("libraries", "planned", "statistics", "trees")

_LARGEST = (1 << 63) - 1
Count = Annotated[int, msgspec.Meta(ge=0, le=_LARGEST)]
Sha256 = Annotated[str, msgspec.Meta(pattern=r"\A[0-9a-f]{64}\Z")]
VIEWER_FOLDER = "viewer"
"""Repeats the rows for the Hub's page (`tactile_toolkit.exchange.copies`); copies may leave it out."""
MAX_ROWS = 1 << 40
"""Largest number of rows that a shard may state, more than any disk holds."""
_MANY_SHARDS = 8192
_CAUSES_SHOWN = 3
# Numbers have five digits, or more if five are too few; so a shard has one name.
_NUMBER = "([0-9]{5}|[1-9][0-9]{5,11})"
_SHARD_PATTERN = re.compile(rf"(\w+)-{_NUMBER}-of-{_NUMBER}\.parquet")


def decode(content: str | bytes, kind: type[T], address: str) -> T:
    """Return a JSON document as a value of a type; IntegrityError, with ``address``, for another text."""
    try:
        decoded: T = _decoder(cast(Any, kind)).decode(content)
    except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise damaged_error(address, error) from error
    return decoded


@cache
def _decoder(kind: object) -> msgspec.json.Decoder[Any]:
    return msgspec.json.Decoder(kind)


def damaged_error(address: str, problem: object) -> errors.IntegrityError:
    """Return the error for a document with an impossible value."""
    return errors.IntegrityError(
        f"{address!r} is damaged: {problem}",
        next="download the data set again, or generate it again with --overwrite",
    )


def seal(text: str) -> str:
    """Return the text of a JSON object, a line for each field, the first one a digest of the rest."""
    fields = text.removeprefix(_FIRST_LINE)
    return f"{_head(fields.encode())}{fields}"


def _head(fields: bytes) -> str:
    digest = hashlib.sha256(fields.removesuffix(b"\n")).hexdigest()  # editors add or drop the last line break
    return f'{_FIRST_LINE} "sha256_of_all_below": "{digest}",\n'


def require_seal(content: str | bytes, address: str) -> None:
    """Raise IntegrityError, which names ``address``, unless a document is as :func:`seal` returned it."""
    if isinstance(content, str):
        content = content.encode(errors="surrogatepass")
    # Git may have changed line ends on Windows; JSON has no such character within a line.
    document = content.replace(b"\r\n", b"\n")
    length = len(_head(b""))
    if document[:length] != _head(document[length:]).encode():
        raise damaged_error(address, "it was changed since it was written")


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
    split: str, rows: int, *, smallest: int, largest: int, usual_shards: int, together: int = 1
) -> list[tuple[ShardName, range]]:
    """Divide the rows of a split into about ``usual_shards`` shards of ``smallest`` to ``largest`` rows.

    The sizes follow from the split only, so any number of workers agrees on them. A shard is what a worker
    holds in memory and what is lost if it is killed; even a small run has several for each worker. Shards end
    after a multiple of ``together`` rows, if the largest size allows it.
    """
    size = max(smallest, -(-rows // usual_shards))
    size = min(rows_per_shard(rows, largest), -(-size // together) * together)
    starts = range(0, rows, size)
    return [
        (ShardName(split, index, len(starts)), range(start, min(start + size, rows)))
        for index, start in enumerate(starts)
    ]


class Skipped(msgspec.Struct, frozen=True):
    """An item of a source that gave no row: a stable word for counting, and a message without secrets."""

    DAMAGED: ClassVar[str] = "damaged"
    """Reason to leave out an item whose stored data is damaged."""

    id: Annotated[int, msgspec.Meta(ge=-_LARGEST - 1, le=_LARGEST)]
    reason: str
    message: str

    def __post_init__(self) -> None:
        msgspec.structs.force_setattr(self, "message", wording.printable(errors.redact(self.message)))


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
    statistics: JsonObject | None = None
    unpacked_bytes: Count = 0
    source_digest: Sha256 | None = None

    @cached_property
    def shard(self) -> ShardName:
        """Shard of the record; ValueError if the file does not have the name of a shard."""
        folder, _, name = self.file.rpartition("/")
        shard = ShardName.parse(name)
        if shard is None or folder != DATA_FOLDER or shard.index >= shard.count or shard.split != self.split:
            raise ValueError(f"found file {self.file[:80]!r}, expected a shard's name and split")
        return shard

    def is_size_of(self, sizes: Mapping[str, int | None]) -> bool:
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

    def __str__(self) -> str:
        return f"{self.file}: {self.problem}"


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
        raise (errors.IntegrityError if set(first) == {Skipped.DAMAGED} else errors.InputError)(
            f"no row is left: all {len(skipped):,} were left out, nothing was written; the first of each "
            f"reason: {'; '.join(causes[:_CAUSES_SHOWN])}",
            next="correct the source, or choose another one",
        )


@dataclass(frozen=True)
class Manifest:
    """Everything known about a data set folder without opening a shard.

    Equal ``spec`` (JSON values) and ``toolkit_version`` give equal rows. ``shards`` are in order of split and
    index. ``files`` are checksums of further data files, such as reports, by path. ``complete`` is False
    during a run or after it was interrupted; ``planned`` is then the number of shards of each split.
    ``trees`` are the ``extra_dirs`` of the build plan. ``libraries`` are the versions of the libraries that
    decide bytes; empty if a manifest does not state them.
    """

    kind: str
    toolkit_version: str
    spec: JsonObject
    split_order: tuple[str, ...]
    shards: tuple[ShardRecord, ...] = ()
    files: Mapping[str, Sha256] = field(default_factory=dict)
    schema_version: int = SCHEMA_VERSION
    complete: bool = False
    planned: Mapping[str, Count] = field(default_factory=dict)
    trees: tuple[str, ...] = ()
    libraries: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def identity(self) -> str:
        """Digest of all that decides the rows of a data set and their bytes."""
        values = (self.kind, self.toolkit_version, dict(self.libraries), self.spec, self.schema_version)
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()

    @property
    def made_by(self) -> JsonObject:
        """Specification by which the rows were first made, also of a copy; empty if it is not known."""
        return self.spec.get("source_spec", self.spec) or {}

    @property
    def sensor(self) -> str | None:
        """Name of the sensor that the specification states, its own or that of a copied set; or None."""
        options = (self.spec.get("source_spec") or self.spec).get("options")
        if not isinstance(options, dict):
            return None
        settings = options.get("config")  # those of an environment
        stated = options.get("sensor") or (isinstance(settings, dict) and settings.get("sensor_model"))
        if isinstance(stated, str):  # a known name, a JSON file or the folder of a twin
            return PurePath(stated).stem
        name = stated.get("name") if isinstance(stated, dict) else None
        return name if isinstance(name, str) else None

    @property
    def is_copy(self) -> bool:
        """Whether it is that of a copy, which states its source, not how rows are made."""
        return kind.is_copy(self)

    @property
    def is_for_others(self) -> bool:
        """Whether it is that of files for other programs, without rows of its kind."""
        return kind.is_for_others(self)

    @property
    def splits(self) -> tuple[str, ...]:
        """Splits that have shards, in canonical order."""
        present = {record.split for record in self.shards}
        return tuple(split for split in self.split_order if split in present)

    def shards_of(self, split: str) -> tuple[ShardRecord, ...]:
        """Return the records of one split in order of their index."""
        return tuple(record for record in self.shards if record.split == split)

    def shards_planned(self) -> dict[str, int]:
        """Count the shards of each split, finished or not; splits in canonical order."""
        counts = {**self.planned, **{record.split: record.shard.count for record in self.shards}}
        return {split: counts[split] for split in self.split_order if split in counts}

    @property
    def progress(self) -> str:
        """Number of finished shards, such as ``"3 of 8 shards"``."""
        total = sum(self.shards_planned().values())
        return f"{len(self.shards):,} of {wording.with_count(total, 'shards')}"

    def operation(self, address: str) -> str:
        """Return the operation that made a copy, such as ``"merge"``; IntegrityError if none is stated."""
        try:
            return msgspec.convert(self.spec.get("operation"), str)
        except msgspec.ValidationError as error:
            raise damaged_error(address, f"spec.operation: {error}") from error

    def split_table(self) -> dict[str, dict[str, int]]:
        """Rows, shards, bytes and skipped items of each split."""
        table = {}
        for split in self.splits:
            records = self.shards_of(split)
            table[split] = {
                "rows": sum(record.rows for record in records),
                "shards": len(records),
                "bytes": sum(record.bytes for record in records),
                "skipped": sum(len(record.skipped) for record in records),
            }
        return table

    def skipped_reasons(self) -> dict[str, int]:
        """Count skipped items by reason."""
        reasons = Counter(item.reason for record in self.shards for item in record.skipped)
        return dict(sorted(reasons.items()))

    def statistics(self) -> dict[str, JsonObject]:
        """Add up the statistics of the shards of each split; splits without any are left out."""
        counted: dict[str, list[JsonObject]] = {}
        for record in self.shards:
            if record.statistics is not None:
                counted.setdefault(record.split, []).append(record.statistics)
        return {split: add_up(parts) for split, parts in counted.items()}

    def total_statistics(self) -> JsonDict:
        """Add up the statistics of all shards."""
        return add_up(list(self.statistics().values()))

    def with_shards(self, records: Iterable[ShardRecord]) -> Manifest:
        """Return a manifest with these records next to its own, each shard once, in order."""
        merged = {record.shard: record for record in (*self.shards, *records)}
        order = {split: rank for rank, split in enumerate(self.split_order)}
        ordered = sorted(merged.values(), key=lambda record: (order[record.split], record.shard.index))
        return replace(self, shards=tuple(ordered))

    def sums(self) -> dict[str, JsonObject]:
        """Return the sums over shards that the text of the manifest states, by name."""
        return {
            "splits": self.split_table(),
            "skipped": self.skipped_reasons(),
            "statistics": self.statistics(),
        }

    def to_json(self) -> str:
        """Return the text of ``manifest.json``; the same content gives the same text."""
        values = {
            "schema_version": self.schema_version,
            "toolkit_version": self.toolkit_version,
            "libraries": self.libraries,
            "kind": self.kind,
            "complete": self.complete,
            "spec": self.spec,
            "split_order": self.split_order,
            "planned": self.planned,
            **self.sums(),
            "files": dict(sorted(self.files.items())),
            "trees": self.trees,
            "shards": [record.to_dict() for record in self.shards],
        }
        kept = {name: value for name, value in values.items() if value or name not in _OPTIONAL}
        return seal(wording.printable_json(kept, indent=1) + "\n")

    @classmethod
    def so_far(cls, folder: DataFolder) -> Manifest | None:
        """Read the manifest of a folder together with what an unfinished run has finished; None without one.

        Only sizes are compared. A file of that name that another program wrote is not a manifest. Raises
        IntegrityError when the manifest is damaged.
        """
        try:
            manifest = read_manifest(folder)
        except errors.IntegrityError:
            if is_of_others(folder.read_bytes(MANIFEST_FILE)):
                return None
            raise
        if manifest is None:
            return None
        begun = begun_records(folder, manifest)
        return replace(manifest.with_shards(begun), complete=False) if begun else manifest

    @classmethod
    def from_json(cls, content: str | bytes, address: str) -> Manifest:
        """Parse ``manifest.json``; IntegrityError when it is not one, was changed, or has another layout."""
        manifest = decode(content, cls, address)
        if manifest.schema_version != SCHEMA_VERSION:
            raise errors.IntegrityError(
                f"{address!r} has schema version {manifest.schema_version}, expected {SCHEMA_VERSION}",
                next="install the tactile-toolkit that wrote it, or generate the data set again",
            )
        require_seal(content, address)
        try:
            shards = {record.shard for record in manifest.shards}
            manifest.sums()  # of statistics that add up
        except (ValueError, TypeError, AttributeError) as error:
            raise damaged_error(address, f"shards: {error}") from error
        one_of_split = {shard.split: shard for shard in shards}
        if len(shards) < len(manifest.shards) or one_of_split.keys() - {*manifest.split_order}:
            raise damaged_error(address, "shards: one is listed twice, or of no split in 'split_order'")
        # The other shards of a split have other numbers only.
        paths = [shard.data_path for shard in one_of_split.values()]
        names_inside((*paths, *manifest.files, *manifest.trees), repr(address))
        return manifest


def is_of_others(content: bytes) -> bool:
    """Return whether a file of the manifest's name is of another program: JSON with no field of ours.

    A manifest whose bytes were changed still has some of them.
    """
    if any(field in content for field in _FIELDS):
        return False
    with contextlib.suppress(ValueError):
        json.loads(content)
        return True
    return False


def read_manifest(folder: DataFolder) -> Manifest | None:
    """Read the manifest of a folder; None when there is no manifest, IntegrityError when it is damaged."""
    address = folder.address(MANIFEST_FILE)
    if not folder.exists(MANIFEST_FILE):
        return None
    content = folder.read_bytes(MANIFEST_FILE)
    with without_collecting():
        return Manifest.from_json(content, address)


def write_manifest(folder: DataFolder, manifest: Manifest) -> None:
    """Write the manifest of a folder in one step."""
    folder.write_bytes(MANIFEST_FILE, manifest.to_json().encode())


class _Pending(msgspec.Struct):
    """Further fields of the record of a pending shard: its job, and the size of its report rows."""

    of: str
    report_bytes: Count | None = None


def write_shard_record(
    folder: DataFolder, record: ShardRecord, of: str, report_bytes: int | None = None
) -> None:
    """Write the record of a finished shard."""
    values = {**record.to_dict(), "of": of, "report_bytes": report_bytes}
    folder.write_bytes(record.shard.record_path, seal(json.dumps(values, indent=1)).encode())


def pending_shards(waiting: Iterable[str]) -> list[ShardName]:
    """Return the shards that have a pending record, from the names of files."""
    names = (name.removesuffix(".json") for name in waiting if name.endswith(".json"))
    return [shard for shard in (ShardName.parse(f"{name}.parquet") for name in names) if shard is not None]


def pending_records(
    folder: DataFolder, of: str, is_wanted: Callable[[ShardName], bool] = lambda _: True
) -> dict[ShardName, ShardRecord]:
    """Read the pending records of a job, of the shards that are wanted.

    A record whose report rows are missing, or have another size, does not count.
    """
    waiting = folder.sizes(PENDING_FOLDER)
    chosen = list(filter(is_wanted, pending_shards(waiting)))
    if not chosen:
        return {}
    contents = folder.read_many([shard.record_path for shard in chosen])
    records = {}
    for shard, content in zip(chosen, contents, strict=True):
        # If a record cannot be read, its shard is made again. It may also have been removed since the
        # listing, because the run has just ended.
        with contextlib.suppress(errors.IntegrityError, ValueError):
            require_seal(content or b"", shard.record_path)
            pending = decode(content or b"", _Pending, shard.record_path)
            if (pending.of, pending.report_bytes) == (of, waiting.get(shard.report_path.rpartition("/")[2])):
                record = decode(content or b"", ShardRecord, shard.record_path)
                records[record.shard] = record
    return records


def begun_records(folder: DataFolder, manifest: Manifest) -> list[ShardRecord]:
    """Return the pending records that a manifest does not hold and whose files exist."""
    listed = {record.shard for record in manifest.shards}
    pending = pending_records(
        folder,
        manifest.identity,
        lambda shard: shard not in listed and shard.split in manifest.split_order,
    )
    if not pending:
        return []  # the files of a finished set are not listed: there may be 50,000
    sizes = folder.sizes(DATA_FOLDER)
    return [record for record in pending.values() if record.is_size_of(sizes)]


@contextlib.contextmanager
def without_collecting() -> Iterator[None]:
    """Pause garbage collection, a third of the time, while many objects are made that all stay."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
