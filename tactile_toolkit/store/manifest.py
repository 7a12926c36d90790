"""``manifest.json``: what made a data set folder, and what lies in it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.shards import PARTS_FOLDER, Receipt, add_up

__all__ = [
    "MANIFEST_FILE",
    "Manifest",
    "SCHEMA_VERSION",
    "manifest_so_far",
    "part_receipts",
    "parts_beside",
    "read_manifest",
    "remove_parts",
    "write_manifest",
    "write_receipt",
]

MANIFEST_FILE = "manifest.json"
SCHEMA_VERSION = 1
"""Version of the folder's layout and of the manifest; raised when a reader must change."""


@dataclass(frozen=True)
class Manifest:
    """Everything known about a data set folder without opening a shard.

    Attributes
    ----------
    kind : str
        Which room made it, such as ``"mnist3d"``.
    toolkit_version : str
        Version of the toolkit that wrote the rows.
    spec : dict
        The full specification, as JSON values; equal specifications give equal rows.
    split_order : tuple of str
        Canonical order of the splits of this kind.
    receipts : tuple of Receipt
        One per shard, in order of split and index.
    files : dict of str to str
        SHA-256 of further data files, such as reports, by path.
    schema_version : int
        See :data:`SCHEMA_VERSION`.
    complete : bool
        False while a run is under way or after it was interrupted.
    trees : tuple of str
        Sub-folders and files beside the rows that belong to the data set; see
        :class:`tactile_toolkit.store.plan.BuildPlan`.
    """

    kind: str
    toolkit_version: str
    spec: Mapping[str, Any]
    split_order: tuple[str, ...]
    receipts: tuple[Receipt, ...] = ()
    files: Mapping[str, str] | None = None
    schema_version: int = SCHEMA_VERSION
    complete: bool = False
    trees: tuple[str, ...] = ()

    @property
    def splits(self) -> tuple[str, ...]:
        """Splits that have shards, in canonical order."""
        present = {receipt.shard.split for receipt in self.receipts}
        return tuple(split for split in self.split_order if split in present)

    def receipts_of(self, split: str) -> tuple[Receipt, ...]:
        """Receipts of one split in order of their index."""
        return tuple(receipt for receipt in self.receipts if receipt.shard.split == split)

    def split_table(self) -> dict[str, dict[str, int]]:
        """Rows, shards, bytes and skipped items of each split."""
        table = {}
        for split in self.splits:
            receipts = self.receipts_of(split)
            table[split] = {
                "rows": sum(receipt.rows for receipt in receipts),
                "shards": len(receipts),
                "bytes": sum(receipt.bytes for receipt in receipts),
                "skipped": sum(len(receipt.skipped) for receipt in receipts),
            }
        return table

    def skipped_reasons(self) -> dict[str, int]:
        """Count skipped items by reason."""
        reasons = Counter(item.reason for receipt in self.receipts for item in receipt.skipped)
        return dict(sorted(reasons.items()))

    def statistics(self) -> dict[str, dict[str, Any]]:
        """Add up the statistics of each split's shards; splits without any are left out."""
        counted: dict[str, list[Mapping[str, Any]]] = {}
        for receipt in self.receipts:
            if receipt.statistics is not None:
                counted.setdefault(receipt.shard.split, []).append(receipt.statistics)
        return {split: add_up(parts) for split, parts in counted.items()}

    def with_receipts(self, receipts: Iterable[Receipt]) -> Manifest:
        """Return a manifest that holds these receipts beside its own, each shard once, in order."""
        merged = {receipt.shard: receipt for receipt in (*self.receipts, *receipts)}
        order = {split: rank for rank, split in enumerate(self.split_order)}
        ordered = sorted(
            merged.values(), key=lambda receipt: (order[receipt.shard.split], receipt.shard.index)
        )
        return replace(self, receipts=tuple(ordered))

    def to_json(self) -> str:
        """Return the text of ``manifest.json``; the same content gives the same text."""
        statistics = self.statistics()
        values = {
            "schema_version": self.schema_version,
            "toolkit_version": self.toolkit_version,
            "kind": self.kind,
            "complete": self.complete,
            "spec": self.spec,
            "split_order": list(self.split_order),
            "splits": self.split_table(),
            "skipped": self.skipped_reasons(),
            **({"statistics": statistics} if statistics else {}),
            "files": dict(sorted((self.files or {}).items())),
            **({"trees": list(self.trees)} if self.trees else {}),
            "shards": [receipt.to_dict() for receipt in self.receipts],
        }
        return json.dumps(values, indent=1, ensure_ascii=False) + "\n"

    @classmethod
    def from_json(cls, text: str, where: str) -> Manifest:
        """Parse the text of a manifest.

        Raises
        ------
        IntegrityError
            When the text is not a manifest, or one of a later layout.
        """
        try:
            values = json.loads(text)
            version = values["schema_version"]
            manifest = cls(
                kind=values["kind"],
                toolkit_version=values["toolkit_version"],
                spec=values["spec"],
                split_order=tuple(values["split_order"]),
                receipts=tuple(Receipt.from_dict(entry) for entry in values["shards"]),
                files=values["files"],
                schema_version=version,
                complete=values["complete"],
                trees=tuple(map(str, values.get("trees", ()))),
            )
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            message = f"{where!r} is not a manifest of this toolkit ({type(error).__name__}: {error})"
            raise IntegrityError(message) from error
        if version > SCHEMA_VERSION:
            message = (
                f"{where!r} has schema version {version}, this toolkit reads up to {SCHEMA_VERSION}; "
                "next: install a newer tactile-toolkit"
            )
            raise IntegrityError(message)
        return manifest


def read_manifest(folder: DataFolder) -> Manifest | None:
    """Read the manifest of a folder; None when it has none.

    Raises
    ------
    IntegrityError
        When the manifest is damaged.
    """
    if not folder.exists(MANIFEST_FILE):
        return None
    text = folder.read_bytes(MANIFEST_FILE).decode("utf-8", errors="replace")
    return Manifest.from_json(text, folder.address(MANIFEST_FILE))


def write_manifest(folder: DataFolder, manifest: Manifest) -> None:
    """Write the manifest of a folder in one step."""
    folder.write_bytes(MANIFEST_FILE, manifest.to_json().encode())


def manifest_so_far(folder: DataFolder) -> Manifest | None:
    """Read the manifest of a folder together with what an unfinished run has finished; None without manifest.

    Shards count whose receipt is whole and whose file is there in full size; checksums are not computed.

    Raises
    ------
    IntegrityError
        When the manifest is damaged.
    """
    manifest = read_manifest(folder)
    if manifest is None or manifest.complete:
        return manifest
    return manifest.with_receipts(_parts_of(folder, manifest))


def part_receipts(folder: DataFolder) -> list[Receipt]:
    """Read the receipts of shards that are finished and not yet in the manifest; damaged ones are none."""
    # Names with a dot in front are receipts that a writer has not finished, or never will.
    names = [n for n in folder.names(PARTS_FOLDER) if n.endswith(".json") and not n.startswith(".")]
    found = (_read_receipt(folder, f"{PARTS_FOLDER}/{name}") for name in names)
    return [receipt for receipt in found if receipt is not None]


def write_receipt(folder: DataFolder, receipt: Receipt) -> None:
    """Write the receipt of a finished shard.

    Raises
    ------
    StorageError
        When the folder cannot be written.
    """
    folder.write_bytes(receipt.shard.receipt_path, json.dumps(receipt.to_dict(), indent=1).encode())


def parts_beside(folder: DataFolder, manifest: Manifest) -> tuple[Receipt, ...]:
    """Return receipts of finished shards that a manifest does not hold: those of other splits under way."""
    held = {receipt.shard for receipt in manifest.receipts}
    return tuple(part for part in _parts_of(folder, manifest) if part.shard not in held)


def remove_parts(folder: DataFolder, keep: Iterable[Receipt] = ()) -> None:
    """Remove receipts and report rows of a run, once the manifest holds them; some may be needed still."""
    kept = {path for receipt in keep for path in (receipt.shard.receipt_path, receipt.shard.report_path)}
    for path in (f"{PARTS_FOLDER}/{name}" for name in folder.names(PARTS_FOLDER)):
        if path not in kept:
            folder.remove(path)
    folder.remove_empty(PARTS_FOLDER)


def _parts_of(folder: DataFolder, manifest: Manifest) -> list[Receipt]:
    known = [entry for entry in part_receipts(folder) if entry.shard.split in manifest.split_order]
    return [entry for entry in known if _has_file(folder, entry)]


def _read_receipt(folder: DataFolder, path: str) -> Receipt | None:
    # One that cannot be read vouches for nothing: its shard is made again. It may also have gone since it was
    # listed, because the run has just ended.
    try:
        return Receipt.from_dict(json.loads(folder.read_bytes(path)))
    except (IntegrityError, ValueError):
        return None


def _has_file(folder: DataFolder, receipt: Receipt) -> bool:
    path = receipt.shard.data_path
    return folder.exists(path) and folder.size_bytes(path) == receipt.bytes
