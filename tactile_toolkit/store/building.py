"""Making a data set folder: begin, work, finish. The order of writes makes it safe.

begin   create the manifest (complete: false, no shards) if there is none, and read it back
work    make a shard; then, under the shared lock: same job? rows, report rows, files, record
finish  under the lock: every task has its record; report, further files, card, manifest

A kind of data set brings a :class:`~tactile_toolkit.store.BuildPlan`. An interrupted run continues when the
same data set is requested again: a task with an intact record is done.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import PurePosixPath
from typing import Unpack

import msgspec

from tactile_toolkit import errors, run
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.store import parquet
from tactile_toolkit.store.files import DRAFT, is_hidden
from tactile_toolkit.store.folder import NEXT_FOLDER, PENDING_FOLDER, DataFolder, LocalFolder
from tactile_toolkit.store.job import (
    BuildJob,
    BuildPlan,
    Progress,
    RunKeywords,
    RunOptions,
    ShardTask,
    begin_job,
    is_pending,
    refuse_unknown_files,
    remove_leftovers,
    remove_pending,
    require_parts,
    require_same_job,
)
from tactile_toolkit.store.locks import locked
from tactile_toolkit.store.manifest import (
    CARD_FILE,
    DATA_FOLDER,
    MANIFEST_FILE,
    Manifest,
    ShardName,
    ShardRecord,
    decode,
    pending_records,
    read_manifest,
    require_rows,
    write_manifest,
    write_shard_record,
)
from tactile_toolkit.store.verification import RECORD_FILE

WriteCard = Callable[[DataFolder, Manifest], None]
"""Writes the card of a finished folder, after its report."""
PROMOTION_FILE = f"{NEXT_FOLDER}/.promotion.json"
"""Lists the files of the former data set that the next one lacks."""
_USUAL = ("reports/*.parquet", "previews/*.png", CARD_FILE, RECORD_FILE, MANIFEST_FILE)


@dataclass(frozen=True)
class _WriteShard:
    """Make one shard of a job, and write it with its record; picklable."""

    folder: DataFolder
    identity: str
    style: parquet.ParquetStyle = field(repr=False)
    libraries: tuple[str, ...]

    def __call__(self, task: ShardTask) -> ShardRecord:
        """Write rows, then report rows, then further files, then the record that proves all of them."""
        folder, shard = self.folder, task.shard
        content = task.make()
        data = content.encoded or self.style.encode(content.table)
        report = None
        if content.report is not None:
            report = parquet.REPORT_STYLE.encode(content.report)
        record = ShardRecord(
            shard.data_path,
            shard.split,
            len(content.table),
            len(data),
            hashlib.sha256(data).hexdigest(),
            report_sha256=None if report is None else hashlib.sha256(report).hexdigest(),
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
            write_shard_record(folder, record, self.identity, None if report is None else len(report))
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
        has replaced the set, every item was left out (IntegrityError if all are damaged), a file to be
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
            return _finish_partial_run(job, records)
        with folder.locked(is_patient=True):
            manifest = _finish(job, records, write_card, folder)
            if job.folder is not folder and isinstance(folder, LocalFolder):
                hold.close()
                promote(folder)
        return manifest


@contextlib.contextmanager
def _begun(
    folder: DataFolder, plan: BuildPlan, options: RunOptions
) -> Iterator[tuple[BuildJob, contextlib.ExitStack]]:
    """Begin a job, in ``.next`` where it replaces a data set, and roll it back if it fails without a row.

    Yields the job and what holds ``.next`` for this run.
    """
    existed = folder.exists()
    folder.require_folder()
    target, had_manifest = folder, True
    with contextlib.ExitStack() as hold:
        try:
            resume_promotion(folder)
            # Parts begin under the lock for shards: with many at once, the folder would never be free.
            with folder.locked(shared=options.part is not None):
                is_replaced = options.overwrite and require_replaceable(folder, plan)
                if is_replaced and isinstance(folder, LocalFolder):
                    target = prepare_next(folder, plan)
                    existed = False
                    hold.enter_context(locked(folder.local_path(NEXT_FOLDER), shared=True, patience_s=0.0))
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


def _needs_no_lock(job: BuildJob, options: RunOptions) -> bool:
    """Return whether a set in a store is finished, by names and sizes only; manifests are written last."""
    if job.folder.is_local or options.check or job.remaining:
        return False
    return job.manifest.complete and not job.folder.names(PENDING_FOLDER)


def _work(job: BuildJob, options: RunOptions) -> Iterator[ShardRecord]:
    tasks = job.remaining
    sizes = {task.shard: task.size for task in tasks}
    done = 0
    total = sum(sizes.values())
    options.on_progress(Progress(done, total))
    write_shard = _WriteShard(job.folder, job.manifest.identity, job.plan.style, job.plan.libraries)
    for record in run.runner_for(options.workers).run(write_shard, tasks):
        done += sizes[record.shard]
        options.on_progress(Progress(done, total, record))
        yield record


def _finish_partial_run(job: BuildJob, records: Sequence[ShardRecord]) -> Manifest:
    """Return a manifest with the shards of a part, or that of a set that other runs have finished."""
    if job.remaining:
        current = require_same_job(job.folder, job.manifest.identity)
        listed = {record.shard for record in current.shards}
        if current.complete and all(task.shard in listed for task in job.tasks):
            with job.folder.locked(is_patient=True):
                remove_leftovers(job.folder, require_same_job(job.folder, job.manifest.identity))
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
        checksum = parquet.merge_reports(folder, plan.report_file, manifest)
        if checksum is not None:
            files[plan.report_file] = checksum
    files |= plan.write_files(folder, manifest)
    finished = replace(manifest, files=files, complete=True, planned={})
    if write_card is not None:
        if folder is not replaced and isinstance(replaced, LocalFolder):
            keep_card(replaced)
        write_card(folder, finished)
    # A run that had nothing to do leaves the file unchanged.
    if current != finished:
        write_manifest(folder, finished)
        if read_manifest(folder) != finished:
            raise errors.StorageError(
                f"{folder.address(MANIFEST_FILE)!r} is not what was written there a moment ago",
                next="run the same command again, and check the disk",
            )
    remove_leftovers(folder, finished)
    return finished


def _roll_back(folder: DataFolder, plan: BuildPlan, had_manifest: bool) -> None:
    """Roll back a run that failed before any row was written.

    Otherwise a run that cannot finish (scenes that do not fit, an unreadable source) would leave an empty
    folder that refuses every other specification.
    """
    manifest = read_manifest(folder)
    if manifest is None or manifest.identity != plan.new_manifest().identity:
        return
    listed = {record.shard for record in manifest.shards}
    recorded = pending_records(folder, manifest.identity)
    if any(record.rows for shard, record in recorded.items() if shard not in listed):
        return
    # Shards without rows are quickly made again.
    for shard in recorded.keys() - listed:
        for path in (shard.record_path, shard.report_path, shard.data_path):
            folder.remove(path)
    folder.remove_empty(DATA_FOLDER)
    if not had_manifest and not folder.names(DATA_FOLDER):
        folder.remove(MANIFEST_FILE)
        remove_pending(folder)
    folder.remove_empty(PENDING_FOLDER)


def _require_records(job: BuildJob, records: Sequence[ShardRecord]) -> None:
    """Raise MissingPartsError if a task has no record, or this machine does not see the file of a record."""
    job.folder.refresh(DATA_FOLDER)
    sizes = job.folder.sizes(DATA_FOLDER)
    require_parts(job, [record for record in records if record.is_size_of(sizes)])


def require_replaceable(folder: DataFolder, plan: BuildPlan | None = None) -> list[str]:
    """Return the files of the data set that a run may replace; empty if there is none. Changes nothing.

    Files of a data set are known by their names; other hidden files stay. An interrupted run of the plan is
    continued, not replaced. Raises InputError for any other file or symbolic link, and for a set in an object
    store, where files cannot be moved.
    """
    if not folder.exists(MANIFEST_FILE):
        refuse_unknown_files(folder, plan)
        return []
    if not isinstance(folder, LocalFolder):
        raise errors.InputError(
            f"{folder.address()!r} holds a data set, and --overwrite does not work in an object store: the "
            "data set could not be restored if the new run fails; nothing was changed",
            next="choose another folder (--out or OUT), or remove that one with the store's own tools",
        )
    manifest = _manifest(folder)
    # Anyone may have written the manifest: folders that it names count only if a kind declares them.
    named = manifest.trees if manifest is not None else ()
    further = [pattern for pattern in extra_files() if pattern.partition("/")[0] in named]
    names = set(folder.names())
    shown = {name for name in names if name in (PENDING_FOLDER, RECORD_FILE) or not is_hidden(name)}
    paths = [path for path in folder.walk() if path.partition("/")[0] in shown]
    unknown = [path for path in paths if folder.local_path(path) and not is_ours(path, further)]
    # Other programs use that file name, too: a damaged manifest of a data set has shards next to it.
    if manifest is None and not {DATA_FOLDER, PENDING_FOLDER} & names:
        unknown = [MANIFEST_FILE]
    if unknown:
        raise errors.InputError(
            f"{folder.address()!r} holds more than a data set of this toolkit (found {unknown[0]!r}); "
            "nothing was changed",
            next="move that file away, or choose an empty or new folder (--out or OUT)",
        )
    return paths


def _manifest(folder: DataFolder) -> Manifest | None:
    try:
        return read_manifest(folder)
    except errors.IntegrityError:
        return None


def _next(folder: LocalFolder) -> LocalFolder:
    return LocalFolder(folder.address(NEXT_FOLDER))


def prepare_next(folder: LocalFolder, plan: BuildPlan) -> LocalFolder:
    """Return the folder in which the next data set is made, without files of any other one.

    A run holds the lock of that folder, shared with other runs of the same job. Raises BusyError if another
    data set is being made there.
    """
    after = _next(folder)
    after.require_folder()
    begun = _manifest(after)
    if begun is None or begun.identity != plan.new_manifest().identity:
        with locked(folder.local_path(NEXT_FOLDER), patience_s=0.0):
            folder.remove(f"{NEXT_FOLDER}/{MANIFEST_FILE}")  # first: without it no other file counts
            remove_next(folder)
        after.require_folder()
    return after


def keep_card(folder: LocalFolder) -> None:
    """Copy the card to the next data set, whose card keeps the statements of the owner."""
    after = _next(folder)
    if folder.exists(CARD_FILE) and not after.exists(CARD_FILE):
        after.write_bytes(CARD_FILE, folder.read_bytes(CARD_FILE))


def resume_promotion(folder: DataFolder) -> None:
    """Complete a replacement that was begun; raises BusyError while another run does so."""
    if isinstance(folder, LocalFolder) and folder.exists(PROMOTION_FILE):
        with folder.locked():
            if folder.exists(PROMOTION_FILE):
                _move_files(folder)


def promote(folder: LocalFolder) -> None:
    """Move the finished data set in ``.next`` into its place; the caller holds the lock.

    Raises InputError if the folder holds more than a data set by now; then nothing was changed.
    """
    former = sorted({*require_replaceable(folder)}.difference(_arriving(folder)))
    # From here on, the replacement can only be completed.
    folder.write_bytes(PROMOTION_FILE, msgspec.json.encode(former))
    _move_files(folder)


def _arriving(folder: LocalFolder) -> list[str]:
    """Return the files of the next data set that have not been moved yet."""
    return [path for path in _next(folder).walk() if not is_hidden(path)]


def _move_files(folder: LocalFolder) -> None:
    former = decode(folder.read_bytes(PROMOTION_FILE), list[str], folder.address(PROMOTION_FILE))
    manifest = read_manifest(_next(folder))
    if manifest is not None:  # it is the last file to move
        write_manifest(folder, replace(manifest, complete=False))
        # Anyone may have written the list: the folder may be a copy of another user's.
        further = extra_files()
        for path in former:
            if is_ours(path, further):
                folder.remove(path)
        for path in _arriving(folder):
            if path != MANIFEST_FILE:
                folder.move(f"{NEXT_FOLDER}/{path}", path)
        sizes = folder.sizes(DATA_FOLDER)
        missing = [record.shard.data_path for record in manifest.shards if not record.is_size_of(sizes)]
        if missing:
            remove_next(folder)  # the same run makes them again in their place
            raise errors.IntegrityError(
                f"{folder.address(missing[0])!r} is missing or has another size, though it was made to "
                "replace a former file",
                next="run the same command again without --overwrite",
            )
        folder.move(f"{NEXT_FOLDER}/{MANIFEST_FILE}", MANIFEST_FILE)
    for path in former:
        while path := path.rpartition("/")[0]:
            folder.remove_empty(path)
    remove_next(folder)


def remove_next(folder: LocalFolder) -> None:
    """Remove the data set in ``.next``."""
    if folder.exists(NEXT_FOLDER):
        further = extra_files()
        folder.remove_tree(
            NEXT_FOLDER,
            lambda path: path == PROMOTION_FILE or is_ours(path.removeprefix(f"{NEXT_FOLDER}/"), further),
        )


def extra_files() -> list[str]:
    """Return the patterns of files that any kind of data set has next to its rows."""
    return [pattern for kind in DatasetKind.installed() for pattern in kind.extra_files]


def is_ours(path: str, further: Iterable[str]) -> bool:
    """Return whether a path is that of a file of a data set; ``further`` are patterns of its kind."""
    pure = PurePosixPath(path)
    if is_pending(path) or (len(pure.parts) > 1 and re.match(DRAFT, pure.name)):
        return True
    if str(pure.parent) == DATA_FOLDER:
        return ShardName.parse(pure.name) is not None
    # `match` compares from the right; the depth must agree, too.
    return any(
        pure.match(pattern) and len(pure.parts) == pattern.count("/") + 1 for pattern in (*_USUAL, *further)
    )
