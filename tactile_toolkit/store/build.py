"""Making a data set folder: begin, work, finish. The order of effects is what makes it safe.

begin   creates the manifest (complete: false, no shards) if there is none, and reads back whose it is
work    makes a shard; then, under the shared lock: still our job? rows, report rows, files, record
finish  under the lock: every task has its record; report, small columns, further files, card, manifest

The kinds of data bring a :class:`~tactile_toolkit.store.job.BuildPlan`. What is interrupted continues when
the same is asked for again: a task whose record is true is done.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from tactile_toolkit.errors import InputError, IntegrityError, StorageError, ToolkitError
from tactile_toolkit.run.processes import Check, Finish, Part, Runner
from tactile_toolkit.store.derived import merge_reports, write_small_columns
from tactile_toolkit.store.folder import PENDING_FOLDER, DataFolder
from tactile_toolkit.store.job import (
    BuildPlan,
    Job,
    ShardTask,
    State,
    begin,
    look,
    manifest_so_far,
    pending_records,
    require_parts,
    tidy,
    write_record,
)
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest, write_manifest
from tactile_toolkit.store.overwrite import make_room, promote, require_replaceable, settle
from tactile_toolkit.store.parquet import REPORT_STYLE, ParquetStyle, encode_parquet, sha256_hex
from tactile_toolkit.store.shards import DAMAGED, DATA_FOLDER, ShardRecord

_CAUSES_SHOWN = 3
_PATIENCE_S = 60.0
"""How long a run waits to begin where others write; one that was stopped (Ctrl-Z) holds its lock for good."""
_START_S = 1.5
"""What workers need to start and import their libraries."""

WriteCard = Callable[[DataFolder, Manifest], None]
"""Writes the card of a finished folder, whose report is there by then."""


@dataclass(frozen=True)
class Progress:
    """Passed on once before the work and after each shard: items done and to do in this run."""

    done: int
    total: int
    record: ShardRecord | None = None


@dataclass(frozen=True)
class _WriteShard:
    """Picklable: make one shard, unless others have finished it meanwhile, and write it with its record."""

    job: Job
    style: ParquetStyle = field(repr=False)
    libraries: tuple[str, ...]
    begun: tuple[object, ...] | None = None
    """The version of the manifest when the run began: what it listed then is to be made again."""

    def __call__(self, task: ShardTask) -> ShardRecord:
        """Write rows, then report rows, then further files, then the record that proves them all."""
        folder, shard = self.job.folder, task.shard
        content = task.make()
        data = encode_parquet(content.table, self.style) if content.encoded is None else content.encoded
        report = None if content.report is None else encode_parquet(content.report, REPORT_STYLE)
        record = ShardRecord.of(
            shard,
            len(content.table),
            len(data),
            sha256_hex(data),
            report_sha256=None if report is None else sha256_hex(report),
            skipped=content.skipped,
            statistics=content.statistics,
            unpacked_bytes=content.table.nbytes,
        )
        # As late as can be: hours may have passed, and what is there now may be of another data set.
        with folder.locked(shared=True):
            listed = self.job.require().shards
            is_new = folder.version(MANIFEST_FILE) != self.begun
            if is_new and record in listed and record.is_size_of(folder.sizes(DATA_FOLDER)):
                return record  # others have finished the set meanwhile
            folder.write_bytes(shard.data_path, data)
            if report is not None:
                folder.write_bytes(shard.report_path, report)
            for path, further in content.files.items():
                folder.write_bytes(path, further)
            write_record(folder, record, self.job.of, None if report is None else len(report))
        return record


def build(
    folder: DataFolder,
    plan: BuildPlan,
    runner: Runner,
    *,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] = lambda _: None,
    write_card: WriteCard | None = None,
) -> Manifest:
    """Make what is missing in the folder of the plan and return the manifest.

    A run that fails keeps the shards that it finished; one that finished none leaves the folder as it was.
    With ``overwrite``, the former data set stays until all of the new one is there.

    With a :class:`~tactile_toolkit.run.processes.Part` for a runner, only its tasks are made: no report or
    card is written, and nothing of others is removed. :class:`~tactile_toolkit.run.processes.Finish` writes
    those, from what all parts have made. :class:`~tactile_toolkit.run.processes.Check` around any runner
    trusts no size: all that is finished is read.

    Raises
    ------
    SpecMismatchError
        The folder holds a data set of another specification, and ``overwrite`` is False.
    InputError
        The folder holds files that are not a data set of this toolkit.
    InputError, IntegrityError
        Every item was left out, IntegrityError where all are damaged; the folder is as it was.
    InputError
        Another run is at work in the folder and lets nothing be begun, or has replaced the data set
        meanwhile; nothing of what is there now was changed. Or what would be written is a symbolic link.
    MissingPartsError
        The set cannot be finished yet, or the runner has not made all shards; those that it made stay.
    StorageError
        The folder cannot be written, or the disk is full. Finished shards stay.
    """
    kind = runner.workers if isinstance(runner, Check) else runner
    is_part, is_undone = isinstance(kind, Part), not isinstance(kind, (Part, Finish))
    if overwrite:
        _refuse_overwriting(folder, kind)
    existed = folder.exists()
    if isinstance(kind, Finish) and not folder.names():
        raise InputError(
            f"{folder.missing_message('data set')}; nothing can be finished",
            next="make its parts with --part",
        )
    folder.require_folder()
    target, had_manifest = folder, True
    try:
        settle(folder, _PATIENCE_S)
        # Parts begin as they write shards: of many at once, one would never find the folder free.
        with folder.locked(shared=is_part, patience_s=_PATIENCE_S):
            if overwrite and require_replaceable(folder):
                target, existed = make_room(folder, plan), False
            had_manifest = target.exists(MANIFEST_FILE)
            job, state = begin(target, plan, runner)
        # By names and sizes alone; manifests are written last.
        is_finished = not state.todo and state.manifest.complete and not folder.names(PENDING_FOLDER)
        if is_finished and not folder.is_local and not isinstance(runner, Check):
            return state.manifest
        records = [*state.kept, *_work(job, plan, runner, state, on_progress)]
        if is_part:
            return _end_part(folder, plan, job, state, records)
        with folder.locked():
            there = job.require()
            _require_records(target, plan, state, records)
            manifest = _finish(target, plan, there, state.manifest, records, write_card)
            if target is not folder:
                promote(folder)
        return manifest
    except BaseException:
        # What ended the run is what is reported, even where the disk does not let us tidy up.
        if is_undone:
            with contextlib.suppress(ToolkitError, OSError), folder.locked(patience_s=_PATIENCE_S):
                _undo(target, plan, had_manifest)
                if not existed:
                    target.remove_empty("")
        raise


def _work(
    job: Job, plan: BuildPlan, runner: Runner, state: State, on_progress: Callable[[Progress], None]
) -> Iterator[ShardRecord]:
    sizes = {task.shard: task.size for task in state.todo}
    done, total = 0, sum(sizes.values())
    on_progress(Progress(done, total))
    work = _WriteShard(job, plan.style, plan.libraries, job.folder.version(MANIFEST_FILE))
    for record in runner.run(work, state.todo):
        done += sizes[record.shard]
        on_progress(Progress(done, total, record))
        yield record


def _end_part(
    folder: DataFolder, plan: BuildPlan, job: Job, state: State, records: Sequence[ShardRecord]
) -> Manifest:
    """Return what the manifest would hold of a part, or that of a set that others have finished meanwhile."""
    if state.todo:
        there = job.require()
        listed = {record.shard for record in there.shards}
        if there.complete and all(task.shard in listed for task in state.tasks):
            with folder.locked():
                tidy(folder, job.require())
            return there
    _require_records(folder, plan, state, records)
    return replace(state.manifest.with_shards(records), complete=False)


def _finish(
    folder: DataFolder,
    plan: BuildPlan,
    there: Manifest,
    planned: Manifest,
    records: Sequence[ShardRecord],
    write_card: WriteCard | None,
) -> Manifest:
    """Write report, further files, card and, last, the manifest of a set whose shards are all there.

    The caller holds the lock.
    """
    _require_rows(records)
    # Other splits may have been finished meanwhile.
    manifest = replace(planned, shards=there.shards, files=there.files).with_shards(records)
    files = dict(manifest.files)
    if there.shards and there.shards != manifest.shards:
        # The report below is of all splits, and no longer what the manifest of some states.
        others = {path: checksum for path, checksum in files.items() if path != plan.report_file}
        write_manifest(folder, replace(there, complete=False, files=others))
    if plan.report_file is not None:
        checksum = merge_reports(folder, plan.report_file, manifest)
        files |= {plan.report_file: checksum} if checksum is not None else {}
    files |= write_small_columns(folder, manifest)
    files |= plan.write_files(folder, manifest)
    finished = replace(manifest, files=files, complete=True)
    if write_card is not None:
        write_card(folder, finished)
    # A run that had nothing to do leaves the file as it is, with its time.
    if there != finished:
        write_manifest(folder, finished)
        if read_manifest(folder) != finished:
            raise StorageError(
                f"{folder.address(MANIFEST_FILE)!r} is not what was written there a moment ago",
                next="run the same command again, and check the disk",
            )
    tidy(folder, finished)
    return finished


def _undo(folder: DataFolder, plan: BuildPlan, had_manifest: bool) -> None:
    """Undo a run that failed and of which no row is there.

    A run that cannot be finished (scenes that do not fit, an unreadable source) would otherwise leave a
    folder that holds nothing and refuses every other specification.
    """
    manifest = read_manifest(folder)
    if manifest is None or manifest.identity != plan.new_manifest().identity:
        return
    made = pending_records(folder, manifest.identity)
    for record in manifest.shards:
        made.pop(record.shard, None)
    if any(record.rows for record in made.values()):
        return
    # A shard from which all was left out is made again in no time.
    for shard in made:
        for path in (shard.record_path, shard.report_path, shard.data_path):
            folder.remove(path)
    folder.remove_empty(DATA_FOLDER)
    if not had_manifest and not folder.names(DATA_FOLDER):
        folder.remove(MANIFEST_FILE)
        folder.remove_tree(PENDING_FOLDER)
    folder.remove_empty(PENDING_FOLDER)


def _require_records(
    folder: DataFolder, plan: BuildPlan, state: State, records: Sequence[ShardRecord]
) -> None:
    """Refuse to continue where a task has no record, or this machine does not see what a record is of."""
    folder.refresh(DATA_FOLDER)
    sizes = folder.sizes(DATA_FOLDER)
    found = {record.shard for record in records if record.is_size_of(sizes)}
    require_parts(folder, plan, {task.shard for task in state.tasks} - found)


def _require_rows(records: Sequence[ShardRecord]) -> None:
    """Refuse a run that left every item out: its source, not its items, is what is wrong."""
    skipped = [item for record in records for item in record.skipped]
    if skipped and not any(record.rows for record in records):
        first = {item.reason: item.message for item in reversed(skipped)}
        causes = [f"{reason}: {first[reason]}" for reason in dict.fromkeys(item.reason for item in skipped)]
        raise (IntegrityError if set(first) == {DAMAGED} else InputError)(
            f"no row is left: all {len(skipped):,} were left out, nothing was written; the first of each "
            f"reason: {'; '.join(causes[:_CAUSES_SHOWN])}",
            next="correct the source, or choose another one",
        )


def _refuse_overwriting(folder: DataFolder, runner: Runner | int) -> None:
    """Raise InputError for what makes or ends parts: one must not remove what the others made."""
    if isinstance(runner, (Part, Finish)):
        raise InputError(
            "--overwrite was given with --part or --finish: each part would remove what the others made; "
            "nothing was changed",
            next=f"remove {folder.address()!r} first, or choose another folder (--out or OUT)",
        )


def look_for(folder: DataFolder, plan: BuildPlan, workers: int | Runner, *, overwrite: bool = False) -> State:
    """Return what a folder holds of the tasks of a run; raises where the run would be refused."""
    if not overwrite:
        return look(folder, plan, workers)
    _refuse_overwriting(folder, workers.workers if isinstance(workers, Check) else workers)
    require_replaceable(folder)
    return State(plan.new_manifest(), plan.tasks, (), plan.tasks)


@dataclass(frozen=True, slots=True)
class Sample:
    """What a few rows took: how many were made, and bytes and seconds of one."""

    rows: int
    row_bytes: float
    row_s: float


@dataclass(frozen=True, slots=True)
class SplitForecast:
    """One split: its rows and shards, and how many rows are finished already."""

    split: str
    rows: int
    shards: int
    finished: int


@dataclass(frozen=True, slots=True)
class Forecast:
    """What a run would do.

    ``bytes`` of Parquet and ``seconds`` are estimated from ``sampled`` rows that were made. ``replaced`` are
    the rows of each split of the data set that the run would replace; None where it would replace none.
    """

    splits: tuple[SplitForecast, ...]
    rows_to_make: int
    bytes: int
    seconds: float
    sampled: int
    replaced: dict[str, int] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


def forecast_build(
    out: str | os.PathLike[str],
    plan: BuildPlan,
    workers: int | Runner,
    measure: Callable[[], Sample],
    *,
    overwrite: bool = False,
) -> Forecast:
    """Estimate a run from what a folder holds of its plan and from a few rows, which ``measure`` makes.

    Of a :class:`~tactile_toolkit.run.processes.Part`, the shards of that part count. Writes nothing. Raises
    InputError when the run would be refused in that folder, and MissingPartsError where a
    :class:`~tactile_toolkit.run.processes.Finish` would.
    """
    folder = DataFolder(os.fspath(out))
    state = look_for(folder, plan, workers, overwrite=overwrite)
    entries = []
    for split in dict.fromkeys(task.shard.split for task in state.tasks):
        sizes = [task.size for task in state.tasks if task.shard.split == split]
        todo = sum(task.size for task in state.todo if task.shard.split == split)
        entries.append(SplitForecast(split, sum(sizes), len(sizes), sum(sizes) - todo))
    left, sample = sum(task.size for task in state.todo), measure()
    while not isinstance(workers, int):
        workers = getattr(workers, "workers", 1)
    processes = workers or os.cpu_count() or 1  # all cores where a runner leaves that open
    seconds = left * sample.row_s / processes + (_START_S if left else 0)
    return Forecast(
        tuple(entries),
        left,
        round(left * sample.row_bytes),
        round(seconds, 1),
        sample.rows,
        _rows_there(folder) if overwrite else None,
    )


def _rows_there(folder: DataFolder) -> dict[str, int] | None:
    """Return the rows of each split of a data set; empty where its manifest cannot be read, None without."""
    try:
        manifest = manifest_so_far(folder)
    except IntegrityError:
        return {}
    return None if manifest is None else {name: row["rows"] for name, row in manifest.split_table().items()}
