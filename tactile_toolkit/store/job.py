"""A job: the plan of a data set, the options of a run, and which of its shards are finished in a folder.

The record of a shard is the only state: ``.pending/SHARD.json`` until a run is finished, an entry of the
manifest from then on. A record names its job, so leftovers of another job never count.
"""

from __future__ import annotations

import hashlib
import json
import re
import socket
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.metadata import version
from itertools import groupby
from typing import Any, TypedDict

import pyarrow as pa

from tactile_toolkit import __version__, errors, run, wording
from tactile_toolkit.store.files import is_hidden
from tactile_toolkit.store.folder import PENDING_FOLDER, TEMPORARY, DataFolder
from tactile_toolkit.store.manifest import (
    DATA_FOLDER,
    MANIFEST_FILE,
    Manifest,
    ShardName,
    ShardRecord,
    Skipped,
    begun_records,
    pending_records,
    pending_shards,
    read_manifest,
    write_manifest,
)
from tactile_toolkit.store.parquet import ParquetStyle
from tactile_toolkit.value_types import JsonObject

_LONGEST_SHOWN = 200
_DIFFERENCES_SHOWN = 5
_SHARD = r"\w+-[0-9]{5,12}-of-[0-9]{5,12}"
is_pending = re.compile(
    rf"{PENDING_FOLDER}/(?:{TEMPORARY}|{_SHARD}[.]json|report-{_SHARD}[.]parquet)"
).fullmatch
"""Matches the path of a record, of report rows or of a temporary file of a run."""


@dataclass(frozen=True)
class ShardContent:
    """The rows of one shard, an Arrow table.

    ``skipped`` are items that gave no row; ``report`` rows are merged over all shards into the plan's
    ``report_file``; ``statistics`` are JSON values for the manifest that add up over shards. ``files`` are
    written next to the rows, by path. ``encoded`` are the bytes of a shard that is copied unchanged.
    ``source_digest`` is the result of the task's ``digest`` for what was read.
    """

    table: pa.Table
    skipped: tuple[Skipped, ...] = ()
    report: pa.Table | None = None
    statistics: JsonObject | None = None
    files: Mapping[str, bytes] = field(default_factory=dict)
    encoded: bytes | None = None
    source_digest: str | None = None


@dataclass(frozen=True, eq=False)
class ShardTask:
    """A small picklable value from which any process makes the same rows of one shard.

    Parameters
    ----------
    shard : ShardName
        Which shard it makes.
    items : sequence
        What the rows are made of; may be a view of all items of a split, of which only these are pickled.
    function : callable
        Takes shard and items and returns the content. It is picklable, touches no file of the data set
        folder, and refuses a source that was replaced after the task was planned.
    digest : callable, optional
        Takes the items and returns the SHA-256 of everything that is read for them and that the specification
        does not identify, such as files of which it holds only names and sizes; ``--repair`` compares it.
    """

    shard: ShardName
    items: Sequence[Any] = field(repr=False)
    function: Callable[[ShardName, Sequence[Any]], ShardContent] = field(repr=False)
    digest: Callable[[Sequence[Any]], str] | None = field(default=None, repr=False)

    @property
    def size(self) -> int:
        """Number of items, for the progress bar."""
        return len(self.items)

    def make(self) -> ShardContent:
        """Make the rows."""
        return self.function(self.shard, self.items)

    def source_digest(self) -> str | None:
        """Return the digest of the present source; None if the specification identifies all of it."""
        return None if self.digest is None else self.digest(self.items)


@dataclass(frozen=True)
class BuildPlan:
    """The plan of a folder: one task for each shard, and the specification that they follow from.

    Parameters
    ----------
    kind : str
        Kind of data set, such as ``"mnist3d"``.
    spec : mapping
        Full specification as JSON values; plans with equal ``spec`` give equal rows.
    split_order : tuple of str
        Canonical order of the splits of this kind.
    tasks : tuple of ShardTask
        One for each shard of the requested splits.
    style : ParquetStyle
        Layout of the shards.
    report_file : str or None
        Path of the merged report, if shards have reports.
    extra_dirs : tuple of str
        Sub-folders or files next to the rows that belong to the data set, such as the ``files`` of tasks.
    files_of : callable
        Takes the folder and the path of a finished shard, and returns the checksum of each of its ``files``
        by path.
    libraries : tuple of str
        Distributions whose versions can change the bytes of shards.
    write_files : callable
        Writes files that follow from all rows, such as an index, after all shards; takes the folder and the
        manifest, and returns the checksum of each file by path.
    other_next : str
        Next step if the folder holds a data set of another specification, in place of the usual one.
    """

    kind: str
    spec: JsonObject
    split_order: tuple[str, ...]
    tasks: tuple[ShardTask, ...]
    style: ParquetStyle
    report_file: str | None = None
    extra_dirs: tuple[str, ...] = ()
    files_of: Callable[[DataFolder, str], Mapping[str, str]] = field(
        default=lambda _folder, _path: {}, repr=False
    )
    libraries: tuple[str, ...] = ()
    write_files: Callable[[DataFolder, Manifest], Mapping[str, str]] = field(
        default=lambda _folder, _manifest: {}, repr=False
    )
    other_next: str = ""

    def __post_init__(self) -> None:
        # Stored as in a manifest: in JSON, tuples are lists.
        text = json.dumps(self.spec, ensure_ascii=False)
        object.__setattr__(self, "spec", json.loads(text))
        try:
            text.encode()
        except UnicodeEncodeError as error:
            name = text[text.rfind('"', 0, error.start) : text.find('"', error.end) + 1]
            raise errors.InputError(
                f"the name {name} is not valid UTF-8, so that no specification can hold it",
                next="rename that file or folder",
            ) from error
        splits: dict[str, str] = {}
        for shard in (task.shard for task in self.tasks):
            first = splits.setdefault(shard.split.casefold(), shard.split)
            if first != shard.split or not shard.can_be_read_back:
                raise errors.InputError(
                    f"the file of shard {shard} would not be found again; expected a split of letters, "
                    "digits and underscores that does not differ from another only in case, and an index "
                    "below the count; nothing was changed",
                    next="rename the split",
                )

    def new_manifest(self) -> Manifest:
        """Return the manifest of a folder in which no shard is finished."""
        return Manifest(
            self.kind,
            __version__,
            self.spec,
            self.split_order,
            planned=Counter(task.shard.split for task in self.tasks),
            trees=self.extra_dirs,
            libraries={name: version(name) for name in self.libraries},
        )

    def compared_with(self, folder: DataFolder, options: RunOptions | None = None) -> BuildJob:
        """Compare a folder with the plan, or with the tasks of a part, and change nothing.

        Raises SpecMismatchError when the folder is made by another specification, or by libraries that write
        other bytes (the message states the differences), InputError when it holds something else, and
        MissingPartsError where shards are missing that ``finish`` needs.
        """
        return _compare(folder, self, options or RunOptions(), read_manifest(folder))


@dataclass(frozen=True)
class Progress:
    """Reported once before the work and after each shard: items done, and items to do in this run."""

    done: int
    total: int
    record: ShardRecord | None = None


class RunKeywords(TypedDict, total=False):
    """The fields of :class:`RunOptions`, as keywords of all functions that make a data set folder."""

    workers: int | run.Runner
    part: run.Part | str | None
    finish: bool
    check: bool
    overwrite: bool
    on_progress: Callable[[Progress], None]


@dataclass(frozen=True)
class RunOptions:
    """Options of a run; none of them changes a row.

    Attributes
    ----------
    workers : int or Runner
        Number of local processes, or another runner.
    part : Part, str or None
        Make only the shards of this part, ``"K/N"`` or ``"auto"``; do not finish the data set.
    finish : bool
        Make no shard: complete the data set that parts have made, or name the missing shards.
    check : bool
        Read all finished shards and make damaged ones again; otherwise records and sizes are trusted.
    overwrite : bool
        Replace another data set of this toolkit in the folder.
    on_progress : callable
        Called with the :class:`Progress` before the work and after each shard.

    Raises
    ------
    InputError
        Options that exclude each other, or a part that does not exist.
    """

    workers: int | run.Runner = 1
    part: run.Part | str | None = None
    finish: bool = False
    check: bool = False
    overwrite: bool = False
    on_progress: Callable[[Progress], None] = lambda _: None

    def __post_init__(self) -> None:
        if isinstance(self.part, str):
            object.__setattr__(self, "part", run.Part.parse(self.part))
        if self.part is not None and self.finish:
            raise errors.InputError(
                "was given with --finish; expected --finish when all parts have ended", field="part"
            )
        if self.overwrite and not self.is_whole:
            raise errors.InputError(
                "was given with --part or --finish: each part would remove what the others made; nothing was "
                "changed",
                next="leave it out and choose another folder (--out or OUT)",
                field="overwrite",
            )

    @property
    def is_whole(self) -> bool:
        """Whether this run makes all shards."""
        return self.part is None and not self.finish


class MissingPartsError(errors.IntegrityError):
    """A data set cannot be finished, because shards are missing.

    ``shards`` of ``parts`` shards are missing; ``array`` names the parts that make them, one part a shard, as
    Slurm writes the numbers of an array.
    """

    def __init__(self, address: str, shards: int, parts: int, array: str) -> None:
        which = "part" if array.isdigit() else "parts"
        super().__init__(
            f"{shards:,} of {parts:,} shards of {address!r} are not finished, or a node writes to a folder "
            f"that this machine does not see; they are those of {which} {array} of {parts:,}",
            next=f"give these (--part auto/{parts}; Slurm: --array={array}), then --finish, or run the same "
            "command without --finish, on a folder that all nodes share, or s3://BUCKET/PATH",
        )
        self.shards, self.parts, self.array = shards, parts, array
        self.args = (address, shards, parts, array)  # by which it crosses process borders


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
    tasks: tuple[ShardTask, ...]
    finished: tuple[ShardRecord, ...] = ()

    @property
    def remaining(self) -> tuple[ShardTask, ...]:
        """Tasks whose shards are missing."""
        finished = {record.shard for record in self.finished}
        return tuple(task for task in self.tasks if task.shard not in finished)


def begin_job(folder: DataFolder, plan: BuildPlan, options: RunOptions) -> BuildJob:
    """Find out what a run has to do in a folder, and create its manifest if there is none.

    Raises as :meth:`BuildPlan.compared_with`.
    """
    current = read_manifest(folder)
    while True:
        job = _compare(folder, plan, options, current)
        if current is None and job.tasks:
            _remove_outdated_records(folder, plan, job.manifest)
            folder.create_bytes(MANIFEST_FILE, job.manifest.to_json().encode())
            current = read_manifest(folder)
            if current != job.manifest:
                continue  # another run was faster
        elif current is not None and current.identity != job.manifest.identity:
            write_manifest(folder, job.manifest)  # of other versions, and none of its shards is left
        return job


def _remove_outdated_records(folder: DataFolder, plan: BuildPlan, manifest: Manifest) -> None:
    """Remove records of a job whose manifest was removed, if their files differ from what they state.

    Another set may have been begun on top of them, and removed. From here on only sizes are compared.
    """
    records = pending_records(folder, manifest.identity)
    if records:
        tasks = {task.shard: task for task in plan.tasks}
        sizes = folder.entries(DATA_FOLDER)
        intact = _intact_records(folder, plan, manifest, sizes, tasks, check=True)
        for shard in records.keys() - intact.keys():
            folder.remove(shard.record_path)


def _compare(folder: DataFolder, plan: BuildPlan, options: RunOptions, manifest: Manifest | None) -> BuildJob:
    """Compare a folder, which has this manifest, with a plan; raises as :meth:`BuildPlan.compared_with`."""
    new = plan.new_manifest()
    check = options.check
    tasks = plan.tasks
    if isinstance(options.part, run.Part):
        tasks = tuple(options.part.of(plan.tasks))
    if manifest is None:
        refuse_unknown_files(folder, plan)
        manifest = new
        check = True  # as in `_remove_outdated_records`
    else:
        stored, requested = (
            {"kind": side.kind, **side.spec, "toolkit_version": side.toolkit_version}
            for side in (manifest, new)
        )
        _refuse_difference(folder, stored, requested, plan.other_next)
    sizes = folder.entries(DATA_FOLDER)
    _reject_unexpected_files(folder, plan, sizes)
    intact = _intact_records(folder, plan, manifest, sizes, {task.shard: task for task in tasks}, check)
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
    finished = {record.shard for record in records}
    shards = [task.shard for task in job.plan.tasks]
    required = {task.shard for task in job.tasks}
    numbers = [index for index, shard in enumerate(shards) if shard in required and shard not in finished]
    if numbers:
        raise MissingPartsError(job.folder.address(), len(numbers), len(shards), array_text(numbers))


def require_same_job(folder: DataFolder, identity: str) -> Manifest:
    """Return the manifest of a folder; InputError if it is gone or has another identity by now.

    All data sets of a kind name their shards alike: a slower run would write its rows among those of a run
    that has replaced its set.
    """
    version = folder.version(MANIFEST_FILE)
    manifest = None
    if version is not None:
        manifest = _manifest_of_version(folder, version)  # type: ignore[arg-type]  # folders are frozen
    if (manifest is None or manifest.identity != identity) and folder.exists():
        folder.refresh("")  # a network file system may have shown an earlier state
        manifest = read_manifest(folder)
    if manifest is None or manifest.identity != identity:
        raise errors.InputError(
            f"the data set in {folder.address()!r} was removed or replaced while this run was at work, or "
            f"node {socket.gethostname()} writes to a folder that this machine does not see; the run has "
            "stopped and changed nothing in the folder",
            next="look there with the command `info`, then run the same command again, in a folder that "
            "all nodes share, or choose another one (--out or OUT)",
        )
    return manifest


@lru_cache(maxsize=1)
def _manifest_of_version(folder: DataFolder, version: object) -> Manifest | None:
    """Read a manifest again only if it has changed: shards follow each other quickly."""
    return read_manifest(folder)


def _intact_records(
    folder: DataFolder,
    plan: BuildPlan,
    manifest: Manifest,
    sizes: Mapping[str, int | None],
    tasks: Mapping[ShardName, ShardTask],
    check: bool,
) -> dict[ShardName, ShardRecord]:
    """Return the record of each shard whose files are intact: by size or, to check, by content.

    ``sizes`` are the entries of the data folder. With ``check``, sources are compared, too. A pending record
    takes precedence over that of the manifest.
    """
    if not sizes:
        return {}
    report = plan.report_file
    has_report = report is not None and folder.exists(report)
    listed = manifest.files.get(report) if report is not None else None  # none while it is written again
    if report is not None and has_report and (check or (listed and folder.is_local)):
        has_report = folder.sha256(report) == listed

    def is_intact(record: ShardRecord, digests: Mapping[str, str | None]) -> bool:
        if not record.is_size_of(sizes):  # first: most damage shows there, and costs no reading
            return False
        try:
            files = plan.files_of(folder, record.file)
            if not check:
                return all(map(folder.exists, files))
            for path, sha256 in {**digests, **files}.items():
                if sha256 is not None and folder.sha256(path) != sha256:
                    return False
            return tasks[record.shard].source_digest() == record.source_digest
        except (errors.IntegrityError, FileNotFoundError):
            return False  # damaged without a change of size, or just removed

    intact = {}
    for record in manifest.shards:
        needs_report = record.rows and record.report_sha256
        is_wanted = record.shard in tasks and (has_report or not needs_report)
        if is_wanted and is_intact(record, {record.file: record.sha256}):
            intact[record.shard] = record
    for shard, record in pending_records(folder, manifest.identity, tasks.__contains__).items():
        if is_intact(record, {record.file: record.sha256, shard.report_path: record.report_sha256}):
            intact[shard] = record
    return intact


def refuse_unknown_files(folder: DataFolder, plan: BuildPlan | None = None) -> None:
    """Refuse a folder that has files but no manifest: a run must never mix its files with those of a user.

    If there are records of a run of the plan, the files belong to that run, and its manifest was removed.
    """
    unknown = [name for name in folder.names() if not is_hidden(name)]
    if not unknown or MANIFEST_FILE in unknown:  # another run may have begun at this moment
        return
    if plan is None or not pending_records(folder, plan.new_manifest().identity):
        raise errors.InputError(
            f"{folder.address()!r} is not empty and holds no {MANIFEST_FILE} (found {unknown[0]!r}); nothing "
            "was changed",
            next="choose an empty or new folder (--out or OUT)",
        )


def _refuse_difference(folder: DataFolder, stored: object, requested: object, next_step: str = "") -> None:
    lines = _differences(stored, requested)
    if lines:
        more = f"; and {len(lines) - _DIFFERENCES_SHOWN:,} more" if len(lines) > _DIFFERENCES_SHOWN else ""
        raise errors.SpecMismatchError(
            f"{'; '.join(lines[:_DIFFERENCES_SHOWN])}{more}: {folder.address()!r} holds a data set of "
            "another specification, or was begun with other versions, which write other bytes; nothing "
            "was changed",
            next=next_step
            or "choose another folder (--out or OUT), or start again there with --overwrite (without "
            "--part and in no object store; there, remove it first), or install those versions",
        )


def _differences(stored: object, requested: object, path: str = "") -> list[str]:
    """State how two JSON values differ, one line for each difference."""
    if isinstance(stored, Mapping) and isinstance(requested, Mapping):
        lines = []
        for key in dict.fromkeys((*stored, *requested)):
            lines += _differences(stored.get(key), requested.get(key), f"{path}.{key}".lstrip("."))
        return lines
    if stored == requested:
        return []
    return [f"{path} is {_short(stored)} there, {_short(requested)} was asked for"]


def _short(value: object) -> str:
    """Return a value as text; a long one, such as the files of a source, is cut and gets a digest."""
    text = repr(value)
    short = wording.shortened(text, _LONGEST_SHOWN)
    if short == text:
        return text
    if isinstance(value, list):
        short = wording.with_count(len(value), "entries")
    return f"{short} (fingerprint {hashlib.sha256(text.encode()).hexdigest()[:8]})"


def _reject_unexpected_files(folder: DataFolder, plan: BuildPlan, names: Iterable[str]) -> None:
    """Refuse a stray file in the data folder; `verify` would report it forever.

    A shard of another split may belong to a run that is at work on it.
    """
    shards = {task.shard for task in plan.tasks}
    others = set(plan.split_order) - {shard.split for shard in shards}
    for name in names:
        shard = ShardName.parse(name)
        if not is_hidden(name) and shard not in shards and (shard is None or shard.split not in others):
            raise errors.InputError(
                f"{folder.address(f'{DATA_FOLDER}/{name}')!r} is not a file of this data set; nothing was "
                "changed",
                next="move it to another folder",
            )


def remove_leftovers(folder: DataFolder, manifest: Manifest) -> None:
    """Remove what a finished set does not need: its pending records and temporary files.

    Records of another split stay until that is finished.
    """
    shards = [record.shard for record in begun_records(folder, manifest)]
    kept = {path for shard in shards for path in (shard.record_path, shard.report_path)}
    remove_pending(folder, kept)


def remove_pending(folder: DataFolder, kept: Collection[str] = ()) -> None:
    """Remove all pending records, report rows and temporary files but those to be kept."""
    folder.remove_temporaries()
    paths = [f"{PENDING_FOLDER}/{name}" for name in folder.names(PENDING_FOLDER)]
    for path in filter(is_pending, paths):
        if path not in kept:
            folder.remove(path)
    folder.remove_empty(PENDING_FOLDER)
