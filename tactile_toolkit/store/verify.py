"""Proving that a data set folder is what its manifest says, or what the Hub said that it was fetched from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactile_toolkit.cards.checks import check_card
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.digest import HubFile
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest
from tactile_toolkit.store.origin import RECORD_FILE, DownloadRecord, read_record
from tactile_toolkit.store.shards import DATA_FOLDER, Finding, Receipt, file_sha256

__all__ = ["Finding", "Verification", "verify"]


@dataclass(frozen=True, slots=True)
class Verification:
    """Result of :func:`verify`: an empty ``findings`` means that everything matches.

    Attributes
    ----------
    files, rows, bytes : int
        How much was checked.
    findings : tuple of Finding
        All that is wrong.
    witness : str
        What the folder was held against: its manifest, or a commit of the Hub.
    """

    files: int
    rows: int
    bytes: int
    findings: tuple[Finding, ...]
    witness: str = MANIFEST_FILE

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings


def verify(
    folder: DataFolder,
    schema: Any = None,
    on_file: Callable[[str], None] = lambda _: None,
    *,
    card: bool = False,
) -> Verification:
    """Check every checksum, row count, schema and the uniqueness of ids over all splits.

    A folder without a manifest that was downloaded, such as a copy of a published data set, is held against
    the sizes and checksums that the Hub gave for its files.

    Parameters
    ----------
    folder : DataFolder
        Folder of a finished data set.
    schema : pyarrow.Schema, optional
        Schema that every shard must have; not asked of copies of other people's data sets.
    on_file : callable
        Told each file before it is read.
    card : bool
        Compare the data card with the data too.

    Raises
    ------
    InputError
        When the folder holds no manifest and was not downloaded.
    IntegrityError
        When the manifest, or the record of the download, is itself damaged.
    """
    manifest = read_manifest(folder)
    if manifest is None:
        return _verify_copy(folder, _record_of(folder), on_file)
    findings = [*_unfinished(manifest), *_strangers(folder, manifest)]
    seen: dict[object, str] = {}
    for receipt in manifest.receipts:
        on_file(receipt.shard.data_path)
        findings += _check_shard(folder, receipt, schema, seen)
    for path, checksum in (manifest.files or {}).items():
        on_file(path)
        findings += _check_file(folder, path, checksum)
    if card and not findings:  # what is damaged is named already, and cannot be compared with
        findings += check_card(folder)
    rows = sum(receipt.rows for receipt in manifest.receipts)
    size = sum(receipt.bytes for receipt in manifest.receipts)
    return Verification(len(manifest.receipts) + len(manifest.files or {}), rows, size, tuple(findings))


def _record_of(folder: DataFolder) -> DownloadRecord:
    record = read_record(folder)
    if record is None:
        message = (
            f"no {MANIFEST_FILE} in {folder.address()!r}, and no `download` filled it, so that nothing says "
            "what its files should be; next: give the folder of a generated or downloaded data set"
        )
        raise InputError(message)
    return record


def _verify_copy(folder: DataFolder, record: DownloadRecord, on_file: Callable[[str], None]) -> Verification:
    findings: list[Finding] = []
    rows = 0
    for path, file in record.files.items():
        on_file(path)
        damage = _check_copied(folder, file)
        findings += damage
        if not damage and path.endswith(".parquet"):
            # Ids are the publisher's own: nothing says that they differ between splits.
            rows += len(Shard(folder.address(path)))
    findings += [
        Finding(f"{DATA_FOLDER}/{name}", f"is not listed in {RECORD_FILE}")
        for name in folder.names(DATA_FOLDER)
        if f"{DATA_FOLDER}/{name}" not in record.files
    ]
    size = sum(file.size_bytes for file in record.files.values())
    witness = f"{record.repo_id} at {record.commit[:12]}"
    return Verification(len(record.files), rows, size, tuple(findings), witness)


def _check_copied(folder: DataFolder, file: HubFile) -> list[Finding]:
    if not folder.exists(file.path):
        return [Finding(file.path, "is missing")]
    if file.digest is None:
        return []
    found = file.digest.of(Path(folder.address(file.path)))
    return [] if found == file.digest else [Finding(file.path, f"{found}, expected {file.digest.value}")]


def _unfinished(manifest: Manifest) -> list[Finding]:
    findings = []
    if not manifest.complete:
        findings.append(Finding(MANIFEST_FILE, "the run was interrupted; the same command goes on"))
    for split in manifest.splits:
        receipts = manifest.receipts_of(split)
        missing = set(range(receipts[0].shard.count)) - {receipt.shard.index for receipt in receipts}
        if missing and manifest.complete:
            findings.append(Finding(MANIFEST_FILE, f"split {split!r} lacks shards {sorted(missing)}"))
    return findings


def _strangers(folder: DataFolder, manifest: Manifest) -> list[Finding]:
    known = {receipt.shard.data_path for receipt in manifest.receipts}
    there = [f"{DATA_FOLDER}/{name}" for name in folder.names(DATA_FOLDER)]
    if not manifest.complete:
        return []
    return [Finding(path, f"is not listed in {MANIFEST_FILE}") for path in there if path not in known]


def _check_file(folder: DataFolder, path: str, checksum: str) -> list[Finding]:
    if not folder.exists(path):
        return [Finding(path, "is missing")]
    found = file_sha256(folder, path)
    return [] if found == checksum else [Finding(path, f"sha256 is {found}, expected {checksum}")]


def _check_shard(folder: DataFolder, receipt: Receipt, schema: Any, seen: dict[object, str]) -> list[Finding]:
    path = receipt.shard.data_path
    findings = _check_file(folder, path, receipt.sha256)
    if findings:
        return findings
    try:
        shard = Shard(folder.address(path))
        return [
            *_check_rows(shard, receipt, path),
            *_check_schema(shard, schema, path),
            *_check_ids(shard, path, seen),
        ]
    except IntegrityError as error:
        return [Finding(path, str(error))]


def _check_rows(shard: Shard, receipt: Receipt, path: str) -> list[Finding]:
    found = len(shard)
    return [] if found == receipt.rows else [Finding(path, f"has {found} rows, expected {receipt.rows}")]


def _check_schema(shard: Shard, schema: Any, path: str) -> list[Finding]:
    if schema is None or shard.schema.equals(schema):
        return []
    found, expected = set(map(str, shard.schema)), set(map(str, schema))
    return [
        Finding(
            path, f"schema differs: {sorted(found - expected)} there, {sorted(expected - found)} expected"
        )
    ]


def _check_ids(shard: Shard, path: str, seen: dict[object, str]) -> list[Finding]:
    ids = shard.read(columns=["id"]).column(0).to_pylist()
    repeated = [item for item, count in Counter(ids).items() if count > 1 or item in seen]
    first = seen.get(repeated[0], path) if repeated else path
    seen.update(dict.fromkeys(ids, path))
    if not repeated:
        return []
    return [
        Finding(
            path, f"id {repeated[0]!r} is not unique, it also stands in {first} ({len(repeated)} such ids)"
        )
    ]
