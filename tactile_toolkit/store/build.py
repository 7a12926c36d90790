"""Building a data set folder: plan, resume, run, merge.

The kinds of data (digits, scenes) bring a :class:`BuildPlan`; this module gives all of them the same
behaviour: interrupted work goes on, finished work is never made twice, another specification is refused.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import PurePosixPath
from typing import Any

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.run.processes import Runner
from tactile_toolkit.store.folder import DataFolder, folders_below, named_failures
from tactile_toolkit.store.manifest import (
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
    file_sha256,
    read_report,
    sha256_hex,
    unpacked_bytes,
    write_parquet,
)
from tactile_toolkit.store.plan import BuildPlan, BuildState, ShardTask, inspect_folder
from tactile_toolkit.store.replace import FolderBefore, FormerSet, recover
from tactile_toolkit.store.shards import DAMAGED, DATA_FOLDER, PENDING_FOLDER, ShardRecord, Skipped

__all__ = ["Progress", "build"]

_CAUSES_SHOWN = 3
_APPEARS_S = 30.0
"""How long a file may take to show on another machine; network file systems keep listings that long."""

WriteCard = Callable[[DataFolder, Manifest, Any], None]
"""Writes the card of a finished folder; the last argument is the merged report, or None without one."""


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
    libraries: tuple[str, ...] = ()

    def confirm(self, record: ShardRecord, machine: str) -> None:
        """Raise InputError when what another machine has written is not to be seen from this one."""
        path, deadline_s = record.shard.data_path, time.monotonic() + _APPEARS_S
        # Listed, not asked for by name: network file systems remember for a while that a name was not there.
        while PurePosixPath(path).name not in self.folder.names(DATA_FOLDER):
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
        content = task.make()
        table = content.table
        data, footer = write_parquet(table, self.style)
        self.folder.write_bytes(task.shard.data_path, data)
        report_sha256 = None
        if content.report is not None:
            report = encode_parquet(content.report, REPORT_STYLE)
            self.folder.write_bytes(task.shard.report_path, report)
            report_sha256 = sha256_hex(report)
        record = ShardRecord(
            task.shard,
            table.num_rows,
            len(data),
            sha256_hex(data),
            report_sha256,
            content.skipped,
            content.statistics,
            unpacked_bytes(footer, table.schema, lambda _: table),
        )
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

    Raises
    ------
    SpecMismatchError
        The folder holds a data set of another specification, and ``overwrite`` is False.
    InputError
        The folder holds files that are not a data set of this toolkit.
    InputError, IntegrityError
        Every item was left out, IntegrityError where all are damaged; the folder is as it was.
    StorageError
        The folder cannot be written, or the disk is full. Finished shards stay.
    """
    with named_failures(folder.address()):
        existed = folder.exists()
    folder.require_folder()
    recover(folder)
    former = FormerSet.set_aside(folder, plan.extra_dirs) if overwrite else None
    state = inspect_folder(folder, plan)
    before = FolderBefore.of(folder, existed, former)
    try:
        _remove_stale_files(folder, plan)
        if state.todo:
            # Named before the first shard, so that an interrupted folder knows what it was to become.
            redone = {task.shard for task in state.todo}
            kept = tuple(record for record in state.manifest.shards if record.shard not in redone)
            write_manifest(folder, replace(state.manifest, shards=kept, complete=False))
        records = [*state.kept, *_run(folder, plan, runner, state, on_progress, former)]
        manifest = state.manifest.with_shards(records)
        _require_rows(records)
    except BaseException:
        _remove_stale_files(folder, plan)  # of workers that were stopped in the middle of a file
        before.restore_unless_finished(folder, plan, state)
        raise
    if former is not None:
        former.give_up()
    files = dict(manifest.files or {})
    report = None
    if plan.report_file is not None:
        report, checksum = _merge_reports(folder, plan.report_file, manifest)
        files |= {plan.report_file: checksum} if report is not None else {}
    # Shards of a split that another run began stay its own until that run is given again.
    begun = pending_beside(folder, manifest)
    finished = replace(manifest, files=files, complete=not begun)
    # A run that had nothing to do leaves the file as it is, with its time.
    if state.todo or read_manifest(folder) != finished:
        write_manifest(folder, finished)
    _remove_stale_files(folder, plan)  # once more: workers of a killed run may have lived on for a moment
    remove_pending(folder, keep=begun)
    if write_card is not None:
        write_card(folder, finished, report)
    return finished


def _remove_stale_files(folder: DataFolder, plan: BuildPlan) -> None:
    below = chain.from_iterable(folders_below(folder, path) for path in plan.extra_dirs)
    for path in ("", DATA_FOLDER, PENDING_FOLDER, "reports", *below):
        folder.remove_stale_files(path)


def _run(
    folder: DataFolder,
    plan: BuildPlan,
    runner: Runner,
    state: BuildState,
    on_progress: Callable[[Progress], None],
    former: FormerSet | None,
) -> Iterable[ShardRecord]:
    sizes = {task.shard: task.size for task in state.todo}
    done, total = 0, sum(sizes.values())
    on_progress(Progress(done, total))
    for record in runner.run(_WriteShard(folder, plan.style, plan.libraries), state.todo):
        if former is not None and record.rows:
            former.give_up()  # there are rows of the new set
        done += sizes[record.shard]
        on_progress(Progress(done, total, record))
        yield record


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


def _merge_reports(folder: DataFolder, path: str, manifest: Manifest) -> tuple[Any, str]:
    """Write one report over all shards of the manifest and return it with its checksum.

    Rows of shards finished in an earlier run come from the report that run wrote; the order is always that
    of the manifest, so the bytes do not depend on the order of the work.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    earlier = None
    if folder.exists(path):
        # The rows of a damaged one are in pending reports again, see inspect_folder.
        with contextlib.suppress(IntegrityError):
            earlier = read_report(folder, path)
    tables = []
    for record in manifest.shards:
        if folder.exists(record.shard.report_path):
            tables.append(read_report(folder, record.shard.report_path))
        elif earlier is not None:
            tables.append(earlier.filter(pc.equal(earlier["shard"], str(record.shard))))
    if not tables:
        return None, ""
    report = pa.concat_tables(tables)
    content = encode_parquet(report, REPORT_STYLE)
    checksum = sha256_hex(content)
    if not folder.exists(path) or file_sha256(folder, path) != checksum:
        folder.write_bytes(path, content)
    return report, checksum
