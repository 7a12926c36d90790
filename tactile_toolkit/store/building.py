"""Making a data set folder: begin, work, finish. The order of writes makes it safe.

begin   create the manifest (complete: false, no shards) if there is none, and read it back
work    make a shard; then, under the shared lock: same job? rows, report rows, files, record
finish  under the lock: every task has its record; report, further files, card, manifest

A kind of data set brings a :class:`~tactile_toolkit.store.BuildPlan`. An interrupted run continues when the
same data set is requested again: a task with an intact record is done.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Unpack

from tactile_toolkit import errors, run
from tactile_toolkit.store import locks, parquet, pending, replacing, reports, run_options
from tactile_toolkit.store.folder import NEXT_FOLDER, PENDING_FOLDER, DataFolder, LocalFolder
from tactile_toolkit.store.job import BuildJob, begin_job, require_parts, require_same_job
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest, write_manifest
from tactile_toolkit.store.plan import BuildPlan
from tactile_toolkit.store.shards import DATA_FOLDER, ShardRecord, require_rows
from tactile_toolkit.store.task import AnyTask

WriteCard = Callable[[DataFolder, Manifest], None]
"""Writes the card of a finished folder, after its report."""


@dataclass(frozen=True)
class _WriteShard:
    """Make one shard of a job, and write it with its record; picklable."""

    folder: DataFolder
    identity: str
    style: parquet.ParquetStyle = field(repr=False)
    libraries: tuple[str, ...]

    def __call__(self, task: AnyTask) -> ShardRecord:
        """Write rows, then report rows, then further files, then the record that proves all of them."""
        folder, shard = self.folder, task.shard
        content = task.make()
        data = content.encoded or parquet.encode_parquet(content.table, self.style)
        report = report_sha256 = report_bytes = None
        if content.report is not None:
            report = parquet.encode_parquet(content.report, parquet.REPORT_STYLE)
            report_sha256, report_bytes = parquet.sha256_hex(report), len(report)
        record = ShardRecord.of(
            shard,
            len(content.table),
            len(data),
            parquet.sha256_hex(data),
            report_sha256=report_sha256,
            skipped=content.skipped,
            statistics=content.statistics,
            unpacked_bytes=content.table.nbytes,
            source_digest=content.source_digest,
        )
        # As late as possible: hours may have passed, and the folder may hold another data set now.
        with folder.locked(shared=True, is_patient=True):
            require_same_job(folder, self.identity)
            folder.write_bytes(shard.data_path, data)
            if report is not None:
                folder.write_bytes(shard.report_path, report)
            for path, further in content.files.items():
                folder.write_bytes(path, further)
            pending.write_shard_record(folder, record, self.identity, report_bytes)
        return record


def build(
    folder: DataFolder,
    plan: BuildPlan,
    *,
    write_card: WriteCard | None = None,
    **run: Unpack[run_options.RunKeywords],
) -> Manifest:
    """Make what is missing in the folder of the plan and return the manifest.

    A run that fails keeps the shards that it finished; one that finished none leaves the folder as it was.
    With ``overwrite``, the former data set stays until all of the new one is finished. ``run`` are fields of
    :class:`RunOptions`.

    Raises
    ------
    InputError
        The folder holds another data set (SpecMismatchError) or other files, another run is at work in it or
        has replaced the set, every item was left out (IntegrityError if all are damaged), a file to be
        written is a symbolic link, or the disk is full (StorageError). Finished shards stay.
    MissingPartsError
        The set cannot be finished yet, or the runner has not made all shards; those that it made stay.
    """
    options = run_options.RunOptions(**run)
    with _begun(folder, plan, options) as (job, hold):
        if _needs_no_lock(job, options):
            return job.manifest
        records = [*job.finished, *_work(job, options)]
        if options.part is not None:
            return _finish_partial_run(job, records)
        with folder.locked(is_patient=True):
            manifest = _finish(job, records, write_card, folder)
            if job.folder is not folder and isinstance(folder, LocalFolder):
                hold.close()
                replacing.promote(folder)
        return manifest


@contextlib.contextmanager
def _begun(
    folder: DataFolder, plan: BuildPlan, options: run_options.RunOptions
) -> Iterator[tuple[BuildJob, contextlib.ExitStack]]:
    """Begin a job, in ``.next`` where it replaces a data set, and roll it back if it fails without a row.

    Yields the job and what holds ``.next`` for this run.
    """
    existed = folder.exists()
    folder.require_folder()
    target, had_manifest = folder, True
    with contextlib.ExitStack() as hold:
        try:
            replacing.resume_promotion(folder)
            # Parts begin under the lock for shards: with many at once, the folder would never be free.
            with folder.locked(shared=options.part is not None):
                is_replaced = options.overwrite and replacing.require_replaceable(folder, plan)
                if is_replaced and isinstance(folder, LocalFolder):
                    target, existed = replacing.prepare_next(folder, plan), False
                    hold.enter_context(
                        locks.locked(folder.local_path(NEXT_FOLDER), shared=True, patience_s=0.0)
                    )
                had_manifest = target.exists(MANIFEST_FILE)
                job = begin_job(target, plan, options)
            yield job, hold
        except BaseException as error:
            # A run that waited in vain does not wait again.
            patience_s = 0.0 if isinstance(error, errors.BusyError) else None
            # The first error is the one to report, even if the disk does not let us remove anything.
            with contextlib.suppress(errors.ToolkitError, OSError), folder.locked(patience_s=patience_s):
                if options.is_whole:
                    _roll_back(target, plan, had_manifest)
                hold.close()
                if not existed:
                    target.remove_empty("")
            raise


def _needs_no_lock(job: BuildJob, options: run_options.RunOptions) -> bool:
    """Return whether a set in a store is finished, by names and sizes only; manifests are written last."""
    if job.folder.is_local or options.check or job.remaining:
        return False
    return job.manifest.complete and not job.folder.names(PENDING_FOLDER)


def _work(job: BuildJob, options: run_options.RunOptions) -> Iterator[ShardRecord]:
    tasks = job.remaining
    sizes = {task.shard: task.size for task in tasks}
    done, total = 0, sum(sizes.values())
    options.on_progress(run_options.Progress(done, total))
    work = _WriteShard(job.folder, job.manifest.identity, job.plan.style, job.plan.libraries)
    for record in run.runner_for(options.workers).run(work, tasks):
        done += sizes[record.shard]
        options.on_progress(run_options.Progress(done, total, record))
        yield record


def _finish_partial_run(job: BuildJob, records: Sequence[ShardRecord]) -> Manifest:
    """Return a manifest with the shards of a part, or that of a set that other runs have finished."""
    if job.remaining:
        current = require_same_job(job.folder, job.manifest.identity)
        listed = {record.shard for record in current.shards}
        if current.complete and all(task.shard in listed for task in job.tasks):
            with job.folder.locked(is_patient=True):
                pending.remove_leftovers(job.folder, require_same_job(job.folder, job.manifest.identity))
            return current
    _require_records(job, records)
    return replace(job.manifest.with_shards(records), complete=False)


def _finish(
    job: BuildJob,
    records: Sequence[ShardRecord],
    write_card: WriteCard | None,
    replaced: DataFolder,
) -> Manifest:
    """Write what follows from all shards, and the manifest last; the caller holds the lock."""
    folder, plan = job.folder, job.plan
    current = require_same_job(folder, job.manifest.identity)
    _require_records(job, records)
    require_rows([(record.rows, record.skipped) for record in records])
    # Other splits may have been finished since the run began.
    manifest = replace(job.manifest, shards=current.shards, files=current.files).with_shards(records)
    files = dict(manifest.files)
    if current.shards and current.shards != manifest.shards:
        # The report below covers all splits; the current manifest must not list it as its own.
        others = {path: checksum for path, checksum in files.items() if path != plan.report_file}
        write_manifest(folder, replace(current, complete=False, files=others))
    if plan.report_file is not None:
        checksum = reports.merge_reports(folder, plan.report_file, manifest)
        if checksum is not None:
            files[plan.report_file] = checksum
    files |= plan.write_files(folder, manifest)
    finished = replace(manifest, files=files, complete=True, planned={})
    if write_card is not None:
        if folder is not replaced and isinstance(replaced, LocalFolder):
            replacing.keep_card(replaced)
        write_card(folder, finished)
    # A run that had nothing to do leaves the file unchanged.
    if current != finished:
        write_manifest(folder, finished)
        if read_manifest(folder) != finished:
            raise errors.StorageError(
                f"{folder.address(MANIFEST_FILE)!r} is not what was written there a moment ago",
                next="run the same command again, and check the disk",
            )
    pending.remove_leftovers(folder, finished)
    return finished


def _roll_back(folder: DataFolder, plan: BuildPlan, had_manifest: bool) -> None:
    """Roll back a run that failed before any row was written.

    Otherwise a run that cannot finish (scenes that do not fit, an unreadable source) would leave an empty
    folder that refuses every other specification.
    """
    manifest = read_manifest(folder)
    if manifest is None:
        return
    if manifest.identity != plan.new_manifest().identity:
        return
    listed = {record.shard for record in manifest.shards}
    recorded = pending.pending_records(folder, manifest.identity)
    if any(record.rows for shard, record in recorded.items() if shard not in listed):
        return
    # Shards without rows are quickly made again.
    for shard in recorded.keys() - listed:
        for path in (shard.record_path, shard.report_path, shard.data_path):
            folder.remove(path)
    folder.remove_empty(DATA_FOLDER)
    if not had_manifest and not folder.names(DATA_FOLDER):
        folder.remove(MANIFEST_FILE)
        pending.remove_pending(folder)
    folder.remove_empty(PENDING_FOLDER)


def _require_records(job: BuildJob, records: Sequence[ShardRecord]) -> None:
    """Raise MissingPartsError if a task has no record, or this machine does not see the file of a record."""
    job.folder.refresh(DATA_FOLDER)
    sizes = job.folder.sizes(DATA_FOLDER)
    require_parts(job, [record for record in records if record.is_size_of(sizes)])
