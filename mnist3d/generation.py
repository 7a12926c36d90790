"""The main job: from a source of digit images to a finished data set folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from mnist3d.card import write_card
from mnist3d.kind import KIND
from mnist3d.report import REPORT_FILE, report_table
from mnist3d.rows import PARQUET_STYLE, MeshRow, mesh_table
from mnist3d.solid import SolidSpec, solidify
from mnist3d.sources import DigitSource
from mnist3d.splits import SPLITS, SplitPlan, SplitSpec, plan_splits
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh.printability import PrintProfile, PrintReport, inspect
from tactile_toolkit.run.processes import Runner, runner_for
from tactile_toolkit.store.build import BuildPlan, BuildState, Progress, ShardContent, build, inspect_folder
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.shards import ShardName, Skipped
from tactile_toolkit.wording import plain_number

__all__ = ["DigitShard", "GenerateSpec", "generate", "inspect_out", "make_row", "plan_build"]

_LARGEST_SHARD = 128
_SMALLEST_SHARD = 50
_SHARDS_WANTED = 16


@dataclass(frozen=True)
class GenerateSpec:
    """Everything that decides which rows a data set holds.

    Attributes
    ----------
    source : DigitSource
        Where the images come from.
    solid : SolidSpec
        How an image becomes a solid.
    split : SplitSpec
        Which digit goes into which split.
    profile : PrintProfile
        What counts as printable.
    per_class : int or None
        Make only the first so many of each class of a split.
    limit : int or None
        Then make only the first so many rows of a split.

    Notes
    -----
    The splits made in one call and the number of workers are not part of it: a folder can be filled split by
    split, on any machine.
    """

    source: DigitSource
    solid: SolidSpec = field(default_factory=SolidSpec)
    split: SplitSpec = field(default_factory=SplitSpec)
    profile: PrintProfile = field(default_factory=PrintProfile)
    per_class: int | None = None
    limit: int | None = None

    def __post_init__(self) -> None:
        for option, name in (("--per-class", "per_class"), ("--limit", "limit")):
            value = plain_number(getattr(self, name))
            object.__setattr__(self, name, value)
            if value is not None and (not isinstance(value, int) or value < 1):
                message = f"{option} is {value!r}; expected a whole number of at least 1"
                raise InputError(message)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values that identify the rows; two equal values give equal Parquet."""
        return {
            "source": self.source.fingerprint(),
            "solid": self.solid.to_dict(),
            "split": self.split.to_dict(),
            "print_profile": asdict(self.profile),
            "per_class": self.per_class,
            "limit": self.limit,
        }


@dataclass(frozen=True)
class DigitShard:
    """The task of one shard: from digit ids to rows. Small, picklable, touches no file of the data set.

    Attributes
    ----------
    shard : ShardName
        Which shard.
    ids : tuple of int
        Digits in row order.
    spec : GenerateSpec
        How they are made.
    """

    shard: ShardName
    ids: tuple[int, ...] = field(repr=False)
    spec: GenerateSpec = field(repr=False)

    @property
    def size(self) -> int:
        """How many digits it makes."""
        return len(self.ids)

    def make(self) -> ShardContent:
        """Make the rows and their print reports; digits that give no solid are listed instead."""
        rows: list[MeshRow] = []
        reports: list[PrintReport] = []
        skipped: list[Skipped] = []
        for digit_id in self.ids:
            try:
                row, report = make_row(digit_id, self.spec)
            except ItemError as error:
                skipped.append(Skipped(digit_id, error.reason, error.message))
                continue
            rows.append(row)
            reports.append(report)
        table = mesh_table(rows, self.spec.source.name)
        return ShardContent(
            table, tuple(skipped), report_table(str(self.shard), self.shard.split, rows, reports)
        )


def make_row(digit_id: int, spec: GenerateSpec) -> tuple[MeshRow, PrintReport]:
    """Read one digit, make its solid and inspect it.

    Raises
    ------
    ItemError
        When the image cannot be used, or the mesh does not bound a solid (the reason is one of
        :data:`tactile_toolkit.mesh.solid_check.PROBLEMS`).
    """
    digit = spec.source.image(digit_id)
    try:
        mesh = solidify(digit.pixels, spec.solid)
    except ItemError as error:
        message = f"digit {digit_id} of source {spec.source.name!r}: {error.message}"
        raise ItemError(error.reason, message) from error
    report = inspect(mesh, spec.profile)
    if report.problem is not None:
        message = f"digit {digit_id} of source {spec.source.name!r} gives no valid solid: {report.detail}"
        raise ItemError(report.problem, message)
    return MeshRow(digit.id, digit.label, mesh, digit.writer, report.volume_mm3 * 1e-9), report


def plan_build(spec: GenerateSpec, splits: Sequence[str]) -> BuildPlan:
    """Decide which shards hold which digits; pure, reads only the source's catalog.

    Parameters
    ----------
    spec : GenerateSpec
        What to make.
    splits : sequence of str
        Splits asked for.

    Raises
    ------
    InputError
        Unknown split, nothing to make, or a source that cannot be read.
    """
    for split in splits:
        if split not in SPLITS:
            message = f"unknown split {split!r}; expected one of {', '.join(SPLITS)}, or all"
            raise InputError(message)
    plan = plan_splits(spec.source.catalog(), spec.split)
    tasks = [task for split in SPLITS if split in splits for task in _split_tasks(spec, plan, split)]
    if not tasks:
        sizes = {split: len(plan.ids[split]) for split in SPLITS}
        message = (
            f"no digits to make for {', '.join(splits)}: the source {spec.source.name!r} gives {sizes}; "
            "next: choose another --split, or --split-sizes"
        )
        raise InputError(message)
    return BuildPlan(KIND.name, spec.to_dict(), SPLITS, tuple(tasks), PARQUET_STYLE, REPORT_FILE)


def generate(
    spec: GenerateSpec,
    out: str | os.PathLike[str],
    splits: Sequence[str] = SPLITS,
    *,
    workers: int | Runner = 1,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Manifest:
    """Make a data set of printable 3D digits.

    A folder that holds a finished or interrupted run of the same specification is completed: finished shards
    are kept. The same specification gives byte-identical Parquet whatever the number of workers and however
    often the run was interrupted.

    Parameters
    ----------
    spec : GenerateSpec
        What to make.
    out : str or path-like
        Folder to write.
    splits : sequence of str
        Splits to make; others that the folder holds already stay.
    workers : int or Runner
        Number of local processes, or a runner of another kind.
    overwrite : bool
        Start again in a folder that holds another data set of this toolkit.
    on_progress : callable
        Told after each shard.

    Returns
    -------
    Manifest
        What the folder holds now.

    Raises
    ------
    InputError
        The source or an option cannot be used.
    SpecMismatchError
        The folder holds a data set of another specification.
    StorageError
        The folder cannot be written. What was finished stays.
    """
    folder = DataFolder(os.fspath(out))
    plan = plan_build(spec, splits)
    runner = runner_for(workers)
    manifest = build(folder, plan, runner, overwrite=overwrite, on_progress=on_progress)
    write_card(folder, manifest)
    return manifest


def inspect_out(
    spec: GenerateSpec, out: str | os.PathLike[str], splits: Sequence[str] = SPLITS
) -> BuildState:
    """Tell what :func:`generate` would keep and make, changing nothing."""
    return inspect_folder(DataFolder(os.fspath(out)), plan_build(spec, splits))


def _split_tasks(spec: GenerateSpec, plan: SplitPlan, split: str) -> list[DigitShard]:
    ids = plan.rows(split, spec.per_class, spec.limit).tolist()
    size = _rows_per_shard(len(ids))
    chunks = [ids[start : start + size] for start in range(0, len(ids), size)]
    return [
        DigitShard(ShardName(split, index, len(chunks)), tuple(chunk), spec)
        for index, chunk in enumerate(chunks)
    ]


def _rows_per_shard(rows: int) -> int:
    """Return a shard size that follows from the split alone, so that any number of workers agrees on it.

    A shard is what a worker holds in memory and what a kill loses; a small run still has some for each
    worker.
    """
    wanted = -(-rows // _SHARDS_WANTED)
    return min(_LARGEST_SHARD, max(_SMALLEST_SHARD, wanted))
