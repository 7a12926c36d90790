"""``manifest.json``: what made a data set folder, and what lies in it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from dataset_store.errors import IntegrityError
from dataset_store.shards import Receipt
from dataset_store.statistics import add_up
from dataset_store.storage import DataFolder

__all__ = ["MANIFEST_FILE", "SCHEMA_VERSION", "Manifest", "read_manifest", "write_manifest"]

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
        :class:`dataset_store.plan.BuildPlan`.
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
