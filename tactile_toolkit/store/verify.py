"""Checking a data set folder against its manifest, or against the commit that it was downloaded from."""

from __future__ import annotations

import contextlib
import io
import os
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any, TypeVar

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest
from tactile_toolkit.store.origin import RECORD_FILE, HubFile, digest_like, kind_of, read_record
from tactile_toolkit.store.parquet import named_damage, open_checked
from tactile_toolkit.store.shards import DATA_FOLDER, VIEWER_FOLDER, Finding, ShardName, ShardRecord

T = TypeVar("T")
R = TypeVar("R")


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
    workers: int = 1,
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
    workers : int
        Number of threads that read and hash; what is found does not depend on it.

    Raises
    ------
    InputError
        When the folder holds no manifest and was not downloaded.
    IntegrityError
        When the manifest, or the record of the download, is itself damaged.
    """
    manifest = read_manifest(folder)
    if manifest is None:
        return _verify_copy(folder, on_file, workers)
    findings = _incomplete(folder, manifest)
    check = partial(_check_shard, folder, schema)
    checked = _each(check, {record.file: record for record in manifest.shards}, on_file, workers)
    findings += [finding for found, _ in checked for finding in found]
    findings += _repeated_ids(manifest.shards, [ids for _, ids in checked])
    # Files for the Hub's page may be left out, as in a cache of the rows alone.
    files = {
        path: HubFile(path, 0, sha256)
        for path, sha256 in manifest.files.items()
        if not path.startswith(f"{VIEWER_FOLDER}/") or folder.exists(path)
    }
    for found, _ in _each(partial(_check_file, folder), files, on_file, workers):
        findings += found
    if check_card is not None and not findings:  # what is damaged is named, and cannot be compared with
        findings += check_card(folder)
    rows = sum(shard.rows for shard in manifest.shards)
    size = sum(shard.bytes for shard in manifest.shards)
    return Verification(len(manifest.shards) + len(files), rows, size, tuple(findings))


def _verify_copy(folder: DataFolder, on_file: Callable[[str], None], workers: int) -> Verification:
    record = read_record(folder)
    if record is None:
        raise InputError(
            folder.missing_message(f"{MANIFEST_FILE} and no record of a download"),
            next="give the folder of a generated or downloaded data set",
        )
    # Ids are the publisher's own, and may be the same in several splits.
    checked = _each(partial(_check_file, folder), record.files, on_file, workers)
    findings = [finding for found, _ in checked for finding in found]
    findings += _unlisted(folder, record.files, RECORD_FILE)
    size = sum(file.size_bytes for file in record.files.values())
    reference = f"{record.repo_id} at {record.commit[:12]}"
    return Verification(len(checked), sum(rows for _, rows in checked), size, tuple(findings), reference)


def _each(
    check: Callable[[T], R], files: Mapping[str, T], on_file: Callable[[str], None], workers: int
) -> list[R]:
    """Check files by path in threads; each is announced before it is read."""

    def announced() -> Iterator[T]:
        for path, file in files.items():
            on_file(path)
            yield file

    return list(in_threads(check, announced(), workers))


def _check_file(folder: DataFolder, file: HubFile) -> tuple[list[Finding], int]:
    """Check one file against what is known of it; return what is wrong, and the rows that it holds."""
    try:
        with _intact(folder, file) as stream, named_damage(folder.address(file.path)):
            return [], open_checked(stream).metadata.num_rows if file.path.endswith(".parquet") else 0
    except IntegrityError as error:
        return [Finding(file.path, str(error))], 0


def problem_of_place(folder: DataFolder, path: str) -> str:
    """Say why a path of a folder is not one of its own files; empty where it is one.

    A link may lead to another file of the folder, and from a snapshot of the Hub's cache to its contents.
    Other files are not read: the folder may be any user's.
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
    """Find shards that are not in a manifest, and files that it does not list."""
    if not manifest.complete:
        return [Finding(MANIFEST_FILE, "the run was interrupted; the same command continues")]
    findings = []
    for split in manifest.splits:
        shards = [record.shard for record in manifest.shards_of(split)]
        missing = set(range(shards[0].count)) - {shard.index for shard in shards}
        if missing:
            findings.append(Finding(MANIFEST_FILE, f"split {split!r} has no shards {sorted(missing)}"))
    # A run may be at work on a split of which nothing is listed.
    others = set(manifest.split_order) - set(manifest.splits)
    return findings + _unlisted(folder, {record.file for record in manifest.shards}, MANIFEST_FILE, others)


def _unlisted(
    folder: DataFolder, listed: Collection[str], where: str, others: Collection[str] = ()
) -> list[Finding]:
    """Find files among the shards that are not listed, but for those of other splits and temporary ones."""
    findings = []
    for name in folder.names(DATA_FOLDER):
        path, shard = f"{DATA_FOLDER}/{name}", ShardName.parse(name)
        is_begun = shard is not None and shard.split in others
        if not (path in listed or is_begun or name.startswith(".")):
            findings.append(Finding(path, f"is not listed in {where}; next: remove it"))
    return findings


@contextlib.contextmanager
def _intact(folder: DataFolder, file: HubFile) -> Iterator[IO[bytes]]:
    """Open a file that has this digest or size; IntegrityError states the problem of any other."""
    problem = problem_of_place(folder, file.path)
    if problem:
        raise IntegrityError(problem)
    # One of a store is brought here whole, because it is gone through twice.
    with folder.open(file.path) if folder.is_local else io.BytesIO(folder.read_bytes(file.path)) as stream:
        found = None if file.digest is None else digest_like(stream, file.digest)
        if found != file.digest:
            raise IntegrityError(f"{kind_of(str(found))} is {found}, expected {file.digest}")
        size = stream.seek(0, io.SEEK_END)
        if file.digest is None and size != file.size_bytes:
            raise IntegrityError(f"has {size:,} bytes, expected {file.size_bytes:,}")
        yield stream


def _check_shard(folder: DataFolder, schema: Any, record: ShardRecord) -> tuple[list[Finding], Any]:
    """Check one shard; return what is wrong with it, and its ids as an Arrow array (None: unreadable)."""
    import pyarrow as pa

    path, ids, findings = record.file, None, []
    address = folder.address(path)
    file = HubFile(path, record.bytes, record.sha256)
    try:
        with _intact(folder, file) as stream, named_damage(address):
            parquet = open_checked(address if folder.is_local else stream)
            rows, stored = parquet.metadata.num_rows, parquet.schema_arrow
            place = stored.get_field_index("id")
            if place < 0 or pa.types.is_nested(stored.field(place).type):
                findings.append(Finding(path, "holds no column 'id' of one value for each row"))
            else:
                ids = parquet.read(columns=["id"], use_threads=False).column(0).combine_chunks()
    except IntegrityError as error:
        return [Finding(path, str(error))], None
    if rows != record.rows:
        findings.append(Finding(path, f"has {rows} rows, expected {record.rows}"))
    # Compared by Arrow: how the element of a list is called does not count.
    if schema is not None and not stored.equals(schema):
        found, expected = (
            [f"{each.name}: {each.type}" for each in one if not any(map(each.equals, other))]
            for one, other in ((stored, schema), (schema, stored))
        )
        differences = f"{found} there, {expected} expected" if found or expected else "the order of columns"
        findings.append(Finding(path, f"schema differs: {differences}"))
    return findings, ids


def _repeated_ids(records: Sequence[ShardRecord], ids: Sequence[Any]) -> Iterator[Finding]:
    """Yield a finding for each shard in which an id stands twice, or again after an earlier shard."""
    import pyarrow as pa
    import pyarrow.compute as pc

    readable = [each for each in ids if each is not None]
    suspects: set[object] = set()
    for kind in {array.type for array in readable}:
        counted = pa.chunked_array([array for array in readable if array.type == kind]).value_counts()
        suspects.update(counted.filter(pc.greater(counted.field("counts"), 1)).field("values").to_pylist())
    first_files: dict[object, str] = {}
    for record, each in zip(records, ids, strict=True):
        if not suspects or each is None:
            continue
        held = [value for value in each.to_pylist() if value in suspects]
        repeated = [value for value, count in Counter(held).items() if count > 1 or value in first_files]
        if repeated:
            first = first_files.get(repeated[0], record.file)
            problem = f"is not unique, it also stands in {first} ({len(repeated)} such ids)"
            yield Finding(record.file, f"id {repeated[0]!r} {problem}")
        first_files.update(dict.fromkeys(held, record.file))
