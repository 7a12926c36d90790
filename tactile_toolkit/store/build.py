"""Building a data set folder: plan, resume, run, merge.

The kinds of data (digits, scenes) bring a :class:`BuildPlan`; this module gives all of them the same
behaviour: interrupted work goes on, finished work is never made twice, another specification is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from itertools import chain

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.run.processes import Runner
from tactile_toolkit.store.folder import DataFolder, folders_below, named_failures
from tactile_toolkit.store.manifest import (
    Manifest,
    parts_beside,
    read_manifest,
    remove_parts,
    write_manifest,
    write_receipt,
)
from tactile_toolkit.store.plan import BuildPlan, ShardContent, ShardTask
from tactile_toolkit.store.replace import Before, FormerSet, recover
from tactile_toolkit.store.reports import merge_reports
from tactile_toolkit.store.resume import BuildState, inspect_folder
from tactile_toolkit.store.shards import (
    DATA_FOLDER,
    PARTS_FOLDER,
    ParquetStyle,
    Receipt,
    encode_parquet,
    sha256_hex,
)

__all__ = ["BuildPlan", "BuildState", "Progress", "ShardContent", "ShardTask", "build", "inspect_folder"]


@dataclass(frozen=True)
class Progress:
    """Told once before the work and after each shard: items done and to do in this run."""

    done: int
    total: int
    receipt: Receipt | None = None


@dataclass(frozen=True)
class _WriteShard:
    """Picklable: make one shard and write it with its receipt."""

    folder: DataFolder
    style: ParquetStyle = field(repr=False)

    def __call__(self, task: ShardTask) -> Receipt:
        """Write rows, then report rows, then the receipt that vouches for both."""
        content = task.make()
        data = encode_parquet(content.table, self.style)
        self.folder.write_bytes(task.shard.data_path, data)
        report_sha256 = None
        if content.report is not None:
            report = encode_parquet(content.report, ParquetStyle(rows_per_group=1 << 16))
            self.folder.write_bytes(task.shard.report_path, report)
            report_sha256 = sha256_hex(report)
        receipt = Receipt(
            task.shard,
            content.table.num_rows,
            len(data),
            sha256_hex(data),
            report_sha256,
            content.skipped,
            content.statistics,
        )
        write_receipt(self.folder, receipt)
        return receipt


def build(
    folder: DataFolder,
    plan: BuildPlan,
    runner: Runner,
    *,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Manifest:
    """Make what the folder lacks of the plan and return the manifest.

    A run that fails keeps the shards that it finished; one that finished none leaves the folder as it was,
    with ``overwrite`` too. The manifest is complete when nothing that any run began is left to do.

    Raises
    ------
    SpecMismatchError
        The folder holds a data set of another specification, and ``overwrite`` is False.
    InputError
        The folder holds files that are not a data set of this toolkit.
    IntegrityError
        The plan needs rows, and every item was left out; the folder is as it was.
    StorageError
        The folder cannot be written, or the disk is full. Finished shards stay.
    """
    with named_failures(folder.address()):
        there = folder.exists()
    folder.require_folder()
    recover(folder)
    former = FormerSet.set_aside(folder, plan.trees) if overwrite else None
    state = inspect_folder(folder, plan)
    before = Before.of(folder, there, former)
    try:
        _prepare(folder, plan, state)
        receipts = [*state.kept, *_run(folder, plan, runner, state, _told(on_progress, former))]
        manifest = state.manifest.with_receipts(receipts)
        _require_rows(plan, manifest)
    except BaseException:
        _remove_leavings(folder, plan)  # of workers that were stopped in the middle of a file
        before.restore_unless_finished(folder, plan, state)
        raise
    if former is not None:
        former.give_up()
    return _finish(folder, plan, manifest)


def _told(on_progress: Callable[[Progress], None], former: FormerSet | None) -> Callable[[Progress], None]:
    """Let the former set go once there are rows of the new one."""
    if former is None:
        return on_progress

    def tell(progress: Progress) -> None:
        if progress.receipt is not None and progress.receipt.rows:
            former.give_up()
        on_progress(progress)

    return tell


def _require_rows(plan: BuildPlan, manifest: Manifest) -> None:
    skipped = [item for receipt in manifest.receipts for item in receipt.skipped]
    if plan.needs_rows and skipped and not any(receipt.rows for receipt in manifest.receipts):
        message = (
            f"no row is left: all {len(skipped):,} were left out, nothing was written; the first: "
            f"{skipped[0].message}"
        )
        raise IntegrityError(message)


def _prepare(folder: DataFolder, plan: BuildPlan, state: BuildState) -> None:
    _remove_leavings(folder, plan)
    if state.todo:
        # Named before the first shard, so that an interrupted folder knows what it was to become.
        redone = {task.shard for task in state.todo}
        receipts = tuple(entry for entry in state.manifest.receipts if entry.shard not in redone)
        write_manifest(folder, replace(state.manifest, receipts=receipts, complete=False))


def _remove_leavings(folder: DataFolder, plan: BuildPlan) -> None:
    below = chain.from_iterable(folders_below(folder, tree) for tree in plan.trees)
    for place in ("", DATA_FOLDER, PARTS_FOLDER, "reports", *below):
        folder.remove_stale_temporaries(place)


def _run(
    folder: DataFolder,
    plan: BuildPlan,
    runner: Runner,
    state: BuildState,
    on_progress: Callable[[Progress], None],
) -> Iterable[Receipt]:
    total = sum(task.size for task in state.todo)
    sizes = {task.shard: task.size for task in state.todo}
    done = 0
    on_progress(Progress(done, total))
    for receipt in runner.run(_WriteShard(folder, plan.style), state.todo):
        done += sizes[receipt.shard]
        on_progress(Progress(done, total, receipt))
        yield receipt


def _finish(folder: DataFolder, plan: BuildPlan, manifest: Manifest) -> Manifest:
    files = dict(manifest.files or {})
    if plan.report_file is not None:
        files[plan.report_file] = merge_reports(folder, plan.report_file, manifest)
    # Shards of a split that another run began stay its own until that run is given again.
    begun = parts_beside(folder, manifest)
    finished = replace(manifest, files=files, complete=not begun)
    if read_manifest(folder) != finished:
        write_manifest(folder, finished)
    _remove_leavings(folder, plan)  # once more: workers of a killed run may have lived on for a moment
    remove_parts(folder, keep=begun)
    return finished
