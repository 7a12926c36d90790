"""A job: what is to be made in a folder, and which of its shards are finished.

The kinds of data bring a :class:`BuildPlan`: one task for each shard, and the specification that they follow
from. The record of a shard is the only state: ``.pending/SHARD.json`` until a run is finished, an entry of
the manifest from then on. A record names the job that it is of, so that leftovers of another never count.
"""

from __future__ import annotations

import contextlib
import json
import socket
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.metadata import version
from itertools import groupby
from typing import Any

import msgspec

from tactile_toolkit import __version__
from tactile_toolkit.errors import InputError, IntegrityError, SpecMismatchError
from tactile_toolkit.store.folder import PENDING_FOLDER, DataFolder
from tactile_toolkit.store.manifest import (
    MANIFEST_FILE,
    Manifest,
    read_manifest,
    write_manifest,
)
from tactile_toolkit.store.names import Count, decode, is_hidden, require_seal, seal
from tactile_toolkit.store.ownership import is_pending
from tactile_toolkit.store.parquet import ParquetStyle, file_sha256, sha256_hex
from tactile_toolkit.store.run_options import RunOptions
from tactile_toolkit.store.shards import DATA_FOLDER, ShardName, ShardRecord
from tactile_toolkit.store.task import ShardTask

_LONGEST_SHOWN = 200
_DIFFERENCES_SHOWN = 5


@dataclass(frozen=True)
class BuildPlan:
    """What a folder is to hold: one task for each shard, and the specification that they follow from.

    Parameters
    ----------
    kind : str
        Kind of data set, such as ``"mnist3d"``.
    spec : mapping
        Full specification as JSON values. Two plans with equal ``spec`` agree on every row.
    split_order : tuple of str
        Canonical order of the splits of this kind.
    tasks : tuple of ShardTask
        One per shard of the splits asked for.
    style : ParquetStyle
        Layout of the shards.
    report_file : str or None
        Path of the merged report, where shards have one.
    extra_dirs : tuple of str
        Sub-folders (or files) next to the rows that belong to the data set: what tasks give as ``files`` lies
        there.
    files_of : callable
        Takes the folder and the record of a finished shard, and returns the checksum of each of its ``files``
        by path.
    libraries : tuple of str
        Distributions whose versions decide bytes.
    write_files : callable
        Writes files that follow from all rows, such as an index, once those are there; takes the folder and
        the manifest, returns the checksum of each by path.
    """

    kind: str
    spec: Mapping[str, Any]
    split_order: tuple[str, ...]
    tasks: tuple[ShardTask[Any], ...]
    style: ParquetStyle
    report_file: str | None = None
    extra_dirs: tuple[str, ...] = ()
    files_of: Callable[[DataFolder, ShardRecord], Mapping[str, str]] = field(
        default=lambda _folder, _record: {}, repr=False
    )
    libraries: tuple[str, ...] = ()
    write_files: Callable[[DataFolder, Manifest], Mapping[str, str]] = field(
        default=lambda _folder, _manifest: {}, repr=False
    )

    def __post_init__(self) -> None:
        # As in a manifest: JSON has made lists of tuples.
        text = json.dumps(self.spec, ensure_ascii=False)
        object.__setattr__(self, "spec", json.loads(text))
        try:
            text.encode()
        except UnicodeEncodeError as error:
            found = text[max(0, error.start - 20) : error.end + 20]
            raise InputError(
                f"the specification holds {found!r}, which is not Unicode text", next="give another name"
            ) from error
        splits: dict[str, str] = {}
        for shard in (task.shard for task in self.tasks):
            first = splits.setdefault(shard.split.casefold(), shard.split)
            if first != shard.split or not shard.can_be_read_back:
                raise InputError(
                    f"shard {shard} cannot be named so that it is found again; expected a split of letters, "
                    "digits and underscores that differs from others not in case alone, and an index below "
                    "the count; nothing was changed",
                    next="rename it",
                )

    def new_manifest(self) -> Manifest:
        """Return the manifest of a folder in which nothing is finished."""
        return Manifest(
            self.kind,
            __version__,
            self.spec,
            self.split_order,
            planned=Counter(task.shard.split for task in self.tasks),
            trees=self.extra_dirs,
            libraries={name: version(name) for name in self.libraries},
        )


class MissingPartsError(IntegrityError):
    """Parts of a data set that cannot be finished yet.

    ``shards`` is how many are missing of ``parts`` in all; ``array`` are the parts that make them, one a
    shard, as Slurm writes numbers of an array.
    """

    def __init__(self, where: str, shards: int, parts: int, array: str) -> None:
        which = "part" if array.isdigit() else "parts"
        super().__init__(
            f"{shards:,} of {parts:,} shards of {where!r} are not finished, or a node writes to a folder "
            f"that this machine does not see; they are those of {which} {array} of {parts:,}",
            next=f"give these (--part auto/{parts}; Slurm: --array={array}), then --finish, or run the same "
            "command without --finish, on a folder that all nodes share, or s3://BUCKET/PATH",
        )
        self.shards, self.parts, self.array = shards, parts, array
        self.args = (where, shards, parts, array)  # by which it crosses process borders


def array_text(numbers: Sequence[int]) -> str:
    """Write numbers as Slurm takes them for ``--array``: ``3,17,40-44``."""
    runs = [
        [number for _, number in run]
        for _, run in groupby(enumerate(sorted(set(numbers))), lambda pair: pair[1] - pair[0])
    ]
    return ",".join(str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)


@dataclass(frozen=True)
class Job:
    """A run of a plan in a folder, or of the tasks of one part.

    ``manifest`` is that of the folder, or the one that it is to get; ``finished`` are the records of shards
    that are intact, ``remaining`` the tasks of all others.
    """

    folder: DataFolder
    plan: BuildPlan
    manifest: Manifest
    tasks: tuple[ShardTask[Any], ...]
    finished: tuple[ShardRecord, ...] = ()

    @property
    def remaining(self) -> tuple[ShardTask[Any], ...]:
        """The tasks whose shards are to be made."""
        finished = {record.shard for record in self.finished}
        return tuple(task for task in self.tasks if task.shard not in finished)


def begin_job(folder: DataFolder, plan: BuildPlan, options: RunOptions) -> Job:
    """Find out what a run has to do in a folder, and create its manifest where there is none.

    Raises as :func:`inspect_job`.
    """
    while True:
        job = inspect_job(folder, plan, options)
        current = read_manifest(folder)
        if current is None and (job.remaining or job.finished):
            _remove_outdated_records(folder, plan, job.manifest)
            folder.create_bytes(MANIFEST_FILE, job.manifest.to_json().encode())
            continue  # read back: another run may have been faster
        if current is not None and current.identity != job.manifest.identity:
            write_manifest(folder, job.manifest)  # of other versions, and none of its shards is left
        return job


def _remove_outdated_records(folder: DataFolder, plan: BuildPlan, manifest: Manifest) -> None:
    """Remove records of a job whose manifest was removed, where their files are not what they state.

    Another set may have been begun on top of them, and removed: from here on only sizes are compared.
    """
    records = pending_records(folder, manifest.identity)
    intact = _intact_records(folder, plan, manifest, {task.shard: task for task in plan.tasks}, check=True)
    for shard in records.keys() - intact.keys():
        folder.remove(shard.record_path)


def inspect_job(folder: DataFolder, plan: BuildPlan, options: RunOptions | None = None) -> Job:
    """Compare a folder with a plan, or with the tasks of a part, and change nothing.

    Raises SpecMismatchError when the folder is made by another specification, or by libraries that write
    other bytes (the message states the differences), InputError when it holds something else, and
    MissingPartsError where shards are missing that ``finish`` needs.
    """
    options = options or RunOptions()
    manifest, new, check = read_manifest(folder), plan.new_manifest(), options.check
    tasks = plan.tasks
    if options.part is not None:
        tasks = tuple(options.part.of(tasks))
    if manifest is None:
        refuse_unknown_files(folder, plan)
        manifest, check = new, True  # as in `_remove_outdated_records`
    found, wanted = (
        {"kind": each.kind, **each.spec, "toolkit_version": each.toolkit_version} for each in (manifest, new)
    )
    _refuse_difference(folder, found, wanted)
    _reject_unexpected_files(folder, plan)
    intact = _intact_records(folder, plan, manifest, {task.shard: task for task in tasks}, check)
    job = Job(folder, plan, replace(manifest, trees=plan.extra_dirs), tasks, tuple(intact.values()))
    if job.remaining and manifest.libraries != new.libraries:
        begun = {record.shard for record in manifest.shards}.union(
            _pending_shards(folder.names(PENDING_FOLDER))
        )
        if begun - {task.shard for task in job.remaining}:
            _refuse_difference(folder, {"libraries": manifest.libraries}, {"libraries": new.libraries})
        job = replace(job, manifest=new)
    if options.finish:
        require_parts(job, job.finished)
    return job


def require_parts(job: Job, records: Sequence[ShardRecord]) -> None:
    """Raise MissingPartsError where a task of a job has no record."""
    found, shards = {record.shard for record in records}, [task.shard for task in job.plan.tasks]
    wanted = {task.shard for task in job.tasks}
    numbers = [index for index, shard in enumerate(shards) if shard in wanted and shard not in found]
    if numbers:
        raise MissingPartsError(job.folder.address(), len(numbers), len(shards), array_text(numbers))


def require_same_job(folder: DataFolder, identity: str) -> Manifest:
    """Return the manifest of a folder; InputError where it is gone, or has another identity by now.

    Names of shards are the same in every data set of a kind: a slower run would put its rows among those of a
    run that has replaced its set.
    """
    version = folder.version(MANIFEST_FILE)
    manifest = None if version is None else _manifest_of_version(folder, version)
    if (manifest is None or manifest.identity != identity) and folder.exists():
        folder.refresh("")  # a network file system may have shown an earlier state
        manifest = read_manifest(folder)
    if manifest is None or manifest.identity != identity:
        raise InputError(
            f"the data set in {folder.address()!r} was removed or replaced while this run was at work, or "
            f"node {socket.gethostname()} writes to a folder that this machine does not see; the run has "
            "stopped and changed nothing in the folder",
            next="look there with the command `info`, then run the same command again, in a folder that "
            "all nodes share, or choose another one (--out or OUT)",
        )
    return manifest


@lru_cache(maxsize=1)
def _manifest_of_version(folder: DataFolder, version: object) -> Manifest | None:
    """Read a manifest again only where it has changed: shards follow each other quickly."""
    return read_manifest(folder)


def _intact_records(
    folder: DataFolder,
    plan: BuildPlan,
    manifest: Manifest,
    tasks: Mapping[ShardName, ShardTask[Any]],
    check: bool,
) -> dict[ShardName, ShardRecord]:
    """Return the record of each shard whose files are intact: by size or, to check, by content.

    To check is also to compare what the shard was made of. A pending record counts before that of the
    manifest.
    """
    sizes, report = folder.sizes(DATA_FOLDER), plan.report_file
    has_report = report is not None and folder.exists(report)
    listed = manifest.files.get(report) if report is not None else None  # none while it is written again
    if report is not None and has_report and (check or (listed and folder.is_local)):
        has_report = file_sha256(folder, report) == listed

    def is_intact(record: ShardRecord, digests: Mapping[str, str | None]) -> bool:
        if not record.is_size_of(sizes):  # first: most damage shows there, and costs no reading
            return False
        try:
            files = plan.files_of(folder, record)
            if not check:
                return all(map(folder.exists, files))
            for path, sha256 in {**digests, **files}.items():
                if sha256 is not None and file_sha256(folder, path) != sha256:
                    return False
            return tasks[record.shard].source_digest() == record.source_digest
        except (IntegrityError, FileNotFoundError):  # damaged in the same size, or gone at this moment
            return False

    intact = {}
    for record in manifest.shards:
        needs_report = record.rows and record.report_sha256
        is_wanted = record.shard in tasks and (has_report or not needs_report)
        if is_wanted and is_intact(record, {record.file: record.sha256}):
            intact[record.shard] = record
    for shard, record in pending_records(folder, manifest.identity, tasks).items():
        if is_intact(record, {record.file: record.sha256, shard.report_path: record.report_sha256}):
            intact[shard] = record
    return intact


class _Pending(msgspec.Struct):
    """What the record of a pending shard states besides: its job, and the size of its report rows."""

    of: str
    report_bytes: Count | None = None


def write_record(folder: DataFolder, record: ShardRecord, of: str, report_bytes: int | None = None) -> None:
    """Write the record of a finished shard."""
    values = {**record.to_dict(), "of": of, "report_bytes": report_bytes}
    folder.write_bytes(record.shard.record_path, seal(json.dumps(values, indent=1)).encode())


def _pending_shards(waiting: Iterable[str]) -> list[ShardName]:
    """Return the shards of which there are records, by names of files, that no manifest need hold."""
    names = (name.removesuffix(".json") for name in waiting if name.endswith(".json"))
    return [shard for shard in (ShardName.parse(f"{name}.parquet") for name in names) if shard is not None]


def pending_records(
    folder: DataFolder, of: str, shards: Collection[ShardName] | None = None
) -> dict[ShardName, ShardRecord]:
    """Read the records of a job that no manifest holds yet: of all shards, or of these.

    One whose report rows are missing, or of another size, does not count.
    """
    waiting = folder.sizes(PENDING_FOLDER)
    chosen = [shard for shard in _pending_shards(waiting) if shards is None or shard in shards]
    contents = folder.read_many([shard.record_path for shard in chosen])
    found = {}
    for shard, content in zip(chosen, contents, strict=True):
        # The shard of one that cannot be read is made again. It may also have been removed since it was
        # listed, because the run has just ended.
        with contextlib.suppress(IntegrityError, ValueError):
            require_seal(content or b"", shard.record_path)
            pending = decode(content or b"", _Pending, shard.record_path)
            if (pending.of, pending.report_bytes) == (of, waiting.get(shard.report_path.rpartition("/")[2])):
                record = decode(content or b"", ShardRecord, shard.record_path)
                found[record.shard] = record
    return found


def manifest_so_far(folder: DataFolder) -> Manifest | None:
    """Read the manifest of a folder together with what an unfinished run has finished; None without manifest.

    Sizes are compared, no content. Raises IntegrityError when the manifest is damaged.
    """
    manifest = read_manifest(folder)
    if manifest is None:
        return None
    begun = _begun_records(folder, manifest)
    return replace(manifest.with_shards(begun), complete=False) if begun else manifest


def _begun_records(folder: DataFolder, manifest: Manifest) -> list[ShardRecord]:
    """Return the pending records that a manifest does not hold and whose files exist."""
    pending = pending_records(folder, manifest.identity)
    if not pending:
        return []  # of a finished set no file is looked at: it may have 50,000
    listed, sizes = {record.shard for record in manifest.shards}, folder.sizes(DATA_FOLDER)
    return [
        record
        for shard, record in pending.items()
        if shard not in listed and shard.split in manifest.split_order and record.is_size_of(sizes)
    ]


def remove_leftovers(folder: DataFolder, manifest: Manifest) -> None:
    """Remove what a finished set does not need: its pending records and temporary files.

    The records of another split stay until that is finished. What is to replace the set is of another run.
    """
    shards = [record.shard for record in _begun_records(folder, manifest)]
    kept = {path for shard in shards for path in (shard.record_path, shard.report_path)}
    for path in (f"{PENDING_FOLDER}/{name}" for name in folder.names(PENDING_FOLDER)):
        if is_pending(path) and path not in kept:
            folder.remove(path)
    folder.remove_empty(PENDING_FOLDER)


def refuse_unknown_files(folder: DataFolder, plan: BuildPlan | None = None) -> None:
    """Refuse a folder without manifest that holds files: a run must never mix with those of a user.

    Where there are records of a run of the plan, the files are of that run, and its manifest was removed.
    """
    if plan is not None and pending_records(folder, plan.new_manifest().identity):
        return
    unknown = [name for name in folder.names() if not is_hidden(name)]
    if unknown and MANIFEST_FILE not in unknown:  # another run may have begun at this moment
        raise InputError(
            f"{folder.address()!r} is not empty and holds no {MANIFEST_FILE} (found {unknown[0]!r}); nothing "
            "was changed",
            next="choose an empty or new folder (--out or OUT)",
        )


def _refuse_difference(folder: DataFolder, found: object, wanted: object) -> None:
    lines = _differences(found, wanted)
    if lines:
        more = [f"and {len(lines) - _DIFFERENCES_SHOWN:,} more"] if len(lines) > _DIFFERENCES_SHOWN else []
        differing = "; ".join(lines[:_DIFFERENCES_SHOWN] + more)
        raise SpecMismatchError(
            f"{differing}: {folder.address()!r} holds a data set of another "
            "specification, or was begun with other versions, which write other bytes; nothing was changed",
            next="choose another folder (--out or OUT), or start again there with --overwrite (without "
            "--part and in no object store; there, remove it first), or install those versions",
        )


def _differences(found: Any, wanted: Any, path: str = "") -> list[str]:
    """State how two JSON values differ, one line for each difference."""
    if isinstance(found, Mapping) and isinstance(wanted, Mapping):
        lines = []
        for key in dict.fromkeys((*found, *wanted)):
            lines += _differences(found.get(key), wanted.get(key), f"{path}.{key}".lstrip("."))
        return lines
    if found == wanted:
        return []
    return [f"{path} is {_short(found)} there, {_short(wanted)} was asked for"]


def _short(value: Any) -> str:
    """Return a value as text, with a digest of one that is cut short, such as the files of a source."""
    text = repr(value)
    if len(text) <= _LONGEST_SHOWN:
        return text
    short = f"{len(value):,} entries" if isinstance(value, list) else f"{text[:_LONGEST_SHOWN]}..."
    return f"{short} (fingerprint {sha256_hex(text.encode())[:8]})"


def _reject_unexpected_files(folder: DataFolder, plan: BuildPlan) -> None:
    """Refuse a file among the shards that is none, which would be found to be wrong ever after.

    A shard of a split that is not asked for may be of a run that is at work on it.
    """
    planned = {task.shard for task in plan.tasks}
    others = set(plan.split_order) - {shard.split for shard in planned}
    for name in folder.names(DATA_FOLDER):
        shard = ShardName.parse(name)
        if not is_hidden(name) and shard not in planned and (shard is None or shard.split not in others):
            raise InputError(
                f"{folder.address(f'{DATA_FOLDER}/{name}')!r} is not a file of this data set; nothing was "
                "changed",
                next="remove it, or move it away",
            )
