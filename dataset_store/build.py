"""Building a data set folder: plan, resume, run, merge.

The kinds of data (digits, scenes) bring a :class:`BuildPlan`; this module gives all of them the same
behaviour: interrupted work goes on, finished work is never made twice, another specification is refused.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from dataset_store.errors import InputError, SpecMismatchError
from dataset_store.manifest import MANIFEST_FILE, Manifest, read_manifest, write_manifest
from dataset_store.reports import merge_reports, report_rows_per_shard
from dataset_store.runner import Runner
from dataset_store.shards import (
    DATA_FOLDER,
    PARTS_FOLDER,
    ParquetStyle,
    Receipt,
    ShardName,
    Skipped,
    encode_parquet,
    file_sha256,
    sha256_hex,
)
from dataset_store.storage import DataFolder
from dataset_store.versions import toolkit_version

__all__ = ["BuildPlan", "BuildState", "Progress", "ShardContent", "ShardTask", "build", "inspect_folder"]


@dataclass(frozen=True)
class ShardContent:
    """The rows of one shard.

    Attributes
    ----------
    table : pyarrow.Table
        Rows.
    skipped : tuple of Skipped
        Items that gave no row.
    report : pyarrow.Table or None
        Report rows that go with them; merged over all shards into the plan's ``report_file``.
    statistics : dict or None
        Counts as JSON values, added up over the shards of a split in the manifest.
    """

    table: Any
    skipped: tuple[Skipped, ...] = ()
    report: Any = None
    statistics: Mapping[str, Any] | None = None


class ShardTask(Protocol):
    """The unit of work: a small picklable value from which any process makes the same rows."""

    @property
    def shard(self) -> ShardName:
        """Which shard it makes."""
        ...

    @property
    def size(self) -> int:
        """How many items it works on, for the progress bar."""
        ...

    def make(self) -> ShardContent:
        """Make the rows. Touches no file of the data set folder."""
        ...


@dataclass(frozen=True)
class BuildPlan:
    """What a folder is to hold.

    Attributes
    ----------
    kind : str
        Kind of data set, such as ``"mnist3d"``.
    spec : mapping
        Full specification as JSON values. Two plans with equal ``spec`` agree on every row.
    split_order : tuple of str
        Canonical order of the splits of this kind.
    tasks : tuple of ShardTask
        One per shard of the splits asked for.
    style : ParquetStyle
        Layout of the shards.
    report_file : str or None
        Path of the merged report, where shards have one.
    """

    kind: str
    spec: Mapping[str, Any]
    split_order: tuple[str, ...]
    tasks: tuple[ShardTask, ...]
    style: ParquetStyle
    report_file: str | None = None

    def __post_init__(self) -> None:
        # What is compared with a manifest has gone through JSON there: tuples became lists.
        object.__setattr__(self, "spec", json.loads(json.dumps(self.spec)))


@dataclass(frozen=True)
class Progress:
    """Told once before the work and after each shard: items done and to do in this run."""

    done: int
    total: int
    receipt: Receipt | None = None


@dataclass(frozen=True)
class BuildState:
    """What a folder holds already of a plan.

    Attributes
    ----------
    manifest : Manifest
        Manifest of the folder, or a new one.
    kept : tuple of Receipt
        Finished shards of the plan whose files still match.
    todo : tuple of ShardTask
        Tasks left.
    damaged : tuple of str
        Files that do not match their receipts any more and will be made again.
    """

    manifest: Manifest
    kept: tuple[Receipt, ...]
    todo: tuple[ShardTask, ...]
    damaged: tuple[str, ...]


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
        self.folder.write_bytes(task.shard.receipt_path, _receipt_text(receipt))
        return receipt


def build(
    folder: DataFolder,
    plan: BuildPlan,
    runner: Runner,
    *,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Manifest:
    """Make what the folder lacks of the plan and return the finished manifest.

    Raises
    ------
    SpecMismatchError
        The folder holds a data set of another specification, and ``overwrite`` is False.
    InputError
        The folder holds files that are not a data set of this toolkit.
    StorageError
        The folder cannot be written, or the disk is full. Finished shards stay.
    """
    folder.require_folder()
    if overwrite:
        _clear(folder)
    state = inspect_folder(folder, plan)
    _prepare(folder, state)
    try:
        receipts = [*state.kept, *_run(folder, plan, runner, state, on_progress)]
    except BaseException:
        _remove_leavings(folder)  # of workers that were stopped in the middle of a file
        raise
    return _finish(folder, plan, state.manifest.with_receipts(receipts))


def inspect_folder(folder: DataFolder, plan: BuildPlan) -> BuildState:
    """Compare a folder with a plan, changing nothing.

    Raises
    ------
    SpecMismatchError
        The folder was made by another specification; the message says what differs.
    InputError
        The folder holds something else.
    """
    manifest = read_manifest(folder)
    if manifest is None:
        _refuse_strangers(folder)
        manifest = Manifest(plan.kind, toolkit_version(), plan.spec, plan.split_order)
    _refuse_other_spec(folder, manifest, plan)
    reported = _report_check(folder, plan)
    known = {receipt.shard: receipt for receipt in (*manifest.receipts, *_part_receipts(folder))}
    kept, todo, damaged = [], [], []
    for task in plan.tasks:
        receipt = known.get(task.shard)
        if receipt is not None and _matches(folder, receipt) and reported(receipt):
            kept.append(receipt)
            continue
        todo.append(task)
        if receipt is not None:
            damaged.append(task.shard.data_path)
    return BuildState(manifest, tuple(kept), tuple(todo), tuple(damaged))


def _prepare(folder: DataFolder, state: BuildState) -> None:
    _remove_leavings(folder)
    if state.todo:
        # Named before the first shard, so that an interrupted folder knows what it was to become.
        redone = {task.shard for task in state.todo}
        receipts = tuple(entry for entry in state.manifest.receipts if entry.shard not in redone)
        write_manifest(folder, replace(state.manifest, receipts=receipts, complete=False))


def _remove_leavings(folder: DataFolder) -> None:
    for place in ("", DATA_FOLDER, PARTS_FOLDER, "reports"):
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
    finished = replace(manifest, files=files, complete=True)
    if read_manifest(folder) != finished:
        write_manifest(folder, finished)
    _remove_leavings(folder)  # once more: workers of a killed run may have lived on for a moment
    _remove_parts(folder)
    return finished


def _matches(folder: DataFolder, receipt: Receipt) -> bool:
    """Tell whether the file of a shard is there, whole and unchanged."""
    path = receipt.shard.data_path
    if not folder.exists(path) or folder.size_bytes(path) != receipt.bytes:
        return False
    return file_sha256(folder, path) == receipt.sha256


def _report_check(folder: DataFolder, plan: BuildPlan) -> Callable[[Receipt], bool]:
    """Return a test whether the report rows of a shard exist, in its own part or in the merged report."""
    merged = report_rows_per_shard(folder, plan.report_file) if plan.report_file else {}

    def reported(receipt: Receipt) -> bool:
        if receipt.report_sha256 is None:
            return True
        part = receipt.shard.report_path
        if folder.exists(part):
            return file_sha256(folder, part) == receipt.report_sha256
        return receipt.rows == 0 or merged.get(str(receipt.shard)) == receipt.rows

    return reported


def _part_receipts(folder: DataFolder) -> list[Receipt]:
    # Names with a dot in front are receipts that a writer has not finished, or never will.
    names = [n for n in folder.names(PARTS_FOLDER) if n.endswith(".json") and not n.startswith(".")]
    texts = [folder.read_bytes(f"{PARTS_FOLDER}/{name}") for name in names]
    return [Receipt.from_dict(json.loads(text)) for text in texts]


def _receipt_text(receipt: Receipt) -> bytes:
    return json.dumps(receipt.to_dict(), indent=1).encode()


def _refuse_strangers(folder: DataFolder) -> None:
    """Refuse a folder that holds somebody's files: a run must never mix with them or delete them."""
    strangers = [name for name in folder.names() if not name.startswith(".")]
    if strangers:
        message = (
            f"{folder.address()!r} is not empty and holds no {MANIFEST_FILE} (found {strangers[0]!r}); "
            "nothing was changed; next: choose an empty or new folder with --out"
        )
        raise InputError(message)


def _refuse_other_spec(folder: DataFolder, manifest: Manifest, plan: BuildPlan) -> None:
    differences = _differences(
        {"kind": manifest.kind, "toolkit_version": manifest.toolkit_version, **manifest.spec},
        {"kind": plan.kind, "toolkit_version": toolkit_version(), **plan.spec},
    )
    if differences:
        message = (
            f"{folder.address()!r} holds a data set of another specification: {'; '.join(differences)}; "
            "nothing was changed; next: choose another --out, or start again there with --overwrite"
        )
        raise SpecMismatchError(message)


def _differences(there: Any, wanted: Any, path: str = "") -> list[str]:
    if isinstance(there, Mapping) and isinstance(wanted, Mapping):
        keys = [*there, *(key for key in wanted if key not in there)]
        return [
            line
            for key in keys
            for line in _differences(there.get(key), wanted.get(key), f"{path}.{key}".lstrip("."))
        ]
    return [] if there == wanted else [f"{path} is {there!r} there, {wanted!r} was asked for"]


def _clear(folder: DataFolder) -> None:
    """Remove a data set of ours; anything else is refused."""
    manifest_there = folder.exists(MANIFEST_FILE)
    if not manifest_there:
        _refuse_strangers(folder)
    for place in (DATA_FOLDER, PARTS_FOLDER, "reports", "previews"):
        for name in folder.names(place):
            folder.remove(f"{place}/{name}")
        folder.remove_empty(place)
    for name in ("README.md", MANIFEST_FILE):
        folder.remove(name)


def _remove_parts(folder: DataFolder) -> None:
    for name in folder.names(PARTS_FOLDER):
        folder.remove(f"{PARTS_FOLDER}/{name}")
    folder.remove_empty(PARTS_FOLDER)
