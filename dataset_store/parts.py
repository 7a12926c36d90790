"""Receipts of a run under way: what is finished before the manifest says so."""

from __future__ import annotations

import json
from collections.abc import Iterable

from dataset_store.errors import IntegrityError
from dataset_store.manifest import Manifest, read_manifest
from dataset_store.shards import PARTS_FOLDER, Receipt
from dataset_store.storage import DataFolder

__all__ = ["manifest_so_far", "part_receipts", "parts_beside", "remove_parts", "write_receipt"]


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
