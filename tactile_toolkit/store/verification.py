"""Checking a data set folder against its manifest, or against the commit of its download."""

from __future__ import annotations

import contextlib
import hashlib
import io
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, NamedTuple

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from tactile_toolkit import errors, run, wording
from tactile_toolkit.store.files import is_hidden, names_inside, open_regular
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import (
    DATA_FOLDER,
    MANIFEST_FILE,
    VIEWER_FOLDER,
    Count,
    Finding,
    Manifest,
    ShardName,
    ShardRecord,
    decode,
    require_seal,
    seal,
)
from tactile_toolkit.store.parquet import named_damage, open_checked

RECORD_FILE = ".download.json"
DIGEST = re.compile("[0-9a-f]{64}|[0-9a-f]{40}")
_SHA256_DIGITS = 64
_STORED_NAMES = {"repo_id": "repository", "metadata_files": "labels"}


@dataclass(frozen=True, slots=True)
class Verification:
    """Result of a verification; ``reference`` is the manifest or the commit of the Hub."""

    files: int
    rows: int
    bytes: int
    findings: tuple[Finding, ...]
    reference: str = MANIFEST_FILE

    @property
    def ok(self) -> bool:
        """Whether there are no findings."""
        return not self.findings


def verify(
    folder: DataFolder,
    schema: pa.Schema | None = None,
    workers: int = 1,
) -> Verification:
    """Check every checksum, row count, schema and the uniqueness of ids over all splits.

    A downloaded folder without a manifest, such as a copy of a published data set, is compared with the sizes
    and checksums from the Hub. In an unfinished set, all finished shards are checked.

    Parameters
    ----------
    folder : DataFolder
        Folder of a finished data set.
    schema : pyarrow.Schema, optional
        Schema that every shard must have; not required of data sets of others.
    workers : int
        Number of threads that read and hash; the findings do not depend on it.

    Raises
    ------
    InputError
        The folder has no manifest and was not downloaded.
    IntegrityError
        The manifest, or the record of the download, is damaged.
    """
    manifest = Manifest.so_far(folder)
    shards: dict[str, ShardRecord] = {}
    if manifest is None:
        record = read_download_record(folder)
        if record is None:
            raise errors.InputError(
                folder.missing_message(f"{MANIFEST_FILE} and no record of a download"),
                next="give the folder of a generated or downloaded data set",
            )
        files = record.files
        findings = _unlisted(folder, files, RECORD_FILE)
        reference = f"{record.repo_id} at {record.commit[:12]}"
    else:
        shards = {record.file: record for record in manifest.shards}
        files = _recorded_files(folder, manifest)
        reference = MANIFEST_FILE
        findings = _incomplete(folder, manifest)

    check = partial(_check_file, folder, schema, shards)
    checked = dict(zip(files, run.in_threads(check, files.values(), workers), strict=True))
    findings += [finding for result in checked.values() for finding in result.findings]
    # Data sets of others may have the same ids in several splits.
    findings += _repeated_ids({path: checked[path].ids for path in shards})
    rows = sum(result.rows for path, result in checked.items() if path in (shards or files))
    size = sum(file.size_bytes for file in files.values())
    return Verification(len(files), rows, size, tuple(findings), reference)


def _recorded_files(folder: DataFolder, manifest: Manifest) -> dict[str, HubFile]:
    """Return the files that a manifest lists, by path."""
    files = {record.file: HubFile(record.file, record.bytes, record.sha256) for record in manifest.shards}
    for path, sha256 in manifest.files.items():
        # Files for the Hub's page may be left out, as in a cache with only the rows; others may still arrive.
        is_required = manifest.complete and not path.startswith(f"{VIEWER_FOLDER}/")
        if is_required or folder.exists(path):
            files[path] = HubFile(path, 0, sha256)
    return files


class _Checked(NamedTuple):
    """Findings about a file, its number of rows, and the ids of a shard (None: unreadable)."""

    findings: list[Finding]
    rows: int = 0
    ids: pa.Array | None = None


def _check_file(
    folder: DataFolder,
    schema: pa.Schema | None,
    shards: Mapping[str, ShardRecord],
    file: HubFile,
) -> _Checked:
    """Check the content of a file, and a shard also against its record and the schema."""
    path = file.path
    address = folder.address(file.path)
    record = shards.get(path)
    ids = None
    findings = list[Finding]()
    try:
        with _intact(folder, file) as stream, named_damage(address):
            if not path.endswith(".parquet"):
                return _Checked([])
            parquet = open_checked(address if folder.is_local else stream)
            rows = parquet.metadata.num_rows
            stored = parquet.schema_arrow
            if record is None:
                return _Checked([], rows)
            column_index = stored.get_field_index("id")
            if column_index < 0 or pa.types.is_nested(stored.field(column_index).type):
                findings.append(Finding(path, "holds no column 'id' of one value for each row"))
            else:
                ids = parquet.read(columns=["id"], use_threads=False).column(0).combine_chunks()
    except errors.IntegrityError as error:
        return _Checked([Finding(path, error.what)], getattr(record, "rows", 0))
    if rows != record.rows:
        findings.append(Finding(path, f"has {rows} rows, expected {record.rows}"))
    # Arrow ignores the names of list elements.
    if schema is not None and not stored.equals(schema):
        stored_only, missing = (
            [f"{column.name}: {column.type}" for column in columns if not any(map(column.equals, others))]
            for columns, others in ((stored, schema), (schema, stored))
        )
        differences = "the order of columns"
        if stored_only or missing:
            differences = f"{stored_only} there, {missing} expected"
        findings.append(Finding(path, f"schema differs: {differences}"))
    return _Checked(findings, record.rows, ids)


def _incomplete(folder: DataFolder, manifest: Manifest) -> list[Finding]:
    """Find shards that a manifest lacks, and files that it does not list."""
    if not manifest.complete:  # a run may be about to record further shards
        return [Finding(MANIFEST_FILE, _not_finished(folder, manifest))]
    findings = []
    for split in manifest.splits:
        shards = [record.shard for record in manifest.shards_of(split)]
        missing = set(range(shards[0].count)) - {shard.index for shard in shards}
        if missing:
            findings.append(Finding(MANIFEST_FILE, f"split {split!r} has no shards {sorted(missing)}"))
    # A run may be at work on a split that is not listed.
    others = set(manifest.split_order) - set(manifest.splits)
    return findings + _unlisted(folder, {record.file for record in manifest.shards}, MANIFEST_FILE, others)


def _not_finished(folder: DataFolder, manifest: Manifest) -> str:
    record = read_download_record(folder)
    if record is not None:
        return f"not finished; next: download {record.repo_id} there again, it continues where it stopped"
    return f"not finished: {manifest.progress}; the same command continues"


def _unlisted(
    folder: DataFolder, listed: Collection[str], source: str, others: Collection[str] = ()
) -> list[Finding]:
    """Find files in the data folder that are not listed, except those of other splits and hidden ones."""
    findings = []
    for name in folder.names(DATA_FOLDER):
        path = f"{DATA_FOLDER}/{name}"
        shard = ShardName.parse(name)
        is_begun = shard is not None and shard.split in others
        if not (path in listed or is_begun or is_hidden(name)):
            findings.append(Finding(path, f"is not listed in {source}; next: move it to another folder"))
    return findings


@contextlib.contextmanager
def _intact(folder: DataFolder, file: HubFile) -> Iterator[IO[bytes]]:
    """Open a file with this digest or size; IntegrityError states the problem of any other."""
    problem = folder.problem_of_file(file.path)
    if problem:
        raise errors.IntegrityError(problem)
    # A file of a store is fetched as a whole, because it is read twice.
    with folder.open(file.path) if folder.is_local else io.BytesIO(folder.read_bytes(file.path)) as stream:
        digest = None if file.digest is None else digest_like(stream, file.digest)
        if digest != file.digest:
            algorithm = "sha256" if len(str(digest)) == _SHA256_DIGITS else "git-sha1"
            raise errors.IntegrityError(f"{algorithm} is {digest}, expected {file.digest}")
        size = stream.seek(0, io.SEEK_END)
        if file.digest is None and size != file.size_bytes:
            raise errors.IntegrityError(f"has {size:,} bytes, expected {file.size_bytes:,}")
        yield stream


def _repeated_ids(ids: Mapping[str, pa.Array | None]) -> Iterator[Finding]:
    """Yield a finding for each shard with a duplicate id, or an id of an earlier shard."""
    readable = {path: column for path, column in ids.items() if column is not None}
    suspects: set[object] = set()
    for kind in {array.type for array in readable.values()}:
        alike = [array for array in readable.values() if array.type == kind]
        counted = pa.chunked_array(alike).value_counts()
        suspects.update(counted.filter(pc.greater(counted.field("counts"), 1)).field("values").to_pylist())
    first_files: dict[object, str] = {}
    if not suspects:
        return
    for path, column in readable.items():
        held = [value for value in column.to_pylist() if value in suspects]
        repeated = [value for value, count in Counter(held).items() if count > 1 or value in first_files]
        if repeated:
            first = first_files.get(repeated[0], path)
            such = wording.with_count(len(repeated), "such ids")
            yield Finding(path, f"id {repeated[0]!r} is not unique, it is also in {first} ({such})")
        first_files.update(dict.fromkeys(held, path))


def digest_like(stream: IO[bytes], digest: str) -> str:
    """Return the digest of an open file in hexadecimal, by the algorithm of another digest."""
    if len(digest) == _SHA256_DIGITS:
        digester = hashlib.sha256()
    else:  # git hashes a header with the size before the content
        digester = hashlib.sha1(b"blob %d\0" % stream.seek(0, io.SEEK_END), usedforsecurity=False)
    stream.seek(0)
    hashlib.file_digest(stream, lambda: digester)  # type: ignore[arg-type]
    return digester.hexdigest()


def has_digest(path: Path, digest: str) -> bool:
    """Return whether a local file has a digest; all of it is read."""
    with open_regular(path) as stream:
        return digest_like(stream, digest) == digest


class HubFile(msgspec.Struct, frozen=True, omit_defaults=True):
    """A file of a repository; ``digest`` is None if only a cached copy without a digest is known."""

    path: str = ""
    size_bytes: Count = msgspec.field(name="bytes", default=0)
    digest: str | None = None

    def __post_init__(self) -> None:
        if self.digest is not None and not DIGEST.fullmatch(self.digest):
            raise ValueError(f"{self.digest[:80]!r} is not a digest in hexadecimal digits")


class DownloadRecord(msgspec.Struct, frozen=True, rename=_STORED_NAMES):
    """Origin of a downloaded folder.

    ``revision`` is the requested branch or tag; ``files`` are those of the folder; ``splits`` are
    all of the repository, downloaded or not; ``metadata_files`` states which of card and manifest the
    repository has. ``finished`` is False during the download or after it was interrupted.
    """

    repo_id: str
    commit: str
    revision: str | None
    files: dict[str, HubFile]
    splits: tuple[str, ...]
    metadata_files: tuple[str, ...]
    finished: bool = True


def read_download_record(folder: DataFolder) -> DownloadRecord | None:
    """Read the record of a folder; None when it was not downloaded, IntegrityError when it is damaged."""
    if not folder.exists(RECORD_FILE):
        return None
    address = folder.address(RECORD_FILE)
    content = folder.read_bytes(RECORD_FILE)
    record = decode(content, DownloadRecord, address)
    require_seal(content, address)
    names_inside((*record.files, *record.metadata_files), repr(address))
    files = {path: msgspec.structs.replace(file, path=path) for path, file in record.files.items()}
    return msgspec.structs.replace(record, files=files)


def write_download_record(folder: DataFolder, record: DownloadRecord) -> None:
    """Write the record of a folder in one step."""
    files = {path: msgspec.structs.replace(file, path="") for path, file in sorted(record.files.items())}
    content = msgspec.json.encode(msgspec.structs.replace(record, files=files))
    folder.write_bytes(RECORD_FILE, seal(f"{msgspec.json.format(content.decode(), indent=1)}\n").encode())
