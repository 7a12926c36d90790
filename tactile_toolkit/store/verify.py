"""Proving that a data set folder is what its manifest says, or what the Hub said that it was fetched from."""

from __future__ import annotations

import contextlib
import io
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest
from tactile_toolkit.store.origin import RECORD_FILE, Digest, DownloadRecord, HubFile, read_record
from tactile_toolkit.store.parquet import named_damage, open_checked
from tactile_toolkit.store.shards import DATA_FOLDER, VIEWER_FOLDER, Finding, ShardName, ShardRecord


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
        record = read_record(folder)
        if record is None:
            raise InputError(
                f"{folder.lacks(f'{MANIFEST_FILE} and no record of a download')}",
                next="give the folder of a "
                "generated or downloaded data set, whose files can be compared with those",
            )
        return _verify_copy(folder, record, on_file, workers)
    findings = _incomplete(folder, manifest)

    def shards() -> Iterator[ShardRecord]:
        for record in manifest.shards:
            on_file(record.shard.data_path)
            yield record

    checked = list(in_threads(partial(_check_shard, folder, schema), shards(), workers))
    for (found, _), repeated in zip(checked, _repeated_ids(manifest.shards, checked), strict=True):
        findings += [*found, *repeated]
    files = {path: each for path, each in (manifest.files or {}).items() if not _is_left_out(folder, path)}
    for path, checksum in files.items():
        on_file(path)
        findings += _check_file(folder, path, Digest("sha256", checksum))[0]
    if check_card is not None and not findings:  # what is damaged is named, and cannot be compared with
        findings += check_card(folder)
    rows = sum(shard.rows for shard in manifest.shards)
    size = sum(shard.bytes for shard in manifest.shards)
    return Verification(len(manifest.shards) + len(files), rows, size, tuple(findings))


def _is_left_out(folder: DataFolder, path: str) -> bool:
    """Return whether a file for the Hub's page is not here, as in the cache of who wanted the rows alone."""
    return path.startswith(f"{VIEWER_FOLDER}/") and not folder.exists(path)


def _verify_copy(
    folder: DataFolder, record: DownloadRecord, on_file: Callable[[str], None], workers: int
) -> Verification:
    findings: list[Finding] = []
    rows = 0

    def files() -> Iterator[HubFile]:
        for file in record.files.values():
            on_file(file.path)
            yield file

    def check(file: HubFile) -> tuple[list[Finding], int]:
        return _check_file(folder, file.path, file.digest, file.size_bytes)

    for problems, held in in_threads(check, files(), workers):
        findings += problems
        rows += held
    findings += [
        Finding(f"{DATA_FOLDER}/{name}", f"is not listed in {RECORD_FILE}; next: remove it")
        for name in folder.names(DATA_FOLDER)
        if f"{DATA_FOLDER}/{name}" not in record.files and not name.startswith(".")
    ]
    size = sum(file.size_bytes for file in record.files.values())
    reference = f"{record.repo_id} at {record.commit[:12]}"
    return Verification(len(record.files), rows, size, tuple(findings), reference)


def _check_file(
    folder: DataFolder, path: str, digest: Digest | None, size: int | None = None
) -> tuple[list[Finding], int]:
    """Check one file against what is known of it; return what is wrong, and the rows that it holds."""
    try:
        # Ids are the publisher's own: nothing says that they differ between splits.
        with _intact(folder, path, digest, size) as stream, named_damage(folder.address(path)):
            return [], open_checked(stream).metadata.num_rows if path.endswith(".parquet") else 0
    except IntegrityError as error:
        return [Finding(path, str(error))], 0


def problem_of_place(folder: DataFolder, path: str) -> str:
    """Say why a path of a folder is not one of its own files; empty where it is one.

    A link may lead to another file of the folder, and from a snapshot of the Hub's cache to its contents.
    What lies elsewhere is not read: the folder may be any user's.
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
        return [Finding(MANIFEST_FILE, "the run was interrupted; the same command continues")]
    findings = []
    for split in manifest.splits:
        shards = [record.shard for record in manifest.shards_of(split)]
        missing = set(range(shards[0].count)) - {shard.index for shard in shards}
        if missing:
            findings.append(Finding(MANIFEST_FILE, f"split {split!r} lacks shards {sorted(missing)}"))
    known = {record.shard.data_path for record in manifest.shards}
    # Hidden names are of temporary files, and a run may be at work on a split of which nothing is listed.
    others = set(manifest.split_order) - set(manifest.splits)
    for name in folder.names(DATA_FOLDER):
        path, shard = f"{DATA_FOLDER}/{name}", ShardName.parse(name)
        is_begun = shard is not None and shard.split in others
        if not (path in known or is_begun or name.startswith(".")):
            findings.append(Finding(path, f"is not listed in {MANIFEST_FILE}; next: remove it"))
    return findings


@contextlib.contextmanager
def _intact(
    folder: DataFolder, path: str, digest: Digest | None, size: int | None = None
) -> Iterator[IO[bytes]]:
    """Open a file that has this digest, or this size; IntegrityError says what is wrong with any other."""
    problem = problem_of_place(folder, path)
    if not problem:
        # One of a store is brought here whole, because it is gone through twice.
        with folder.open(path) if folder.is_local else io.BytesIO(folder.read_bytes(path)) as stream:
            found_size = stream.seek(0, io.SEEK_END)
            stream.seek(0)
            found = None if digest is None else digest.of_stream(stream, found_size)
            if digest is not None and found is not None and found != digest:
                problem = f"{found.kind} is {found.value}, expected {digest.value}"
            elif size not in (None, found_size):
                problem = f"has {found_size:,} bytes, expected {size:,}"
            else:
                yield stream
                return
    raise IntegrityError(problem)


def _check_shard(folder: DataFolder, schema: Any, record: ShardRecord) -> tuple[list[Finding], Any]:
    """Check one shard; return what is wrong with it, and its ids as an Arrow array (None: unreadable)."""
    import pyarrow as pa

    path, ids, findings = record.shard.data_path, None, []
    address = folder.address(path)
    try:
        with _intact(folder, path, Digest("sha256", record.sha256)) as stream, named_damage(address):
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
    if schema is not None and not stored.equals(schema):
        # Compared by Arrow: how the element of a list is called does not count.
        there, expected = (
            [str(each).partition("<")[2][:-1] for each in one if not any(map(each.equals, other))]
            for one, other in ((stored, schema), (schema, stored))
        )
        differences = f"{there} there, {expected} expected"
        if not there and not expected:
            differences = (
                f"columns in the order {', '.join(stored.names)}, expected {', '.join(schema.names)}"
            )
        findings.append(Finding(path, f"schema differs: {differences}"))
    return findings, ids


def _repeated_ids(
    records: Sequence[ShardRecord], checked: Sequence[tuple[list[Finding], Any]]
) -> Iterator[list[Finding]]:
    """Yield for each shard a finding where an id stands in it twice, or in a shard before it."""
    suspects = _suspects([ids for _, ids in checked if ids is not None])
    first_files: dict[object, str] = {}
    for record, (_, ids) in zip(records, checked, strict=True):
        path = record.shard.data_path
        held = [each for each in ids.to_pylist() if each in suspects] if suspects and ids is not None else ()
        repeated = [each for each, count in Counter(held).items() if count > 1 or each in first_files]
        if repeated:
            first = first_files.get(repeated[0], path)
            problem = (
                f"id {repeated[0]!r} is not unique, it also stands in {first} ({len(repeated)} such ids)"
            )
            yield [Finding(path, problem)]
        else:
            yield []
        first_files.update(dict.fromkeys(held, path))


def _suspects(ids: Sequence[Any]) -> set[object]:
    """Return the ids that stand in some arrays more than once; integers without an object for each."""
    import numpy as np
    import pyarrow as pa

    types = {array.type for array in ids}
    if len(types) > 1 or any(not pa.types.is_integer(array.type) or array.null_count for array in ids):
        counts = Counter(each for array in ids for each in array.to_pylist())
        return {each for each, count in counts.items() if count > 1}
    values = np.concatenate([array.to_numpy() for array in ids] or [np.zeros(0, np.int64)])
    values.sort()
    return set(values[1:][values[1:] == values[:-1]].tolist())
