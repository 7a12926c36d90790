"""``manifest.json``: what made a data set folder, and what is in it.

During a run, finished shards have pending records instead, one file each, so that two writers never share a
file (:mod:`tactile_toolkit.store.pending`).
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.json_types import JsonObject
from tactile_toolkit.shown_text import printable_json
from tactile_toolkit.store.files import names_inside
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.sealed_json import Count, Sha256, damaged_error, decode, require_seal, seal
from tactile_toolkit.store.shards import ShardRecord, add_up
from tactile_toolkit.wording import with_count

MANIFEST_FILE = "manifest.json"
SCHEMA_VERSION = 3
"""The only version that is written and read."""
# Fields that manifests have and files of that name of other programs lack.
_FIELDS = (b'"sha256_of_all_below"', b'"schema_version"', b'"shards"')
# Fields that are left out of the text if they are empty.
_OPTIONAL = ("libraries", "planned", "statistics", "trees")


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

    @property
    def identity(self) -> str:
        """Digest of all that decides the rows of a data set and their bytes."""
        values = (self.kind, self.toolkit_version, dict(self.libraries), self.spec, self.schema_version)
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()

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
        planned = sum(self.shards_planned().values())
        return f"{len(self.shards):,} of {with_count(planned, 'shards')}"

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
        return seal(printable_json(kept, indent=1) + "\n")

    @classmethod
    def from_json(cls, content: str | bytes, where: str) -> Manifest:
        """Parse ``manifest.json``; IntegrityError when it is not one, was changed, or has another layout."""
        manifest = decode(content, cls, where)
        if manifest.schema_version != SCHEMA_VERSION:
            raise IntegrityError(
                f"{where!r} has schema version {manifest.schema_version}, expected {SCHEMA_VERSION}",
                next="install the tactile-toolkit that wrote it, or generate the data set again",
            )
        require_seal(content, where)
        try:
            shards = {record.shard for record in manifest.shards}
            manifest.sums()  # of statistics that add up
        except (ValueError, TypeError, AttributeError) as error:
            raise damaged_error(where, f"shards: {error}") from error
        names_inside(
            (
                *{each.split: each.file for each in manifest.shards}.values(),
                *manifest.files,
                *manifest.trees,
            ),
            repr(where),
        )
        splits = {shard.split for shard in shards}
        if len(shards) < len(manifest.shards) or splits - {*manifest.split_order}:
            raise damaged_error(where, "shards: one is listed twice, or of no split in 'split_order'")
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
    if not folder.exists(MANIFEST_FILE):
        return None
    content = folder.read_bytes(MANIFEST_FILE)
    with without_collecting():
        return Manifest.from_json(content, folder.address(MANIFEST_FILE))


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


def write_manifest(folder: DataFolder, manifest: Manifest) -> None:
    """Write the manifest of a folder in one step."""
    folder.write_bytes(MANIFEST_FILE, manifest.to_json().encode())
