"""Building a data set folder: plan, resume, run, merge.

The kinds of data (digits, scenes) bring a :class:`BuildPlan`; this module gives all of them the same
behaviour: interrupted work goes on, finished work is never made twice, another specification is refused.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

from tactile_toolkit.errors import InputError, IntegrityError, StorageError, ToolkitError
from tactile_toolkit.run.parts import Check, Finish, Part
from tactile_toolkit.run.processes import Runner, runner_for
from tactile_toolkit.store.folder import FORSAKEN_S, DataFolder, folders_below, named_failures
from tactile_toolkit.store.job import Job, putting
from tactile_toolkit.store.manifest import (
    MANIFEST_FILE,
    Manifest,
    pending_beside,
    read_manifest,
    remove_pending,
    write_manifest,
    write_shard_record,
)
from tactile_toolkit.store.parquet import (
    REPORT_STYLE,
    ParquetStyle,
    encode_parquet,
    sha256_hex,
    unpacked_bytes,
    write_parquet,
)
from tactile_toolkit.store.parts import (
    PARTS_FILE,
    MissingPartsError,
    PartsEndedError,
    PartsPlan,
    array_text,
    read_parts_plan,
)
from tactile_toolkit.store.plan import (
    BuildPlan,
    BuildState,
    ShardTask,
    inspect_folder,
    refuse_other_division,
    refuse_other_parts,
)
from tactile_toolkit.store.replace import FolderBefore, FormerSet, recover, refuse_links, refuse_unrecovered
from tactile_toolkit.store.reports import merge_reports
from tactile_toolkit.store.shards import DAMAGED, DATA_FOLDER, PENDING_FOLDER, ShardRecord, Skipped
from tactile_toolkit.store.small_columns import write_small_columns
from tactile_toolkit.wording import counted

__all__ = ["Progress", "build", "division_of", "inspect_part", "inspect_parts", "refuse_overwriting"]

_CAUSES_SHOWN = 3
_PATIENCE_S = 60.0
"""How long a run waits to begin where others write; one that was stopped (Ctrl-Z) holds its lock for good."""
_APPEARS_S = 30.0
"""How long a file may take to show on another machine; network file systems keep listings that long."""

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
    """Picklable: make one shard and write it with its record."""

    folder: DataFolder
    style: ParquetStyle = field(repr=False)
    libraries: tuple[str, ...]
    job: Job
    agreed: PartsPlan | None = None

    def confirm(self, record: ShardRecord, machine: str) -> None:
        """Raise InputError when what another machine has written is not to be seen from this one."""
        path, deadline_s = record.shard.data_path, time.monotonic() + _APPEARS_S
        # Listed, not asked for by name: network file systems remember for a while that a name was not there.
        while not record.is_size_of(self.folder.sizes(DATA_FOLDER)):
            if time.monotonic() > deadline_s:
                message = (
                    f"node {machine} writes to a folder that this machine does not see: {path!r}, finished "
                    f"there, is not in {self.folder.address()!r} here after {_APPEARS_S:.0f} s; nothing made "
                    "there counts; next: give a folder that all nodes share, or s3://BUCKET/PATH"
                )
                raise InputError(message)
            time.sleep(0.5)

    def __call__(self, task: ShardTask) -> ShardRecord:
        """Write rows, then report rows, then the record that vouches for both."""
        with self.job.at_work():
            content = task.make()
            table = content.table
            data, footer = write_parquet(table, self.style)
            report = None if content.report is None else encode_parquet(content.report, REPORT_STYLE)
            record = ShardRecord(
                task.shard,
                table.num_rows,
                len(data),
                sha256_hex(data),
                None if report is None else sha256_hex(report),
                content.skipped,
                content.statistics,
                unpacked_bytes(footer, table.schema, lambda _: table),
            )
            # As late as can be: hours may have passed, and what is there now may be of another data set.
            with putting(self.folder):
                if self.agreed is not None and read_parts_plan(self.folder) != self.agreed:
                    message = (
                        f"the data set in {self.folder.address()!r} was finished, or started again, while "
                        f"this part made {task.shard}; nothing of that was written; next: look there with "
                        "the command `info`"
                    )
                    raise PartsEndedError(message)
                self.folder.write_bytes(task.shard.data_path, data)
                if report is not None:
                    self.folder.write_bytes(task.shard.report_path, report)
                write_shard_record(self.folder, record)
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

    A run that fails keeps the shards that it finished; one that finished none leaves the folder as it was,
    with ``overwrite`` too. The manifest is complete when nothing that any run began is left to do.

    With a :class:`~tactile_toolkit.run.parts.Part` for a runner, only its tasks are made: no manifest, report
    or card is written, and nothing of others is removed. :class:`~tactile_toolkit.run.parts.Finish` writes
    those, from what all parts have made. :class:`~tactile_toolkit.run.parts.Check` around any runner trusts
    no size: all that is finished is read.

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
    check = isinstance(runner, Check)
    if isinstance(runner, Check):
        runner = runner_for(runner.workers)
    if overwrite:
        refuse_overwriting(folder, runner)
    if isinstance(runner, Part):
        return _make_part(folder, plan, runner, on_progress, check)
    if isinstance(runner, Finish):
        return _finish(folder, plan, on_progress, write_card, check)
    with named_failures(folder.address()):
        existed = folder.exists()
    folder.require_folder()
    before = FolderBefore(existed, FormerSet(folder, plan.extra_dirs) if overwrite else None)
    try:
        with folder.locked(patience_s=_PATIENCE_S):
            before.begun = True
            try:
                state, job = _begin(folder, plan, before, check)
            finally:
                before.mine = folder.version(MANIFEST_FILE)
        if not folder.is_local and not check and _is_finished(folder, state):
            return state.manifest
        work = _WriteShard(folder, plan.style, plan.libraries, job)
        records = [*state.kept, *_run(work, runner, state, on_progress, before.former)]
        _require_tasks(folder, plan.tasks, records)
        _require_rows(records)
    except BaseException:
        if before.former is not None:
            before.former.end()
        # What ended the run is what is reported, even where the disk does not let us tidy up.
        with contextlib.suppress(ToolkitError, OSError):
            _remove_stale_files(folder, plan)  # of workers that were stopped in the middle of a file
        if before.begun:
            with contextlib.suppress(ToolkitError, OSError), folder.locked():
                before.restore_unless_finished(folder, plan)
        raise
    if before.former is not None:
        before.former.give_up()
    with folder.locked():
        job.require()
        return _conclude(folder, plan, state.manifest, records, write_card)


def _begin(folder: DataFolder, plan: BuildPlan, before: FolderBefore, check: bool) -> tuple[BuildState, Job]:
    """Look what a folder lacks, and write down what it is to become, noting in ``before`` what there was."""
    refuse_links(folder, plan.extra_dirs)
    recover(folder)
    if before.former is not None:
        before.former.set_aside()
    state = inspect_folder(folder, plan, check=check)
    before.manifest = folder.read_bytes(MANIFEST_FILE) if folder.exists(MANIFEST_FILE) else None
    before.state = state
    _remove_stale_files(folder, plan)
    for path in state.unproven:
        folder.remove(path)
    if state.todo:
        # Named before the first shard, so that an interrupted folder knows what it was to become. Written
        # though it may be the same: that the file is another one shows runs before that this one has begun.
        redone = {task.shard for task in state.todo}
        kept = tuple(record for record in state.manifest.shards if record.shard not in redone)
        begun = replace(state.manifest, shards=kept, complete=False)
        if before.manifest is not None:
            write_manifest(folder, begun)
        elif not folder.create_bytes(MANIFEST_FILE, begun.to_json().encode()):
            return _begin(folder, plan, before, check)  # another run began at this moment, without a lock
    return state, Job.in_folder(folder)


def refuse_overwriting(folder: DataFolder, runner: Runner | int) -> None:
    """Raise InputError for what makes or ends parts: one must not remove what the others made."""
    if isinstance(runner, (Part, Finish)):
        message = (
            "--overwrite was given with --part or --finish: each part would remove what the others made; "
            f"nothing was changed; next: remove {folder.address()!r} first, or choose another folder "
            "(--out or OUT)"
        )
        raise InputError(message)


def division_of(folder: DataFolder, plan: BuildPlan, part: Part) -> tuple[Sequence[ShardTask], PartsPlan]:
    """Return the tasks of a part, and what all parts have to agree on. InputError where there is no such."""
    there = read_parts_plan(folder)
    count = part.count or (part.assumed if there is None else there.parts)
    if count is None:
        message = (
            f"--part auto: nothing says how many parts there are: {folder.address()!r} holds none yet, and "
            "neither a whole Slurm array from 0 or 1 on nor JOB_COMPLETION_COUNT does; nothing was made; "
            "next: say --part auto/N"
        )
        raise InputError(message)
    return plan.tasks[part.first_of(count) :: count], plan.for_parts(count)


def inspect_part(
    folder: DataFolder, plan: BuildPlan, tasks: Sequence[ShardTask], wanted: PartsPlan, check: bool
) -> BuildState:
    """Look what is made of a part, changing nothing; raises where the part would be refused."""
    refuse_links(folder, plan.extra_dirs)
    refuse_unrecovered(folder)
    state = inspect_folder(folder, plan, tasks, in_parts=True, check=check)
    if state.agreed is not None:
        refuse_other_division(folder, state.agreed, wanted)
    if state.unproven:
        message = (
            f"{folder.address(PENDING_FOLDER)!r} holds what a run of nobody knows which data set has left; "
            "nothing was made; next: remove that folder"
        )
        raise InputError(message)
    return state


def _make_part(
    folder: DataFolder, plan: BuildPlan, part: Part, on_progress: Callable[[Progress], None], check: bool
) -> Manifest:
    """Make the tasks of a part that have no record; return what the manifest would hold of them."""
    tasks, wanted = division_of(folder, plan, part)
    folder.require_folder()
    seen = folder.version(MANIFEST_FILE)
    state = inspect_part(folder, plan, tasks, wanted, check)
    # Shared, as for shards: of many parts that write at once, one would never find the folder free.
    with folder.locked(shared=True, patience_s=_PATIENCE_S):
        is_first = bool(state.todo) and _agree(folder, plan, wanted)
        if is_first or folder.version(MANIFEST_FILE) != seen:
            # Another run may have begun since this part looked, or all parts have been finished.
            try:
                state = inspect_part(folder, plan, tasks, wanted, check)
            except ToolkitError:
                if is_first:
                    _withdraw(folder)
                raise
            if is_first and not state.todo:
                _withdraw(folder)
        job = Job.in_folder(folder)
    if not state.todo:
        on_progress(Progress(0, 0))
        return state.manifest.with_shards(state.kept)
    made: list[ShardRecord] = []
    try:
        for record in _run(
            _WriteShard(folder, plan.style, plan.libraries, job, wanted), part, state, on_progress, None
        ):
            made.append(record)
            if read_parts_plan(folder) != wanted:
                break
    except BaseException as error:
        with contextlib.suppress(ToolkitError, OSError):  # of workers that were stopped, and no others
            _remove_stale_files(folder, plan, forsaken_s=math.inf)
        # Who has finished the set meanwhile has also removed what was being written.
        if not isinstance(error, (PartsEndedError, StorageError)) or read_parts_plan(folder) == wanted:
            raise
    if read_parts_plan(folder) == wanted:
        _require_tasks(folder, state.todo, made)
        return state.manifest.with_shards([*state.kept, *made])
    return _ended_by_others(folder, state, made)


def _agree(folder: DataFolder, plan: BuildPlan, wanted: PartsPlan) -> bool:
    """Write down what the parts make unless another part has, and tell whether this one did.

    Raises SpecMismatchError where the other makes something else.
    """
    is_first = True
    while not folder.create_bytes(PARTS_FILE, wanted.to_json()):
        agreed = read_parts_plan(folder)
        if agreed is not None:  # else it has been finished at this moment
            refuse_other_parts(folder, agreed, plan)
            refuse_other_division(folder, agreed, wanted)
            is_first = False
            break
    # For all who look into the folder meanwhile; where there is one it stays as it is.
    folder.create_bytes(MANIFEST_FILE, plan.new_manifest().to_json().encode())
    return is_first


def _withdraw(folder: DataFolder) -> None:
    """Take back what a first part has written down of which nothing is to be made."""
    folder.remove(PARTS_FILE)
    folder.remove_empty(PENDING_FOLDER)


def _ended_by_others(folder: DataFolder, state: BuildState, made: Sequence[ShardRecord]) -> Manifest:
    """Return the manifest of a set that others have finished meanwhile; what is of another set stays."""
    with folder.locked():
        manifest = read_manifest(folder)
        if manifest is not None and manifest.spec == state.manifest.spec:
            held = {record.shard for record in manifest.shards}
            if held.issuperset(task.shard for task in state.todo):
                for record in made:
                    folder.remove(record.shard.record_path)
                    folder.remove(record.shard.report_path)
                folder.remove_empty(PENDING_FOLDER)
                return manifest
    message = (
        f"the data set in {folder.address()!r} was started again while this part was at work; next: look "
        "there with the command `info`, and give the parts again"
    )
    raise PartsEndedError(message)


def _finish(
    folder: DataFolder,
    plan: BuildPlan,
    on_progress: Callable[[Progress], None],
    write_card: WriteCard | None,
    check: bool,
) -> Manifest:
    """Put together what all parts have made. Raises MissingPartsError where something is missing."""
    if not folder.names():
        message = f"{folder.lacks('data set')}; nothing can be finished; next: make its parts with --part"
        raise InputError(message)
    folder.require_folder()
    on_progress(Progress(0, 0))
    with folder.locked(patience_s=_PATIENCE_S):
        folder.refresh(DATA_FOLDER)
        folder.refresh(PENDING_FOLDER)
        state = inspect_parts(folder, plan, check)
        _require_rows(state.kept)
        return _conclude(folder, plan, state.manifest, state.kept, write_card, forsaken_s=-math.inf)


def inspect_parts(folder: DataFolder, plan: BuildPlan, check: bool) -> BuildState:
    """Look whether all parts are there, changing nothing. Raises MissingPartsError where they are not."""
    refuse_links(folder, plan.extra_dirs)
    refuse_unrecovered(folder)
    state = inspect_folder(folder, plan, in_parts=True, check=check)
    parts = None
    if state.agreed is not None:
        parts = state.agreed.parts
        refuse_other_division(folder, state.agreed, plan.for_parts(parts))
    if state.todo:
        missing = {task.shard for task in state.todo}
        numbers = [index % (parts or 1) for index, task in enumerate(plan.tasks) if task.shard in missing]
        raise MissingPartsError(folder.address(), len(missing), len(plan.tasks), array_text(numbers), parts)
    return state


def _conclude(
    folder: DataFolder,
    plan: BuildPlan,
    manifest: Manifest,
    records: Sequence[ShardRecord],
    write_card: WriteCard | None,
    *,
    forsaken_s: float = FORSAKEN_S,
) -> Manifest:
    """Write report, further files, card and, last, the manifest of a run whose shards are all there."""
    _require_files(folder, records)
    there = read_manifest(folder)
    if there is not None and there.spec == manifest.spec:  # other splits may have been finished meanwhile
        manifest = replace(manifest, shards=there.shards, files=there.files)
    manifest = manifest.with_shards(records)
    files = dict(manifest.files or {})
    if plan.report_file is not None:
        checksum = merge_reports(folder, plan.report_file, manifest)
        files |= {plan.report_file: checksum} if checksum is not None else {}
    files |= write_small_columns(folder, manifest)
    files |= plan.write_files(folder, manifest)
    # Shards of a split that another run began stay its own until that run is given again.
    begun, agreed = pending_beside(folder, manifest), read_parts_plan(folder)
    parts_left = agreed is not None and not agreed.is_covered_by(record.shard for record in manifest.shards)
    finished = replace(manifest, files=files, complete=not begun and not parts_left)
    if write_card is not None:
        write_card(folder, finished)
    # A run that had nothing to do leaves the file as it is, with its time.
    if read_manifest(folder) != finished:
        write_manifest(folder, finished)
    # Once more: workers of a killed run may have lived on for a moment.
    _remove_stale_files(folder, plan, forsaken_s=forsaken_s)
    remove_pending(folder, keep=begun, keep_plan=parts_left)
    return finished


def _require_files(folder: DataFolder, records: Sequence[ShardRecord]) -> None:
    """Look whether this machine sees what all records vouch for, in one listing."""
    sizes = folder.sizes(DATA_FOLDER)
    lacking = [record.shard for record in records if not record.is_size_of(sizes)]
    if lacking:
        message = (
            f"{counted(len(lacking), 'shards')} that were finished are not in {folder.address()!r}, or have "
            f"other sizes, the first {lacking[0].data_path!r}: somebody removed them, or a node writes to a "
            "folder that this machine does not see; next: give a folder that all nodes share, or "
            "s3://BUCKET/PATH, and run the same command again"
        )
        raise IntegrityError(message)


def _is_finished(folder: DataFolder, state: BuildState) -> bool:
    """Tell, by names and sizes alone, whether a run has nothing left to do; manifests are written last."""
    return not state.todo and state.manifest.complete and not folder.names(PENDING_FOLDER)


def _remove_stale_files(folder: DataFolder, plan: BuildPlan, *, forsaken_s: float = FORSAKEN_S) -> None:
    below = chain.from_iterable(folders_below(folder, path) for path in plan.extra_dirs)
    for path in ("", DATA_FOLDER, PENDING_FOLDER, "reports", *below):
        folder.remove_stale_files(path, forsaken_s=forsaken_s)


def _run(
    work: _WriteShard,
    runner: Runner,
    state: BuildState,
    on_progress: Callable[[Progress], None],
    former: FormerSet | None,
) -> Iterable[ShardRecord]:
    sizes = {task.shard: task.size for task in state.todo}
    done, total = 0, sum(sizes.values())
    on_progress(Progress(done, total))
    for record in runner.run(work, state.todo):
        if former is not None and record.rows:
            former.give_up()  # there are rows of the new set
        done += sizes[record.shard]
        on_progress(Progress(done, total, record))
        yield record


def _require_tasks(folder: DataFolder, tasks: Sequence[ShardTask], records: Iterable[ShardRecord]) -> None:
    """Refuse to go on where a runner has not made exactly what it was given."""
    planned, made = {task.shard for task in tasks}, Counter(record.shard for record in records)
    wrong = sorted({*(planned - made.keys()), *(made - Counter(planned)).keys()})
    if wrong:
        names = ", ".join(map(str, wrong[:_CAUSES_SHOWN])) + (", ..." if len(wrong) > _CAUSES_SHOWN else "")
        message = (
            f"{len(wrong):,} of {len(planned):,} shards of {folder.address()!r} are missing, or were made "
            f"twice: {names}; expected one result of the runner for each; finished shards stay, and the data "
            "set is not complete; next: run the same command again, which makes only what is missing"
        )
        raise IntegrityError(message)


def _require_rows(records: Sequence[ShardRecord]) -> None:
    """Refuse a run that left every item out: its source, not its items, is what is wrong."""
    skipped = [item for record in records for item in record.skipped]
    if not skipped or any(record.rows for record in records):
        return
    first: dict[str, Skipped] = {}
    for item in skipped:
        first.setdefault(item.reason, item)
    causes = "; ".join(f"{reason}: {item.message}" for reason, item in list(first.items())[:_CAUSES_SHOWN])
    message = (
        f"no row is left: all {len(skipped):,} were left out, nothing was written; the first of each reason: "
        f"{causes}; next: mend the source, or choose another one"
    )
    raise (IntegrityError if set(first) == {DAMAGED} else InputError)(message)
