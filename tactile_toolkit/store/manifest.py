"""``manifest.json``: what made a data set folder, and what lies in it.

While a run is under way, what it has finished is in pending records instead, one file for each shard, so that
two writers never share a file (:mod:`tactile_toolkit.store.job`).
"""

from __future__ import annotations

import contextlib
import dataclasses
import gc
import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import msgspec

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.names import names_inside
from tactile_toolkit.store.shards import ShardEntry, ShardName, ShardRecord, add_up
from tactile_toolkit.store.typed_json import Sha256, damaged, decode
from tactile_toolkit.wording import printable_json

MANIFEST_FILE = "manifest.json"
SCHEMA_VERSION = 1
"""Version of the folder's layout and of the manifest; raised when a reader must change."""
_OPTIONAL = ("libraries", "statistics", "trees")
"""What the text of a manifest leaves out where there is none."""


@dataclass(frozen=True)
class Manifest:
    """Everything known about a data set folder without opening a shard.

    Equal ``spec`` (JSON values) and ``toolkit_version`` give equal rows. ``shards`` are in order of split and
    index. ``files`` are checksums of further data files, such as reports, by path. ``complete`` is False
    while a run is under way or after it was interrupted. ``extra_dirs`` are those of the build plan.
    ``libraries`` are the versions of the libraries that decide bytes, none where a manifest does not say.
    """

    kind: str
    toolkit_version: str
    spec: Mapping[str, Any]
    split_order: tuple[str, ...]
    shards: tuple[ShardRecord, ...] = ()
    files: Mapping[str, str] | None = None
    schema_version: int = SCHEMA_VERSION
    complete: bool = False
    extra_dirs: tuple[str, ...] = ()
    libraries: Mapping[str, str] = field(default_factory=dict)

    @property
    def identity(self) -> str:
        """Digest of all that decides the rows of a data set and their bytes."""
        values = (self.kind, self.toolkit_version, dict(self.libraries), self.spec)
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()

    @property
    def splits(self) -> tuple[str, ...]:
        """Splits that have shards, in canonical order."""
        present = {record.shard.split for record in self.shards}
        return tuple(split for split in self.split_order if split in present)

    def shards_of(self, split: str) -> tuple[ShardRecord, ...]:
        """Return the records of one split in order of their index."""
        return tuple(record for record in self.shards if record.shard.split == split)

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

    def statistics(self) -> dict[str, dict[str, Any]]:
        """Add up the statistics of each split's shards; splits without any are left out."""
        counted: dict[str, list[Mapping[str, Any]]] = {}
        for record in self.shards:
            if record.statistics is not None:
                counted.setdefault(record.shard.split, []).append(record.statistics)
        return {split: add_up(parts) for split, parts in counted.items()}

    def with_shards(self, records: Iterable[ShardRecord]) -> Manifest:
        """Return a manifest that holds these records next to its own, each shard once, in order."""
        merged = {record.shard: record for record in (*self.shards, *records)}
        order = {split: rank for rank, split in enumerate(self.split_order)}
        ordered = sorted(merged.values(), key=lambda record: (order[record.shard.split], record.shard.index))
        return replace(self, shards=tuple(ordered))

    def sums(self) -> dict[str, dict[str, Any]]:
        """Return what the text of the manifest repeats of the shards, by the name that it has there."""
        return {
            "splits": self.split_table(),
            "skipped": self.skipped_reasons(),
            "statistics": self.statistics(),
        }

    def to_json(self) -> str:
        """Return the text of ``manifest.json``; the same content gives the same text."""
        values = {
            **vars(self),
            **self.sums(),
            "files": dict(sorted((self.files or {}).items())),
            "trees": self.extra_dirs,
            "shards": [record.to_dict() for record in self.shards],
        }
        names = [name for name in _Document.__struct_encode_fields__ if values[name] or name not in _OPTIONAL]
        return printable_json({name: values[name] for name in names}, indent=1) + "\n"

    @classmethod
    def from_json(cls, content: str | bytes, where: str) -> Manifest:
        """Parse ``manifest.json``; IntegrityError when it is not one, or one of a later layout."""
        document = decode(content, _Document, where)
        if document.schema_version > SCHEMA_VERSION:
            raise IntegrityError(
                f"{where!r} has schema version {document.schema_version}, this toolkit reads up to "
                f"{SCHEMA_VERSION}",
                next="install a newer tactile-toolkit",
            )
        try:
            records = tuple([entry.record() for entry in document.shards])
        except ValueError as error:
            raise damaged(where, "shards.file", str(error)) from error
        fields = (each.name for each in dataclasses.fields(cls))
        manifest = cls(**{name: getattr(document, name) for name in fields} | {"shards": records})
        shards = {record.shard for record in records}
        # Names of shards differ in split and numbers only: the last of each kind stands for all.
        kinds = dict.fromkeys((shard.split, shard.count) for shard in shards)
        paths = (ShardName(split, count - 1, count).data_path for split, count in sorted(kinds))
        names_inside((*paths, *document.files, *document.extra_dirs), repr(where))
        if len(shards) < len(records) or {split for split, _ in kinds} - {*manifest.split_order}:
            raise damaged(where, "shards", "one is listed twice, or of no split in 'split_order'")
        try:
            sums = manifest.sums()
        except (TypeError, AttributeError) as error:
            problem = f"statistics are not numbers, lists of numbers or objects of them ({error})"
            raise damaged(where, "shards", problem) from error
        # What follows from the shards stands there too, so that a number that was changed shows.
        for name, expected in sums.items():
            if getattr(document, name) != expected:
                raise damaged(where, name, "its numbers are not those of the shards")
        return manifest


class _Document(msgspec.Struct, kw_only=True, rename={"extra_dirs": "trees"}):
    """The form of :meth:`Manifest.to_json` that is believed."""

    schema_version: Annotated[int, msgspec.Meta(ge=1)]
    toolkit_version: str
    libraries: dict[str, str] = {}
    kind: str
    complete: bool
    spec: dict[str, Any]
    split_order: tuple[str, ...]
    splits: dict[str, dict[str, int]] = {}
    skipped: dict[str, int] = {}
    statistics: dict[str, dict[str, Any]] = {}
    files: dict[str, Sha256]
    # The word of version 0.1.0, which wrote folders that are read today.
    extra_dirs: tuple[str, ...] = ()
    shards: list[ShardEntry]


def read_manifest(folder: DataFolder) -> Manifest | None:
    """Read the manifest of a folder; None when there is no manifest, IntegrityError when it is damaged."""
    if not folder.exists(MANIFEST_FILE):
        return None
    content = folder.read_bytes(MANIFEST_FILE)
    with without_collecting():
        return Manifest.from_json(content, folder.address(MANIFEST_FILE))


@contextlib.contextmanager
def without_collecting() -> Iterator[None]:
    """Make many objects at once, all to be kept; looking for garbage among them takes a third of the time."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def write_manifest(folder: DataFolder, manifest: Manifest) -> None:
    """Write the manifest of a folder in one step."""
    folder.write_bytes(MANIFEST_FILE, manifest.to_json().encode())
