"""A job: what is to be made in a folder, and which of its shards are finished.

The record of a shard is the only state: ``.pending/SHARD.json`` until a run is finished, an entry of the
manifest from then on. A record names its job, so leftovers of another job never count.
"""

from __future__ import annotations

import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import groupby

from tactile_toolkit.errors import InputError, IntegrityError, SpecMismatchError
from tactile_toolkit.store.addresses import open_folder
from tactile_toolkit.store.files import is_hidden
from tactile_toolkit.store.folder import PENDING_FOLDER, DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest, write_manifest
from tactile_toolkit.store.parquet import sha256_hex
from tactile_toolkit.store.pending import pending_records, pending_shards
from tactile_toolkit.store.plan import BuildPlan
from tactile_toolkit.store.run_options import RunOptions
from tactile_toolkit.store.shards import DATA_FOLDER, ShardName, ShardRecord
from tactile_toolkit.store.task import AnyTask
from tactile_toolkit.wording import shortened, with_count

_LONGEST_SHOWN = 200
_DIFFERENCES_SHOWN = 5


class MissingPartsError(IntegrityError):
    """A data set cannot be finished, because shards are missing.

    ``shards`` of ``parts`` shards are missing; ``array`` names the parts that make them, one part a shard, as
    Slurm writes the numbers of an array.
    """

    def __init__(self, where: str, shards: int, parts: int, array: str) -> None:
        which = "parts"
        if array.isdigit():
            which = "part"
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
class BuildJob:
    """A run of a plan in a folder, or of the tasks of one part.

    ``manifest`` is that of the folder, or the one to be created; ``finished`` are the records of intact
    shards, ``remaining`` the tasks of all others.
    """

    folder: DataFolder
    plan: BuildPlan
    manifest: Manifest
    tasks: tuple[AnyTask, ...]
    finished: tuple[ShardRecord, ...] = ()

    @property
    def remaining(self) -> tuple[AnyTask, ...]:
        """Tasks whose shards are missing."""
        finished = {record.shard for record in self.finished}
        return tuple(task for task in self.tasks if task.shard not in finished)


def begin_job(folder: DataFolder, plan: BuildPlan, options: RunOptions) -> BuildJob:
    """Find out what a run has to do in a folder, and create its manifest if there is none.

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
    """Remove records of a job whose manifest was removed, if their files differ from what they state.

    Another set may have been begun on top of them, and removed. From here on only sizes are compared.
    """
    records = pending_records(folder, manifest.identity)
    intact = _intact_records(folder, plan, manifest, {task.shard: task for task in plan.tasks}, check=True)
    for shard in records.keys() - intact.keys():
        folder.remove(shard.record_path)


def inspect_job(folder: DataFolder, plan: BuildPlan, options: RunOptions | None = None) -> BuildJob:
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
    _refuse_difference(folder, found, wanted, plan.other_next)
    _reject_unexpected_files(folder, plan)
    intact = _intact_records(folder, plan, manifest, {task.shard: task for task in tasks}, check)
    job = BuildJob(folder, plan, replace(manifest, trees=plan.extra_dirs), tasks, tuple(intact.values()))
    if job.remaining and manifest.libraries != new.libraries:
        begun = {record.shard for record in manifest.shards}.union(
            pending_shards(folder.names(PENDING_FOLDER))
        )
        if begun - {task.shard for task in job.remaining}:
            _refuse_difference(folder, {"libraries": manifest.libraries}, {"libraries": new.libraries})
        job = replace(job, manifest=new)
    if options.finish:
        require_parts(job, job.finished)
    return job


def require_parts(job: BuildJob, records: Sequence[ShardRecord]) -> None:
    """Raise MissingPartsError where a task of a job has no record."""
    found, shards = {record.shard for record in records}, [task.shard for task in job.plan.tasks]
    wanted = {task.shard for task in job.tasks}
    numbers = [index for index, shard in enumerate(shards) if shard in wanted and shard not in found]
    if numbers:
        raise MissingPartsError(job.folder.address(), len(numbers), len(shards), array_text(numbers))


def require_same_job(folder: DataFolder, identity: str) -> Manifest:
    """Return the manifest of a folder; InputError if it is gone or has another identity by now.

    All data sets of a kind name their shards alike: a slower run would write its rows among those of a run
    that has replaced its set.
    """
    version = folder.version(MANIFEST_FILE)
    manifest = None if version is None else _manifest_of_version(folder.root, version)
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
def _manifest_of_version(root: str, version: object) -> Manifest | None:
    """Read a manifest again only if it has changed: shards follow each other quickly."""
    return read_manifest(open_folder(root))


def _intact_records(
    folder: DataFolder,
    plan: BuildPlan,
    manifest: Manifest,
    tasks: Mapping[ShardName, AnyTask],
    check: bool,
) -> dict[ShardName, ShardRecord]:
    """Return the record of each shard whose files are intact: by size or, to check, by content.

    With ``check``, sources are compared, too. A pending record takes precedence over that of the manifest.
    """
    sizes, report = folder.sizes(DATA_FOLDER), plan.report_file
    has_report = report is not None and folder.exists(report)
    listed = manifest.files.get(report) if report is not None else None  # none while it is written again
    if report is not None and has_report and (check or (listed and folder.is_local)):
        has_report = folder.sha256(report) == listed

    def is_intact(record: ShardRecord, digests: Mapping[str, str | None]) -> bool:
        if not record.is_size_of(sizes):  # first: most damage shows there, and costs no reading
            return False
        try:
            files = plan.files_of(folder, record)
            if not check:
                return all(map(folder.exists, files))
            for path, sha256 in {**digests, **files}.items():
                if sha256 is not None and folder.sha256(path) != sha256:
                    return False
            return tasks[record.shard].source_digest() == record.source_digest
        except (IntegrityError, FileNotFoundError):  # damaged without a change of size, or just removed
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


def refuse_unknown_files(folder: DataFolder, plan: BuildPlan | None = None) -> None:
    """Refuse a folder that has files but no manifest: a run must never mix its files with those of a user.

    If there are records of a run of the plan, the files belong to that run, and its manifest was removed.
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


def _refuse_difference(folder: DataFolder, found: object, wanted: object, next_step: str = "") -> None:
    lines = _differences(found, wanted)
    if lines:
        more = []
        if len(lines) > _DIFFERENCES_SHOWN:
            more = [f"and {len(lines) - _DIFFERENCES_SHOWN:,} more"]
        differing = "; ".join(lines[:_DIFFERENCES_SHOWN] + more)
        raise SpecMismatchError(
            f"{differing}: {folder.address()!r} holds a data set of another "
            "specification, or was begun with other versions, which write other bytes; nothing was changed",
            next=next_step
            or "choose another folder (--out or OUT), or start again there with --overwrite (without "
            "--part and in no object store; there, remove it first), or install those versions",
        )


def _differences(found: object, wanted: object, path: str = "") -> list[str]:
    """State how two JSON values differ, one line for each difference."""
    if isinstance(found, Mapping) and isinstance(wanted, Mapping):
        lines = []
        for key in dict.fromkeys((*found, *wanted)):
            lines += _differences(found.get(key), wanted.get(key), f"{path}.{key}".lstrip("."))
        return lines
    if found == wanted:
        return []
    return [f"{path} is {_short(found)} there, {_short(wanted)} was asked for"]


def _short(value: object) -> str:
    """Return a value as text; a long one, such as the files of a source, is cut and gets a digest."""
    text = repr(value)
    short = shortened(text, _LONGEST_SHOWN)
    if short == text:
        return text
    if isinstance(value, list):
        short = with_count(len(value), "entries")
    return f"{short} (fingerprint {sha256_hex(text.encode())[:8]})"


def _reject_unexpected_files(folder: DataFolder, plan: BuildPlan) -> None:
    """Refuse a stray file in the data folder; `verify` would report it forever.

    A shard of another split may belong to a run that is at work on it.
    """
    planned = {task.shard for task in plan.tasks}
    others = set(plan.split_order) - {shard.split for shard in planned}
    for name in folder.names(DATA_FOLDER):
        shard = ShardName.parse(name)
        if not is_hidden(name) and shard not in planned and (shard is None or shard.split not in others):
            raise InputError(
                f"{folder.address(f'{DATA_FOLDER}/{name}')!r} is not a file of this data set; nothing was "
                "changed",
                next="move it to another folder",
            )
