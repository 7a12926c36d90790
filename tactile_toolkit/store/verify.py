"""Proving that a data set folder is what its manifest says, or what the Hub said that it was fetched from."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest
from tactile_toolkit.store.origin import RECORD_FILE, DownloadRecord, read_record
from tactile_toolkit.store.parquet import file_sha256, named_damage, open_parquet
from tactile_toolkit.store.shards import DATA_FOLDER, Finding, ShardRecord

__all__ = ["Finding", "Verification", "problem_of_place", "verify"]


@dataclass(frozen=True, slots=True)
class Verification:
    """How much was checked, and all that is wrong; ``reference`` is what the folder was compared with.

    The reference is the manifest, or a commit of the Hub.
    """

    files: int
    rows: int
    bytes: int
    findings: tuple[Finding, ...]
    reference: str = MANIFEST_FILE

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings


def verify(
    folder: DataFolder,
    schema: Any = None,
    on_file: Callable[[str], None] = lambda _: None,
    *,
    check_card: Callable[[DataFolder], Iterable[Finding]] | None = None,
) -> Verification:
    """Check every checksum, row count, schema and the uniqueness of ids over all splits.

    A folder without a manifest that was downloaded, such as a copy of a published data set, is compared with
    the sizes and checksums that the Hub gave for its files.

    Parameters
    ----------
    folder : DataFolder
        Folder of a finished data set.
    schema : pyarrow.Schema, optional
        Schema that every shard must have; not asked of copies of other people's data sets.
    on_file : callable
        Called with each path before it is read.
    check_card : callable, optional
        Compares the data card with the data, such as :func:`tactile_toolkit.cards.checks.check_card`.

    Raises
    ------
    InputError
        When the folder holds no manifest and was not downloaded.
    IntegrityError
        When the manifest, or the record of the download, is itself damaged.
    """
    manifest = read_manifest(folder)
    if manifest is None:
        record = read_record(folder)
        if record is None:
            message = (
                f"{folder.lacks(f'{MANIFEST_FILE} and no record of a download')}; next: give the folder of a "
                "generated or downloaded data set, whose files can be compared with what those say"
            )
            raise InputError(message)
        return _verify_copy(folder, record, on_file)
    findings = _incomplete(folder, manifest)
    first_files: dict[object, str] = {}
    for shard in manifest.shards:
        on_file(shard.shard.data_path)
        findings += _check_shard(folder, shard, schema, first_files)
    files = manifest.files or {}
    for path, checksum in files.items():
        on_file(path)
        findings += _check_file(folder, path, checksum)
    if check_card is not None and not findings:  # what is damaged is named, and cannot be compared with
        findings += check_card(folder)
    rows = sum(shard.rows for shard in manifest.shards)
    size = sum(shard.bytes for shard in manifest.shards)
    return Verification(len(manifest.shards) + len(files), rows, size, tuple(findings))


def _verify_copy(folder: DataFolder, record: DownloadRecord, on_file: Callable[[str], None]) -> Verification:
    findings: list[Finding] = []
    rows = 0
    for path, file in record.files.items():
        on_file(path)
        problem = problem_of_place(folder, path)
        if problem:
            findings.append(Finding(path, problem))
            continue
        found = None if file.digest is None else file.digest.of(Path(folder.address(path)))
        if file.digest is not None and found != file.digest:
            findings.append(Finding(path, f"{found}, expected {file.digest.value}"))
        elif folder.size_bytes(path) != file.size_bytes:  # all that is known of one without a digest
            problem = f"has {folder.size_bytes(path):,} bytes, expected {file.size_bytes:,}"
            findings.append(Finding(path, problem))
        elif path.endswith(".parquet"):
            # Ids are the publisher's own: nothing says that they differ between splits.
            rows += open_parquet(folder, path).metadata.num_rows
    findings += [
        Finding(f"{DATA_FOLDER}/{name}", f"is not listed in {RECORD_FILE}; next: remove it")
        for name in folder.names(DATA_FOLDER)
        if f"{DATA_FOLDER}/{name}" not in record.files and not name.startswith(".")
    ]
    size = sum(file.size_bytes for file in record.files.values())
    reference = f"{record.repo_id} at {record.commit[:12]}"
    return Verification(len(record.files), rows, size, tuple(findings), reference)


def problem_of_place(folder: DataFolder, path: str) -> str:
    """Say why a path of a folder is not one of its own files; empty where it is one.

    A link may lead to another file of the folder, and from a snapshot of the Hub's cache to its contents.
    What lies elsewhere is not read: the folder may be anybody's.
    """
    if not folder.exists(path):
        return "is missing"
    if not folder.is_local:
        return ""
    root, place = (Path(os.path.realpath(folder.address(each))) for each in ("", path))
    blobs = root.parent.parent / "blobs"
    if not place.is_relative_to(root) and not (root.parent.name == "snapshots" and place.parent == blobs):
        return f"is a link that leads out of the folder, to {str(place)!r}; next: put the file there itself"
    return "" if place.is_file() else "is not a file (it is a folder, a pipe or a device)"


def _incomplete(folder: DataFolder, manifest: Manifest) -> list[Finding]:
    """Find shards that a manifest lacks, and files that it does not list."""
    if not manifest.complete:
        return [Finding(MANIFEST_FILE, "the run was interrupted; the same command goes on")]
    findings = []
    for split in manifest.splits:
        shards = [record.shard for record in manifest.shards_of(split)]
        missing = set(range(shards[0].count)) - {shard.index for shard in shards}
        if missing:
            findings.append(Finding(MANIFEST_FILE, f"split {split!r} lacks shards {sorted(missing)}"))
    known = {record.shard.data_path for record in manifest.shards}
    # A hidden name is of a file that somebody is writing, or never finished: no reader takes it for a shard.
    there = [f"{DATA_FOLDER}/{name}" for name in folder.names(DATA_FOLDER) if not name.startswith(".")]
    stray = f"is not listed in {MANIFEST_FILE}; next: remove it"
    findings += [Finding(path, stray) for path in there if path not in known]
    return findings


def _check_file(folder: DataFolder, path: str, checksum: str) -> list[Finding]:
    problem = problem_of_place(folder, path)
    if problem:
        return [Finding(path, problem)]
    found = file_sha256(folder, path)
    return [] if found == checksum else [Finding(path, f"sha256 is {found}, expected {checksum}")]


def _check_shard(
    folder: DataFolder, record: ShardRecord, schema: Any, first_files: dict[object, str]
) -> list[Finding]:
    """Check one shard; ``first_files`` names the file of each id that was seen before, and is filled."""
    path = record.shard.data_path
    findings = _check_file(folder, path, record.sha256)
    if findings:
        return findings
    try:
        with named_damage(folder.address(path)):
            parquet = open_parquet(folder, path)
            rows, stored = parquet.metadata.num_rows, parquet.schema_arrow
            ids = parquet.read(columns=["id"], use_threads=False).column(0).to_pylist()
    except IntegrityError as error:
        return [Finding(path, str(error))]
    if rows != record.rows:
        findings.append(Finding(path, f"has {rows} rows, expected {record.rows}"))
    if schema is not None and not stored.equals(schema):
        found, expected = set(map(str, stored)), set(map(str, schema))
        differences = f"{sorted(found - expected)} there, {sorted(expected - found)} expected"
        findings.append(Finding(path, f"schema differs: {differences}"))
    repeated = [item for item, count in Counter(ids).items() if count > 1 or item in first_files]
    if repeated:
        first = first_files.get(repeated[0], path)
        problem = f"id {repeated[0]!r} is not unique, it also stands in {first} ({len(repeated)} such ids)"
        findings.append(Finding(path, problem))
    first_files.update(dict.fromkeys(ids, path))
    return findings
