"""Records of finished shards that no manifest holds yet, one file each in ``.pending``."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Collection, Iterable
from dataclasses import replace

import msgspec

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.store.folder import PENDING_FOLDER, TEMPORARY, DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, is_of_others, read_manifest
from tactile_toolkit.store.sealed_json import Count, decode, require_seal, seal
from tactile_toolkit.store.shards import DATA_FOLDER, ShardName, ShardRecord

_SHARD = r"\w+-[0-9]{5,12}-of-[0-9]{5,12}"

is_pending = re.compile(
    rf"{PENDING_FOLDER}/(?:{TEMPORARY}|{_SHARD}[.]json|report-{_SHARD}[.]parquet)"
).fullmatch
"""Matches the path of a record, of report rows or of a temporary file of a run."""


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
    folder: DataFolder, of: str, shards: Collection[ShardName] | None = None
) -> dict[ShardName, ShardRecord]:
    """Read the pending records of a job: of all shards, or of these.

    A record whose report rows are missing, or have another size, does not count.
    """
    waiting = folder.sizes(PENDING_FOLDER)
    chosen = [shard for shard in pending_shards(waiting) if shards is None or shard in shards]
    contents = folder.read_many([shard.record_path for shard in chosen])
    found = {}
    for shard, content in zip(chosen, contents, strict=True):
        # If a record cannot be read, its shard is made again. It may also have been removed since the
        # listing, because the run has just ended.
        with contextlib.suppress(IntegrityError, ValueError):
            require_seal(content or b"", shard.record_path)
            pending = decode(content or b"", _Pending, shard.record_path)
            if (pending.of, pending.report_bytes) == (of, waiting.get(shard.report_path.rpartition("/")[2])):
                record = decode(content or b"", ShardRecord, shard.record_path)
                found[record.shard] = record
    return found


def manifest_so_far(folder: DataFolder) -> Manifest | None:
    """Read the manifest of a folder together with what an unfinished run has finished; None without one.

    Only sizes are compared. A file of that name that another program wrote is not a manifest. Raises
    IntegrityError when the manifest is damaged.
    """
    try:
        manifest = read_manifest(folder)
    except IntegrityError:
        if is_of_others(folder.read_bytes(MANIFEST_FILE)):
            return None
        raise
    if manifest is None:
        return None
    begun = _begun_records(folder, manifest)
    if begun:
        return replace(manifest.with_shards(begun), complete=False)
    return manifest


def _begun_records(folder: DataFolder, manifest: Manifest) -> list[ShardRecord]:
    """Return the pending records that a manifest does not hold and whose files exist."""
    pending = pending_records(folder, manifest.identity)
    if not pending:
        return []  # the files of a finished set are not listed: there may be 50,000
    listed, sizes = {record.shard for record in manifest.shards}, folder.sizes(DATA_FOLDER)
    return [
        record
        for shard, record in pending.items()
        if shard not in listed and shard.split in manifest.split_order and record.is_size_of(sizes)
    ]


def remove_leftovers(folder: DataFolder, manifest: Manifest) -> None:
    """Remove what a finished set does not need: its pending records and temporary files.

    Records of another split stay until that is finished.
    """
    shards = [record.shard for record in _begun_records(folder, manifest)]
    kept = {path for shard in shards for path in (shard.record_path, shard.report_path)}
    remove_pending(folder, kept)


def remove_pending(folder: DataFolder, kept: Collection[str] = ()) -> None:
    """Remove all pending records, report rows and temporary files but those to be kept."""
    folder.remove_temporaries()
    for path in (f"{PENDING_FOLDER}/{name}" for name in folder.names(PENDING_FOLDER)):
        if is_pending(path) and path not in kept:
            folder.remove(path)
    folder.remove_empty(PENDING_FOLDER)
