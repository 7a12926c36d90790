"""Making a data set folder: begin, work, finish. The order of effects is what makes it safe.

begin   creates the manifest (complete: false, no shards) if there is none, and reads it back
work    makes a shard; then, under the shared lock: same job? rows, report rows, files, record
finish  under the lock: every task has its record; report, small columns, further files, card, manifest

The kinds of data bring a :class:`~tactile_toolkit.store.job.BuildPlan`. What is interrupted continues when
the same is asked for again: a task whose record is intact is done.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Unpack

import msgspec

from tactile_toolkit.errors import BusyError, InputError, IntegrityError, StorageError, ToolkitError
from tactile_toolkit.run import runner_for
from tactile_toolkit.store.folder import NEXT_FOLDER, PENDING_FOLDER, DataFolder
from tactile_toolkit.store.job import (
    BuildPlan,
    Job,
    begin_job,
    pending_records,
    refuse_unknown_files,
    remove_leftovers,
    require_parts,
    require_same_job,
    write_record,
)
from tactile_toolkit.store.locks import locked
from tactile_toolkit.store.manifest import (
    MANIFEST_FILE,
    Manifest,
    read_manifest,
    write_manifest,
)
from tactile_toolkit.store.names import decode, is_hidden
from tactile_toolkit.store.origin import RECORD_FILE
from tactile_toolkit.store.ownership import PROMOTION_FILE, extra_files, is_ours, is_pending, remove_next
from tactile_toolkit.store.parquet import (
    REPORT_STYLE,
    ParquetStyle,
    encode_parquet,
    merge_reports,
    sha256_hex,
    write_small_columns,
)
from tactile_toolkit.store.run_options import Progress, RunKeywords, RunOptions
from tactile_toolkit.store.shards import DAMAGED, DATA_FOLDER, ShardRecord, Skipped
from tactile_toolkit.store.task import ShardTask

_CAUSES_SHOWN = 3

WriteCard = Callable[[DataFolder, Manifest], None]
"""Writes the card of a finished folder, after its report."""


@dataclass(frozen=True)
class _WriteShard:
    """Picklable: make one shard of a job, and write it with its record."""

    folder: DataFolder
    identity: str
    style: ParquetStyle = field(repr=False)
    libraries: tuple[str, ...]

    def __call__(self, task: ShardTask[Any]) -> ShardRecord:
        """Write rows, then report rows, then further files, then the record that proves them all."""
        folder, shard = self.folder, task.shard
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
            source_digest=content.source_digest,
        )
        # As late as can be: hours may have passed, and another data set may be in the folder now.
        with folder.locked(shared=True, is_patient=True):
            require_same_job(folder, self.identity)
            folder.write_bytes(shard.data_path, data)
            if report is not None:
                folder.write_bytes(shard.report_path, report)
            for path, further in content.files.items():
                folder.write_bytes(path, further)
            write_record(folder, record, self.identity, None if report is None else len(report))
        return record


def build(
    folder: DataFolder,
    plan: BuildPlan,
    *,
    write_card: WriteCard | None = None,
    **run: Unpack[RunKeywords],
) -> Manifest:
    """Make what is missing in the folder of the plan and return the manifest.

    A run that fails keeps the shards that it finished; one that finished none leaves the folder as it was.
    With ``overwrite``, the former data set stays until all of the new one is finished. ``run`` are fields of
    :class:`RunOptions`.

    Raises
    ------
    InputError
        The folder holds another data set (SpecMismatchError) or other files, another run is at work in it or
        has replaced the set, every item was left out (IntegrityError where all are damaged), a file to be
        written is a symbolic link, or the disk is full (StorageError). Finished shards stay.
    MissingPartsError
        The set cannot be finished yet, or the runner has not made all shards; those that it made stay.
    """
    options = RunOptions(**run)
    with _begun(folder, plan, options) as (job, hold):
        if _needs_no_lock(job, options):
            return job.manifest
        records = [*job.finished, *_work(job, options)]
        if options.part is not None:
            return _end_part(job, records)
        with folder.locked(is_patient=True):
            manifest = _finish(job, records, write_card)
            if job.folder is not folder:
                hold.close()
                promote(folder)
        return manifest


@contextlib.contextmanager
def _begun(
    folder: DataFolder, plan: BuildPlan, options: RunOptions
) -> Iterator[tuple[Job, contextlib.ExitStack]]:
    """Begin a job, in ``.next`` where it replaces a data set, and roll it back if it fails without a row.

    Yields the job and what holds ``.next`` for this run.
    """
    existed = folder.exists()
    folder.require_folder()
    target, had_manifest = folder, True
    with contextlib.ExitStack() as hold:
        try:
            resume_promotion(folder)
            # Parts begin as they write shards: of many at once, one would never find the folder free.
            with folder.locked(shared=options.part is not None):
                if options.overwrite and require_replaceable(folder, plan):
                    target, existed = prepare_next(folder, plan), False
                    hold.enter_context(locked(folder.place(NEXT_FOLDER), shared=True, patience_s=0.0))
                had_manifest = target.exists(MANIFEST_FILE)
                job = begin_job(target, plan, options)
            yield job, hold
        except BaseException as error:
            # Who has waited in vain does not wait again.
            patience_s = 0.0 if isinstance(error, BusyError) else None
            # The first error is the one to report, even if the disk does not let us remove anything.
            with contextlib.suppress(ToolkitError, OSError), folder.locked(patience_s=patience_s):
                if options.is_whole:
                    _roll_back(target, plan, had_manifest)
                hold.close()
                if not existed:
                    target.remove_empty("")
            raise


def _needs_no_lock(job: Job, options: RunOptions) -> bool:
    """Return whether a set in a store is finished, by names and sizes alone; manifests are written last."""
    if job.folder.is_local or options.check or job.remaining:
        return False
    return job.manifest.complete and not job.folder.names(PENDING_FOLDER)


def _work(job: Job, options: RunOptions) -> Iterator[ShardRecord]:
    tasks = job.remaining
    sizes = {task.shard: task.size for task in tasks}
    done, total = 0, sum(sizes.values())
    options.on_progress(Progress(done, total))
    work = _WriteShard(job.folder, job.manifest.identity, job.plan.style, job.plan.libraries)
    for record in runner_for(options.workers).run(work, tasks):
        done += sizes[record.shard]
        options.on_progress(Progress(done, total, record))
        yield record


def _end_part(job: Job, records: Sequence[ShardRecord]) -> Manifest:
    """Return what the manifest would hold of a part, or that of a set that other runs have finished."""
    if job.remaining:
        current = require_same_job(job.folder, job.manifest.identity)
        listed = {record.shard for record in current.shards}
        if current.complete and all(task.shard in listed for task in job.tasks):
            with job.folder.locked(is_patient=True):
                remove_leftovers(job.folder, require_same_job(job.folder, job.manifest.identity))
            return current
    _require_records(job, records)
    return replace(job.manifest.with_shards(records), complete=False)


def _finish(job: Job, records: Sequence[ShardRecord], write_card: WriteCard | None) -> Manifest:
    """Write what follows from all shards, and the manifest last; the caller holds the lock."""
    folder, plan = job.folder, job.plan
    current = require_same_job(folder, job.manifest.identity)
    _require_records(job, records)
    require_rows([(record.rows, record.skipped) for record in records])
    # Other splits may have been finished since the run began.
    manifest = replace(job.manifest, shards=current.shards, files=current.files).with_shards(records)
    files = dict(manifest.files)
    if current.shards and current.shards != manifest.shards:
        # The report below is of all splits, and no longer the one that this manifest lists.
        others = {path: checksum for path, checksum in files.items() if path != plan.report_file}
        write_manifest(folder, replace(current, complete=False, files=others))
    if plan.report_file is not None:
        checksum = merge_reports(folder, plan.report_file, manifest)
        files |= {plan.report_file: checksum} if checksum is not None else {}
    files |= write_small_columns(folder, manifest)
    files |= plan.write_files(folder, manifest)
    finished = replace(manifest, files=files, complete=True, planned={})
    if write_card is not None:
        write_card(folder, finished)
    # A run that had nothing to do leaves the file as it is, with its time.
    if current != finished:
        write_manifest(folder, finished)
        if read_manifest(folder) != finished:
            raise StorageError(
                f"{folder.address(MANIFEST_FILE)!r} is not what was written there a moment ago",
                next="run the same command again, and check the disk",
            )
    remove_leftovers(folder, finished)
    return finished


def _roll_back(folder: DataFolder, plan: BuildPlan, had_manifest: bool) -> None:
    """Roll back a run that failed before any row was written.

    A run that cannot be finished (scenes that do not fit, an unreadable source) would otherwise leave a
    folder that holds nothing and refuses every other specification.
    """
    manifest = read_manifest(folder)
    if manifest is None:
        return
    if manifest.identity != plan.new_manifest().identity:
        return
    listed = {record.shard for record in manifest.shards}
    pending = pending_records(folder, manifest.identity)
    if any(record.rows for shard, record in pending.items() if shard not in listed):
        return
    # A shard without rows is soon made again.
    for shard in pending.keys() - listed:
        for path in (shard.record_path, shard.report_path, shard.data_path):
            folder.remove(path)
    folder.remove_empty(DATA_FOLDER)
    if not had_manifest and not folder.names(DATA_FOLDER):
        folder.remove(MANIFEST_FILE)
        folder.remove_tree(PENDING_FOLDER, is_pending)
    folder.remove_empty(PENDING_FOLDER)


def _require_records(job: Job, records: Sequence[ShardRecord]) -> None:
    """Refuse to continue where a task has no record, or this machine does not see the file of a record."""
    job.folder.refresh(DATA_FOLDER)
    sizes = job.folder.sizes(DATA_FOLDER)
    require_parts(job, [record for record in records if record.is_size_of(sizes)])


def require_rows(shards: Sequence[tuple[int, Sequence[Skipped]]]) -> None:
    """Refuse a run that left every item out: its source, not its items, is what is wrong.

    Takes the rows of each shard, and what was left out.
    """
    skipped = [item for _, left_out in shards for item in left_out]
    if skipped and not any(rows for rows, _ in shards):
        first = {item.reason: item.message for item in reversed(skipped)}
        causes = [f"{reason}: {first[reason]}" for reason in dict.fromkeys(item.reason for item in skipped)]
        raise (IntegrityError if set(first) == {DAMAGED} else InputError)(
            f"no row is left: all {len(skipped):,} were left out, nothing was written; the first of each "
            f"reason: {'; '.join(causes[:_CAUSES_SHOWN])}",
            next="correct the source, or choose another one",
        )


def require_replaceable(folder: DataFolder, plan: BuildPlan | None = None) -> list[str]:
    """Return the files of the data set that a run may replace, none where there is none; changes nothing.

    All files of a data set are known by their names; other hidden files stay. What a run of the plan has left
    is not replaced but continued. Raises InputError for any other file, a symbolic link above all, and for a
    set in an object store, which moves no file.
    """
    if not folder.exists(MANIFEST_FILE):
        refuse_unknown_files(folder, plan)
        return []
    if not folder.is_local:
        raise InputError(
            f"{folder.address()!r} holds a data set, and --overwrite replaces none in an object store, where "
            "it could not be put back if the new run fails; nothing was changed",
            next="choose another folder (--out or OUT), or remove that one with the store's own tools",
        )
    manifest = _manifest(folder)
    # A manifest may be any user's, of a data set from the Hub: what it names counts where kinds know it.
    named = () if manifest is None else manifest.trees
    further = [pattern for pattern in extra_files() if pattern.partition("/")[0] in named]
    names = set(folder.names())
    shown = {name for name in names if name in (PENDING_FOLDER, RECORD_FILE) or not is_hidden(name)}
    found = [path for path in folder.walk() if path.partition("/")[0] in shown]
    strange = [path for path in found if folder.place(path) and not is_ours(path, further)]
    # A damaged manifest of a data set has shards next to it; other programs have files of that name, too.
    if manifest is None and not {DATA_FOLDER, PENDING_FOLDER} & names:
        strange = [MANIFEST_FILE]
    if strange:
        raise InputError(
            f"{folder.address()!r} holds more than a data set of this toolkit (found {strange[0]!r}); "
            "nothing was changed",
            next="move that file away, or choose an empty or new folder (--out or OUT)",
        )
    return found


def _manifest(folder: DataFolder) -> Manifest | None:
    try:
        return read_manifest(folder)
    except IntegrityError:
        return None


def prepare_next(folder: DataFolder, plan: BuildPlan) -> DataFolder:
    """Return the folder in which the next data set is made, without files of any other one.

    Who makes a data set there holds that folder, shared with other runs of the same. Raises BusyError where
    another one is being made.
    """
    place, after = folder.place(NEXT_FOLDER), DataFolder(folder.address(NEXT_FOLDER))
    after.require_folder()
    begun = _manifest(after)
    if begun is None or begun.identity != plan.new_manifest().identity:
        with locked(place, patience_s=0.0):
            folder.remove(f"{NEXT_FOLDER}/{MANIFEST_FILE}")  # first: without it no other file counts
            remove_next(folder)
        after.require_folder()
    return after


def resume_promotion(folder: DataFolder) -> None:
    """Complete a replacement that was begun; raises BusyError while another run does so."""
    if folder.is_local and folder.exists(PROMOTION_FILE):
        with folder.locked():
            if folder.exists(PROMOTION_FILE):
                _move_files(folder)


def promote(folder: DataFolder) -> None:
    """Put the finished data set in ``.next`` in place of that around it; the caller holds the lock.

    Raises InputError where the folder holds more than a data set by now, and nothing was touched.
    """
    leave = require_replaceable(folder)
    former = sorted({*leave}.difference(_arriving(folder)))
    folder.write_bytes(PROMOTION_FILE, msgspec.json.encode(former))  # from here on it can only be completed
    _move_files(folder)


def _arriving(folder: DataFolder) -> list[str]:
    """Return the files of the next data set that were not moved yet."""
    return [path for path in DataFolder(folder.address(NEXT_FOLDER)).walk() if not is_hidden(path)]


def _move_files(folder: DataFolder) -> None:
    leave = decode(folder.read_bytes(PROMOTION_FILE), list[str], folder.address(PROMOTION_FILE))
    after = DataFolder(folder.address(NEXT_FOLDER))
    manifest = read_manifest(after)
    if manifest is not None:  # it is the last file to move
        write_manifest(folder, replace(manifest, complete=False))
        # The list may be any user's, of a folder that was given to us.
        every = extra_files()
        for path in leave:
            if is_ours(path, every):
                folder.remove(path)
        for path in _arriving(folder):
            if path != MANIFEST_FILE:
                folder.move(f"{NEXT_FOLDER}/{path}", path)
        sizes = folder.sizes(DATA_FOLDER)
        missing = [record.shard.data_path for record in manifest.shards if not record.is_size_of(sizes)]
        if missing:
            remove_next(folder)  # the same run makes them again where they are to be
            raise IntegrityError(
                f"{folder.address(missing[0])!r} is missing or of another size, though it was made to take "
                "the place of a former file",
                next="run the same command again without --overwrite",
            )
        folder.move(f"{NEXT_FOLDER}/{MANIFEST_FILE}", MANIFEST_FILE)
    for path in leave:
        while path := path.rpartition("/")[0]:
            folder.remove_empty(path)
    remove_next(folder)
