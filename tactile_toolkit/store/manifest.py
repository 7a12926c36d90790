"""``manifest.json``: what made a data set folder, and what lies in it.

While a run is under way, what it has finished is in pending records instead, one file for each shard, so that
two writers never share a file.
"""

from __future__ import annotations

import contextlib
import gc
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import PurePosixPath
from typing import Any

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.printable import printable_json
from tactile_toolkit.store.fields import json_fields
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.names import names_inside
from tactile_toolkit.store.parts import PARTS_FILE
from tactile_toolkit.store.shards import DATA_FOLDER, PENDING_FOLDER, ShardName, ShardRecord, add_up

__all__ = [
    "MANIFEST_FILE",
    "SCHEMA_VERSION",
    "Manifest",
    "manifest_so_far",
    "pending_beside",
    "pending_records",
    "read_manifest",
    "remove_pending",
    "without_collecting",
    "write_manifest",
    "write_shard_record",
]

MANIFEST_FILE = "manifest.json"
SCHEMA_VERSION = 1
"""Version of the folder's layout and of the manifest; raised when a reader must change."""


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
        """Return a manifest that holds these records beside its own, each shard once, in order."""
        merged = {record.shard: record for record in (*self.shards, *records)}
        order = {split: rank for rank, split in enumerate(self.split_order)}
        ordered = sorted(merged.values(), key=lambda record: (order[record.shard.split], record.shard.index))
        return replace(self, shards=tuple(ordered))

    def to_json(self) -> str:
        """Return the text of ``manifest.json``; the same content gives the same text."""
        statistics = self.statistics()
        values = {
            "schema_version": self.schema_version,
            "toolkit_version": self.toolkit_version,
            **({"libraries": dict(self.libraries)} if self.libraries else {}),
            "kind": self.kind,
            "complete": self.complete,
            "spec": self.spec,
            "split_order": list(self.split_order),
            "splits": self.split_table(),
            "skipped": self.skipped_reasons(),
            **({"statistics": statistics} if statistics else {}),
            "files": dict(sorted((self.files or {}).items())),
            # The word of version 0.1.0, which wrote folders that are read today.
            **({"trees": list(self.extra_dirs)} if self.extra_dirs else {}),
            "shards": [record.to_dict() for record in self.shards],
        }
        return printable_json(values, indent=1) + "\n"

    @classmethod
    def from_json(cls, text: str, where: str) -> Manifest:
        """Parse the text of a manifest; IntegrityError when it is not one, or one of a later layout."""
        fields = json_fields(text, where)
        version = fields.number("schema_version", least=1)
        if version > SCHEMA_VERSION:
            message = (
                f"{where!r} has schema version {version}, this toolkit reads up to {SCHEMA_VERSION}; "
                "next: install a newer tactile-toolkit"
            )
            raise IntegrityError(message)
        files = fields.inside("files")
        libraries = {}
        if fields.has("libraries"):
            named = fields.inside("libraries")
            libraries = {name: named.text(name) for name in named.values}
        manifest = cls(
            kind=fields.text("kind"),
            toolkit_version=fields.text("toolkit_version"),
            spec=fields.mapping("spec"),
            split_order=fields.texts("split_order"),
            shards=ShardRecord.all_from(fields, "shards"),
            files={path: files.digest(path) for path in files.values},
            schema_version=version,
            complete=fields.flag("complete"),
            extra_dirs=fields.texts("trees") if fields.has("trees") else (),
            libraries=libraries,
        )
        shards = {record.shard for record in manifest.shards}
        # Names of shards differ in split and numbers only: the last of each kind stands for all.
        kinds = dict.fromkeys((shard.split, shard.count) for shard in shards)
        paths = (ShardName(split, count - 1, count).data_path for split, count in sorted(kinds))
        names_inside((*paths, *files.values, *manifest.extra_dirs), repr(where))
        if len(shards) < len(manifest.shards) or {shard.split for shard in shards} - {*manifest.split_order}:
            raise fields.wrong(name="shards", problem="one is listed twice, or of no split in 'split_order'")
        try:
            statistics = manifest.statistics()
        except (TypeError, AttributeError) as error:
            problem = f"statistics are not numbers, lists of numbers or objects of them ({error})"
            raise fields.wrong(name="shards", problem=problem) from error
        # What follows from the shards stands there too, so that a number that was changed shows.
        sums = {
            "splits": manifest.split_table(),
            "skipped": manifest.skipped_reasons(),
            "statistics": statistics,
        }
        for name, expected in sums.items():
            if fields.values.get(name, {}) != expected:
                raise fields.wrong(name, "its numbers are not those of the shards")
        return manifest


def read_manifest(folder: DataFolder) -> Manifest | None:
    """Read the manifest of a folder; None when there is no manifest, IntegrityError when it is damaged."""
    if not folder.exists(MANIFEST_FILE):
        return None
    text = folder.read_bytes(MANIFEST_FILE).decode("utf-8", errors="replace")
    with without_collecting():
        return Manifest.from_json(text, folder.address(MANIFEST_FILE))


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


def manifest_so_far(folder: DataFolder) -> Manifest | None:
    """Read the manifest of a folder together with what an unfinished run has finished; None without manifest.

    Raises IntegrityError when the manifest is damaged.
    """
    manifest = read_manifest(folder)
    if manifest is None or (manifest.complete and not folder.exists(PARTS_FILE)):
        return manifest
    return replace(manifest.with_shards(_pending_of(folder, manifest)), complete=False)


def pending_beside(folder: DataFolder, manifest: Manifest) -> tuple[ShardRecord, ...]:
    """Return pending records that a manifest does not hold: those of other splits under way."""
    held = {record.shard for record in manifest.shards}
    return tuple(record for record in _pending_of(folder, manifest) if record.shard not in held)


def _pending_of(folder: DataFolder, manifest: Manifest) -> list[ShardRecord]:
    """Return pending records whose file is there in full size; checksums are not computed."""
    sizes = folder.sizes(DATA_FOLDER)
    return [
        record
        for record in pending_records(folder)
        if record.shard.split in manifest.split_order and record.is_size_of(sizes)
    ]


def pending_records(folder: DataFolder, shards: Iterable[ShardName] | None = None) -> list[ShardRecord]:
    """Read the records of shards, or of these, that are finished and not yet in the manifest."""
    there = folder.names(PENDING_FOLDER)
    if shards is not None:
        asked_for = {PurePosixPath(shard.record_path).name for shard in shards}
        there = [name for name in there if name in asked_for]
    # Names with a dot in front are records that a writer has not finished, or never will.
    paths = [
        f"{PENDING_FOLDER}/{name}" for name in there if name.endswith(".json") and not name.startswith(".")
    ]
    records = []
    for path, content in zip(paths, folder.read_many(paths), strict=True):
        # One that cannot be read vouches for nothing: its shard is made again. It may also have gone since it
        # was listed, because the run has just ended.
        with contextlib.suppress(IntegrityError):
            if content is not None and path != PARTS_FILE:
                records.append(ShardRecord.from_fields(json_fields(content, path)))
    return records


def write_shard_record(folder: DataFolder, record: ShardRecord) -> None:
    """Write the pending record of a finished shard."""
    folder.write_bytes(record.shard.record_path, json.dumps(record.to_dict(), indent=1).encode())


def remove_pending(folder: DataFolder, keep: Iterable[ShardRecord] = (), *, keep_plan: bool = False) -> None:
    """Remove records and report rows of a run, once the manifest holds them; some may be needed still."""
    kept = {path for record in keep for path in (record.shard.record_path, record.shard.report_path)}
    if keep_plan:
        kept.add(PARTS_FILE)
    else:
        folder.remove(PARTS_FILE)  # first: a part that is at work still sees that it need not go on
    for path in (f"{PENDING_FOLDER}/{name}" for name in folder.names(PENDING_FOLDER)):
        if path not in kept:
            folder.remove(path)
    folder.remove_empty(PENDING_FOLDER)
