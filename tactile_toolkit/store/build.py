"""Making a data set folder: begin, work, finish. The order of effects is what makes it safe.

begin   creates the manifest (complete: false, no shards) if there is none, and reads back whose it is
work    makes a shard; then, under the shared lock: still our job? rows, report rows, files, record
finish  under the lock: every task has its record; report, small columns, further files, card, manifest

The kinds of data bring a :class:`~tactile_toolkit.store.plan.BuildPlan`. What is interrupted continues when
the same is asked for again: a task whose record is true is done.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

from tactile_toolkit.errors import InputError, IntegrityError, StorageError, ToolkitError
from tactile_toolkit.run.parts import Check, Finish, Part
from tactile_toolkit.run.processes import Runner, runner_for
from tactile_toolkit.store.files import named_failures
from tactile_toolkit.store.folder import PENDING_FOLDER, DataFolder
from tactile_toolkit.store.job import Job, State, begin, look, pending_records, tidy, write_record
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest, write_manifest
from tactile_toolkit.store.overwrite import make_room, promote, require_replaceable, settle
from tactile_toolkit.store.parquet import (
    REPORT_STYLE,
    ParquetStyle,
    encode_parquet,
    open_checked,
    sha256_hex,
    unpacked_bytes,
    write_parquet,
)
from tactile_toolkit.store.plan import BuildPlan, ShardTask
from tactile_toolkit.store.reports import merge_reports
from tactile_toolkit.store.shards import DAMAGED, DATA_FOLDER, ShardRecord
from tactile_toolkit.store.small_columns import write_small_columns

_CAUSES_SHOWN = 3
_PATIENCE_S = 60.0
"""How long a run waits to begin where others write; one that was stopped (Ctrl-Z) holds its lock for good."""

WriteCard = Callable[[DataFolder, Manifest], None]
"""Writes the card of a finished folder, whose report is there by then."""


@dataclass(frozen=True)
class Progress:
    """Passed on once before the work and after each shard: items done and to do in this run."""

    done: int
    total: int
    record: ShardRecord | None = None


class MissingPartsError(IntegrityError):
    """Parts of a data set that cannot be finished yet.

    ``shards`` is how many are missing of ``parts`` in all; ``array`` are the parts that make them, one a
    shard, as Slurm writes numbers of an array.
    """

    def __init__(self, where: str, shards: int, parts: int, array: str) -> None:
        which = "part" if array.isdigit() else "parts"
        super().__init__(
            f"{shards:,} of {parts:,} shards of {where!r} are not finished; they are those of {which} "
            f"{array} of {parts:,}",
            next=f"give these (--part auto/{parts}; Slurm: --array={array}), then --finish, or run the same "
            "command without --finish",
        )
        self.shards, self.parts, self.array = shards, parts, array
        self.args = (where, shards, parts, array)  # by which it crosses process borders


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
        table = content.table
        if content.encoded is None:
            data, footer = write_parquet(table, self.style)
        else:
            data, footer = content.encoded, open_checked(io.BytesIO(content.encoded)).metadata
        report = None if content.report is None else encode_parquet(content.report, REPORT_STYLE)
        record = ShardRecord(
            shard,
            table.num_rows,
            len(data),
            sha256_hex(data),
            None if report is None else sha256_hex(report),
            content.skipped,
            content.statistics,
            unpacked_bytes(footer, table.schema, lambda _: table),
        )
        # As late as can be: hours may have passed, and what is there now may be of another data set.
        with folder.locked(shared=True):
            if self.job.require().get(shard) == record and folder.version(MANIFEST_FILE) != self.begun:
                with contextlib.suppress(FileNotFoundError):
                    if folder.size_bytes(shard.data_path) == record.bytes:
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
    """Make what the folder lacks of the plan and return the manifest.

    A run that fails keeps the shards that it finished; one that finished none leaves the folder as it was.
    With ``overwrite``, the former data set stays until all of the new one is there.

    With a :class:`~tactile_toolkit.run.parts.Part` for a runner, only its tasks are made: no report or card
    is written, and nothing of others is removed. :class:`~tactile_toolkit.run.parts.Finish` writes those,
    from what all parts have made. :class:`~tactile_toolkit.run.parts.Check` around any runner trusts no size:
    all that is finished is read.

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
    IntegrityError
        The runner has not made all shards; those that it made stay.
    MissingPartsError
        The set cannot be finished yet (an IntegrityError).
    StorageError
        The folder cannot be written, or the disk is full. Finished shards stay.
    """
    run = _Run(folder, plan, isinstance(runner, Check), on_progress, write_card)
    runner = runner_for(runner.workers) if isinstance(runner, Check) else runner
    if overwrite:
        _refuse_overwriting(folder, runner)
    if isinstance(runner, Part):
        return run.make_part(runner)
    if isinstance(runner, Finish):
        return run.finish_parts()
    return run.make_all(runner, overwrite)


@dataclass(frozen=True)
class _Run:
    """What a folder is to become, and how."""

    folder: DataFolder
    plan: BuildPlan
    check: bool
    on_progress: Callable[[Progress], None]
    write_card: WriteCard | None

    def make_all(self, runner: Runner, overwrite: bool) -> Manifest:
        folder, plan = self.folder, self.plan
        target, had_manifest = folder, True
        with named_failures(folder.address()):
            existed = folder.exists()
        folder.require_folder()
        try:
            settle(folder, _PATIENCE_S)
            with folder.locked(patience_s=_PATIENCE_S):
                if overwrite and require_replaceable(folder, plan.extra_dirs):
                    target, existed = make_room(folder, plan), False
                had_manifest = target.exists(MANIFEST_FILE)
                job, state = begin(target, plan, plan.tasks, check=self.check)
            # By names and sizes alone; manifests are written last.
            is_finished = not state.todo and state.manifest.complete and not folder.names(PENDING_FOLDER)
            if is_finished and not folder.is_local and not self.check:
                return state.manifest
            records = [*state.kept, *self._work(job, runner, state)]
            with folder.locked():
                job.require()
                _require_records(target, plan.tasks, records)
                manifest = self._finish(target, state.manifest, records)
                if target is not folder:
                    promote(folder)
            return manifest
        except BaseException:
            # What ended the run is what is reported, even where the disk does not let us tidy up.
            with contextlib.suppress(ToolkitError, OSError), folder.locked(patience_s=_PATIENCE_S):
                _undo(target, plan, had_manifest)
                if not existed:
                    target.remove_empty("")
            raise

    def make_part(self, part: Part) -> Manifest:
        """Make the tasks of a part that have no record; return what the manifest would hold of them."""
        folder, tasks = self.folder, part.of(self.plan.tasks)
        folder.require_folder()
        settle(folder, _PATIENCE_S)
        # Shared, as for shards: of many parts that write at once, one would never find the folder free.
        with folder.locked(shared=True, patience_s=_PATIENCE_S):
            job, state = begin(folder, self.plan, tasks, check=self.check)
        records = [*state.kept, *self._work(job, part, state)]
        there = read_manifest(folder)
        if state.todo and there is not None and there.complete:
            with folder.locked():
                listed = job.require()
                if all(task.shard in listed for task in tasks):  # others have finished the set meanwhile
                    tidy(folder, there)
                    return there
        _require_records(folder, tasks, records)
        return replace(state.manifest.with_shards(records), complete=False)

    def finish_parts(self) -> Manifest:
        """Put together what all parts have made. Raises MissingPartsError where something is missing."""
        folder = self.folder
        if not folder.names():
            raise InputError(
                f"{folder.lacks('data set')}; nothing can be finished", next="make its parts with --part"
            )
        folder.require_folder()
        settle(folder, _PATIENCE_S)
        self.on_progress(Progress(0, 0))
        with folder.locked(patience_s=_PATIENCE_S):
            folder.refresh(DATA_FOLDER)
            folder.refresh(PENDING_FOLDER)
            state = _require_parts(folder, self.plan, self.check)
            return self._finish(folder, state.manifest, state.kept)

    def _work(self, job: Job, runner: Runner, state: State) -> Iterator[ShardRecord]:
        sizes = {task.shard: task.size for task in state.todo}
        done, total = 0, sum(sizes.values())
        self.on_progress(Progress(done, total))
        begun = job.folder.version(MANIFEST_FILE)
        work = _WriteShard(job, self.plan.style, self.plan.libraries, begun)
        for record in runner.run(work, state.todo):
            done += sizes[record.shard]
            self.on_progress(Progress(done, total, record))
            yield record

    def _finish(self, folder: DataFolder, manifest: Manifest, records: Sequence[ShardRecord]) -> Manifest:
        """Write report, further files, card and, last, the manifest of a set whose shards are all there.

        The caller holds the lock.
        """
        _require_rows(records)
        plan, there = self.plan, read_manifest(folder)
        if there is not None:  # other splits may have been finished meanwhile
            manifest = replace(manifest, shards=there.shards, files=there.files)
        manifest = manifest.with_shards(records)
        if there is not None and there.complete and there.shards != manifest.shards:
            # The report below is of all splits, and no longer what the manifest of some states.
            write_manifest(folder, replace(there, complete=False))
        files = dict(manifest.files or {})
        if plan.report_file is not None:
            checksum = merge_reports(folder, plan.report_file, manifest)
            files |= {plan.report_file: checksum} if checksum is not None else {}
        files |= write_small_columns(folder, manifest)
        files |= plan.write_files(folder, manifest)
        finished = replace(manifest, files=files, complete=True)
        if self.write_card is not None:
            self.write_card(folder, finished)
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
    if any(pending.record.rows for pending in made.values()):
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


def _require_records(folder: DataFolder, tasks: Sequence[ShardTask], records: Sequence[ShardRecord]) -> None:
    """Refuse to continue where a task has no record, or this machine does not see what a record is of."""
    folder.refresh(DATA_FOLDER)
    sizes = folder.sizes(DATA_FOLDER)
    found = {record.shard for record in records if record.is_size_of(sizes)}
    lacking = [str(task.shard) for task in tasks if task.shard not in found]
    if lacking:
        names = ", ".join(lacking[:_CAUSES_SHOWN]) + (", ..." if len(lacking) > _CAUSES_SHOWN else "")
        raise IntegrityError(
            f"{len(lacking):,} of {len(tasks):,} shards that were to be made are not in "
            f"{folder.address()!r}, or have other sizes: {names}; the runner did not make them, a user "
            "removed them, or a node writes to a folder that this machine does not see; finished shards "
            "stay",
            next="run the same command again, on a folder that all nodes share, or s3://BUCKET/PATH",
        )


def _require_parts(folder: DataFolder, plan: BuildPlan, check: bool) -> State:
    """Look whether all parts are there, changing nothing. Raises MissingPartsError where they are not."""
    state = look(folder, plan, check=check)
    if state.todo:
        missing = {task.shard for task in state.todo}
        numbers = [index for index, task in enumerate(plan.tasks) if task.shard in missing]
        raise MissingPartsError(folder.address(), len(missing), len(plan.tasks), array_text(numbers))
    return state


def _require_rows(records: Sequence[ShardRecord]) -> None:
    """Refuse a run that left every item out: its source, not its items, is what is wrong."""
    skipped = [item for record in records for item in record.skipped]
    if skipped and not any(record.rows for record in records):
        first = {item.reason: item.message for item in reversed(skipped)}
        causes = [f"{reason}: {first[reason]}" for reason in dict.fromkeys(item.reason for item in skipped)]
        raise (IntegrityError if set(first) == {DAMAGED} else InputError)(
            f"no row is left: all {len(skipped):,} were left out, nothing was written; the first of each "
            f"reason: {'; '.join(causes[:_CAUSES_SHOWN])}; next: correct the source, or choose another one"
        )


def _refuse_overwriting(folder: DataFolder, runner: Runner | int) -> None:
    """Raise InputError for what makes or ends parts: one must not remove what the others made."""
    if isinstance(runner, (Part, Finish)):
        raise InputError(
            "--overwrite was given with --part or --finish: each part would remove what the others made; "
            "nothing was changed",
            next=f"remove {folder.address()!r} first, or choose another folder (--out or OUT)",
        )


def look_for(
    folder: DataFolder, plan: BuildPlan, workers: int | Runner, *, overwrite: bool = False
) -> tuple[Sequence[ShardTask], State]:
    """Return the tasks of a run and what a folder holds of them; raises where the run would be refused."""
    check, runner = (True, workers.workers) if isinstance(workers, Check) else (False, workers)
    if overwrite:
        _refuse_overwriting(folder, runner)
        require_replaceable(folder, plan.extra_dirs)
        return plan.tasks, State(plan.new_manifest(), (), plan.tasks)
    if isinstance(runner, Finish):
        return plan.tasks, _require_parts(folder, plan, check)
    tasks = runner.of(plan.tasks) if isinstance(runner, Part) else plan.tasks
    return tasks, look(folder, plan, tasks, check=check)


def array_text(numbers: Sequence[int]) -> str:
    """Write numbers as Slurm takes them for ``--array``: ``3,17,40-44``."""
    runs = [
        [number for _, number in run]
        for _, run in groupby(enumerate(sorted(set(numbers))), lambda pair: pair[1] - pair[0])
    ]
    return ",".join(str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)
