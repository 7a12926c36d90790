"""The main job: from a source of digit images to a finished data set folder, and what that would take."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mnist3d.card import write_card
from mnist3d.kind import KIND
from mnist3d.rows import PARQUET_STYLE, REPORT_FILE, MeshRow, mesh_table, report_table
from mnist3d.solid import SolidSpec, solidify
from mnist3d.sources import DigitSource
from mnist3d.sources.folder import FolderSource
from mnist3d.splits import SPLITS, SplitSpec, plan_splits
from tactile_toolkit.checked_fields import check_fields, integer
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh.printability import PrintProfile, PrintReport, inspect
from tactile_toolkit.run.processes import Runner, runner_for
from tactile_toolkit.store.build import Progress, build
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.forecast import Forecast, Sample, forecast_build
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import encode_parquet
from tactile_toolkit.store.plan import BuildPlan, ShardContent, require_known_splits
from tactile_toolkit.store.shards import ShardName, Skipped, shard_ranges
from tactile_toolkit.wording import counted

__all__ = ["DigitRecipe", "DigitShard", "GenerateSpec", "forecast", "generate", "make_row", "plan_build"]

# Spread over all splits, and still done in a second.
_SAMPLED = 8
# At 52.6 kB a mesh 7 MB: what a kill loses is seconds of work.
_LARGEST_SHARD = 128  # of sets of up to a million digits, see shard_ranges
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
    per_class: int | None = integer(None, 1, optional=True)
    limit: int | None = integer(None, 1, optional=True)

    def __post_init__(self) -> None:
        check_fields(self, "the data set's specification")

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


@dataclass(frozen=True, eq=False)
class DigitShard:
    """The task of one shard: from digit ids, in row order, to rows. Touches no file of the data set.

    ``ids`` are a view of the ids of the whole split; pickled are those of this shard alone.
    """

    shard: ShardName
    ids: NDArray[np.integer[Any]] = field(repr=False)
    spec: GenerateSpec = field(repr=False)

    @property
    def size(self) -> int:
        """How many digits it makes."""
        return len(self.ids)

    def make(self) -> ShardContent:
        """Make the rows and their print reports; digits that give no solid are listed instead."""
        import pyarrow as pa

        tables: list[Any] = []
        report_tables: list[Any] = []
        rows: list[MeshRow] = []
        reports: list[PrintReport] = []
        skipped: list[Skipped] = []

        def pack() -> None:
            tables.append(mesh_table(rows, self.spec.source.name))
            report_tables.append(report_table(self.shard, rows, reports))
            rows.clear()
            reports.clear()

        for digit_id in self.ids.tolist():
            try:
                row, report = make_row(digit_id, self.spec)
            except ItemError as error:
                skipped.append(Skipped(digit_id, error.reason, error.message))
                continue
            rows.append(row)
            reports.append(report)
            if len(rows) == _LARGEST_SHARD:  # so that large shards are not held twice
                pack()
        if rows or not tables:
            pack()
        return ShardContent(pa.concat_tables(tables), tuple(skipped), pa.concat_tables(report_tables))


def make_row(digit_id: int, spec: GenerateSpec) -> tuple[MeshRow, PrintReport]:
    """Read one digit, make its solid and inspect it.

    Raises ItemError when the image cannot be used, or the mesh does not bound a solid (the reason is one of
    :data:`tactile_toolkit.mesh.solid_check.PROBLEMS`).
    """
    digit = spec.source.image(digit_id)
    try:
        mesh = solidify(digit.pixels, spec.solid, ink="dark")
    except ItemError as error:
        message = f"digit {digit_id} of source {spec.source.name!r}: {error.message}"
        raise ItemError(error.reason, message) from error
    report = inspect(mesh, spec.profile)
    # An image gives no row unless its mesh was proved: what is stored are solids.
    if report.problem is not None:
        message = f"digit {digit_id} of source {spec.source.name!r} gives no valid solid: {report.detail}"
        raise ItemError(report.problem, message)
    return MeshRow(digit.id, digit.label, mesh, digit.writer, report.volume_mm3 * 1e-9), report


def plan_build(spec: GenerateSpec, splits: Sequence[str] | None) -> BuildPlan:
    """Decide which shards hold which digits; pure, reads only the source's catalog.

    Without ``splits`` all are made, and pictures of one's own are not divided unless the specification asks
    for it. Raises InputError for an unknown split, nothing to make, or a source that cannot be read.
    """
    if splits is None:
        splits = SPLITS
        if isinstance(spec.source, FolderSource) and spec.split.by is None and spec.split.sizes is None:
            spec = replace(spec, split=replace(spec.split, by="none"))
    require_known_splits(splits, SPLITS)
    plan = plan_splits(spec.source.catalog(), spec.split)
    tasks = []
    # However they are asked for, tasks stand in canonical order, and so do shards in the manifest.
    for split in (split for split in SPLITS if split in splits):
        ids = plan.rows(split, spec.per_class, spec.limit)
        shards = shard_ranges(
            split, len(ids), smallest=_SMALLEST_SHARD, largest=_LARGEST_SHARD, wanted=_SHARDS_WANTED
        )
        tasks += [DigitShard(shard, ids[rows.start : rows.stop], spec) for shard, rows in shards]
    if not tasks:
        sizes = {split: len(plan.ids[split]) for split in SPLITS}
        message = (
            f"no digits to make for {', '.join(splits)}: the source {spec.source.name!r} gives {sizes}; "
            "next: choose another --split, or --split-sizes"
        )
        raise InputError(message)
    return BuildPlan(
        KIND.name,
        spec.to_dict(),
        SPLITS,
        tuple(tasks),
        PARQUET_STYLE,
        REPORT_FILE,
        # What decides bytes: to go on in an unfinished folder with others is refused.
        libraries=("manifold3d", "numpy", "pillow", "pyarrow", "scikit-image", "scipy"),
    )


def generate(
    spec: GenerateSpec,
    out: str | os.PathLike[str],
    splits: Sequence[str] | None = None,
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
    splits : sequence of str, optional
        Splits to make; others that the folder holds already stay. By default all; of a folder of pictures
        one, ``train``, with every picture, unless ``spec.split`` says how to divide them.
    workers : int or Runner
        Number of local processes, or a runner of another kind.
    overwrite : bool
        Start again in a folder that holds another data set of this toolkit.
    on_progress : callable
        Called with the :class:`~tactile_toolkit.store.build.Progress` after each shard.

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
    return build(
        DataFolder(os.fspath(out)),
        plan_build(spec, splits),
        runner_for(workers),
        overwrite=overwrite,
        on_progress=on_progress,
        write_card=write_card,
    )


def forecast(
    spec: GenerateSpec,
    out: str | os.PathLike[str],
    splits: Sequence[str] | None,
    workers: int | Runner,
    *,
    overwrite: bool = False,
) -> Forecast:
    """Estimate a run of :func:`generate` by making a few of its digits; writes nothing."""
    plan = plan_build(spec, splits)
    ids = np.concatenate([task.ids for task in plan.tasks if isinstance(task, DigitShard)])
    # Spread over the splits asked for.
    sample = ids[:: max(1, len(ids) // _SAMPLED)][:_SAMPLED].tolist()

    def measure() -> Sample:
        rows = []
        failures: list[ItemError] = []
        start_s = 0.0
        for count, digit_id in enumerate(sample):
            try:
                rows.append(make_row(digit_id, spec)[0])
            except ItemError as error:
                failures.append(error)
            finally:
                # The first digit pays for the imports.
                start_s = time.perf_counter() if count == 0 else start_s
        if not rows:
            message = (
                f"none of {counted(len(sample), 'digits')} that were tried gives a solid; the first: "
                f"{failures[0].message}; nothing was written; next: mend the source, or choose another one"
            )
            raise InputError(message)
        size = len(encode_parquet(mesh_table(rows, spec.source.name), PARQUET_STYLE))
        elapsed_s = time.perf_counter() - start_s
        return Sample(len(rows), size / len(rows), elapsed_s / max(1, len(sample) - 1))

    return forecast_build(out, plan, workers, measure, overwrite=overwrite)


@dataclass(frozen=True, slots=True)
class DigitRecipe:
    """How a data set of digits is made without any input: from the embedded synthetic source."""

    seed: int
    per_class: int | None
    splits: tuple[str, ...] = SPLITS

    def spec(self) -> Any:
        """Return the specification."""
        from mnist3d.sources.synthetic import SyntheticSource

        source = SyntheticSource(seed=self.seed)
        return GenerateSpec(source, split=SplitSpec(seed=self.seed), per_class=self.per_class)

    def begun(self, spec: Mapping[str, Any]) -> DigitRecipe:
        """Return the recipe of a folder with this specification."""
        return DigitRecipe(dict(spec.get("split") or {}).get("seed", 0), spec.get("per_class"))

    def arguments(self, split: str) -> str:
        """Return the arguments of the command that makes a split."""
        limit = "" if self.per_class is None else f" --per-class {self.per_class}"
        return f"--split {split}{limit}" + (f" --seed {self.seed}" if self.seed else "")

    def make(self, out: str, split: str, workers: int) -> None:
        """Make one split."""
        generate(self.spec(), out, (split,), workers=workers)
