"""Generation of a data set folder from a specification, for every kind of data set."""

from __future__ import annotations

import os
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias, Unpack

import pyarrow as pa

from tactile_toolkit import errors, store, wording
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.run import usable_cores
from tactile_toolkit.store.building import require_replaceable
from tactile_toolkit.store.job import BuildJob
from tactile_toolkit.store.manifest import require_rows, shard_ranges
from tactile_toolkit.value_types import Int64, JsonDict, JsonObject

if TYPE_CHECKING:
    from tactile_toolkit.mesh import Mesh

# Time in which workers start and import their libraries, seconds.
_START_S = 1.5


@dataclass(frozen=True)
class StorageLayout:
    """Storage layout of the rows of a kind of data set.

    Attributes
    ----------
    style : ParquetStyle
        Parquet layout of the shards.
    libraries : tuple of str
        Distributions whose versions decide bytes.
    smallest, largest, usual_shards : int
        Rows of a shard, and the number of shards of a medium split; see
        :func:`~tactile_toolkit.store.shard_ranges`.
    sampled : int
        Number of items from which the time and size of a run are estimated.
    report_file : str or None
        Path of the report; None without one.
    together : int
        Number of consecutive items with a common source, which share a shard if possible.
    """

    style: store.ParquetStyle
    libraries: tuple[str, ...]
    smallest: int = 1
    largest: int = 1
    usual_shards: int = 1
    sampled: int = 1
    report_file: str | None = None
    together: int = 1


AnyRows: TypeAlias = Sequence[Any]
"""Rows, or what each is made from; only their kind of data set knows the type."""


class RowGenerator(ABC):
    """Generator of the rows of a kind, of which :meth:`generate` makes a folder.

    A small picklable value, usually a frozen dataclass of a specification: each task carries it to the
    process that makes the rows.
    """

    kind: DatasetKind
    spec: Any  # has `to_dict`
    kernels: ClassVar[tuple[str, ...]] = ()
    """Modules whose kernels state their types (``tactile_toolkit.kernels.compiled``), which all rows need."""

    def manifest(self) -> JsonObject:
        """Return JSON values that identify the rows; two equal values give equal Parquet."""
        values: JsonObject = self.spec.to_dict()
        return values

    @abstractmethod
    def items(self) -> JsonObject:
        """Return the items of each split, a sequence or array; splits in canonical order."""

    @abstractmethod
    def layout(self) -> StorageLayout:
        """Return the storage layout of rows."""

    @abstractmethod
    def schema(self, split: str) -> pa.Schema:
        """Return the Arrow schema of the shards of a split."""

    @abstractmethod
    def make(self, split: str, items: AnyRows) -> Iterable[Any | store.Skipped]:
        """Yield the row of each item, or the reason for none; touches no file of the data set."""

    def report(self, shard: store.ShardName, rows: AnyRows) -> pa.Table | None:
        """Return the report about the rows of a shard, an Arrow table; None without a report."""
        return None

    def next_if_other(self) -> str:
        """Return the next step if a folder holds rows of another specification; "" for the usual one."""
        return ""

    def statistics(self, rows: AnyRows) -> JsonObject | None:
        """Return JSON values about rows for the manifest, which add up over shards."""
        return None

    def generate(
        self,
        out: str | os.PathLike[str],
        splits: Sequence[str] | None = None,
        *,
        require: Callable[[], None] = lambda: None,
        **run: Unpack[store.RunKeywords],
    ) -> store.Manifest:
        """Make a data set folder.

        A folder with a finished or interrupted run of the same specification is completed: finished shards
        are kept. The same specification gives byte-identical Parquet for any number of workers and
        interruptions.

        Parameters
        ----------
        out : str or path-like
            Folder to write.
        splits : sequence of str, optional
            Splits to make, all by default; other splits of the folder are kept.
        require : callable
            Raises the reason to refuse the run, after its plan was made.
        **run
            Fields of :class:`~tactile_toolkit.store.RunOptions`, such as ``workers`` and ``overwrite``.

        Returns
        -------
        Manifest
            Manifest of the folder.
        """
        plan = plan_build(self, splits)
        require()
        return store.build(store.open_folder(os.fspath(out)), plan, write_card=self.kind.write_card, **run)

    def forecast(
        self,
        out: str | os.PathLike[str],
        splits: Sequence[str] | None = None,
        *,
        require: Callable[[], None] = lambda: None,
        **run: Unpack[store.RunKeywords],
    ) -> Forecast:
        """Estimate a run of :meth:`generate` by making some of its rows; writes nothing.

        With ``part``, only the shards of that part count. Raises as the run would before its first row.
        """
        options = store.RunOptions(**run)
        plan = plan_build(self, splits)
        require()
        folder = store.open_folder(os.fspath(out))
        if options.overwrite and require_replaceable(folder, plan):
            job = BuildJob(folder, plan, plan.new_manifest(), plan.tasks)
        else:
            job = plan.compared_with(folder, options)
        rows = Counter[str]()
        left = Counter[str]()
        for task in job.tasks:
            rows[task.shard.split] += task.size
        for task in job.remaining:
            left[task.shard.split] += task.size
        shards = Counter(task.shard.split for task in job.tasks)
        sampled, item_bytes, item_s = _sample(self, plan)
        # A runner that states no number, or 0, is taken for one worker, or for one per core.
        processes = (
            options.workers if isinstance(options.workers, int) else getattr(options.workers, "workers", 1)
        )
        processes = processes or usable_cores()
        seconds = round(left.total() * item_s / processes + _START_S, 1) if left else 0.0
        return Forecast(
            [
                {
                    "split": split,
                    "rows": rows[split],
                    "shards": shards[split],
                    "finished": rows[split] - left[split],
                }
                for split in rows
            ],
            left.total(),
            round(left.total() * item_bytes),
            seconds,
            sampled,
            _existing_rows(folder) if options.overwrite else None,
        )


def make_shard(generator: RowGenerator, shard: store.ShardName, items: AnyRows) -> store.ShardContent:
    """Make the rows of a shard, and list items that give none."""
    if generator.kernels:
        from tactile_toolkit.kernels import prepare  # numba

        prepare(*generator.kernels)
    made = list(generator.make(shard.split, items))
    rows = [row for row in made if not isinstance(row, store.Skipped)]
    skipped = tuple(row for row in made if isinstance(row, store.Skipped))
    with store.without_collecting():
        schema = generator.schema(shard.split)
        table = type(rows[0]).table(rows, schema) if rows else schema.empty_table()
    return store.ShardContent(table, skipped, generator.report(shard, rows), generator.statistics(rows))


def plan_build(generator: RowGenerator, splits: Sequence[str] | None = None) -> store.BuildPlan:
    """Divide items into shards; writes nothing. InputError for an unknown split, or if there are no items."""
    items = generator.items()
    layout = generator.layout()
    known = tuple(items)
    chosen_splits = splits or known
    for split in chosen_splits:
        if split not in known:
            raise errors.InputError(
                f"unknown split {split!r}; expected {wording.alternatives([*known, 'all'])}",
                next="choose one of them",
            )
    # Tasks are in canonical order, whatever the order of ``splits``, and so are shards in the manifest.
    chosen = {split: split_items for split, split_items in items.items() if split in chosen_splits}
    tasks = tuple(
        store.ShardTask(shard, split_items[rows.start : rows.stop], partial(make_shard, generator))
        for split, split_items in chosen.items()
        for shard, rows in shard_ranges(
            split,
            len(split_items),
            smallest=layout.smallest,
            largest=layout.largest,
            usual_shards=layout.usual_shards,
            together=layout.together,
        )
    )
    if not tasks:
        sizes = {split: len(split_items) for split, split_items in items.items()}
        raise errors.InputError(
            f"no {generator.kind.nouns} to make for {', '.join(chosen_splits)}: the splits have {sizes}",
            next="choose another --split, or larger ones",
        )
    return store.BuildPlan(
        generator.kind.name,
        generator.manifest(),
        known,
        tasks,
        layout.style,
        layout.report_file,
        libraries=layout.libraries,
        other_next=generator.next_if_other(),
    )


@dataclass(frozen=True, slots=True)
class Forecast:
    """Forecast of a run.

    ``splits`` states for each split the number of ``rows``, ``shards`` and ``finished`` rows. ``bytes`` of
    Parquet and ``seconds`` are estimated from ``sampled`` rows. ``replaced`` is the number of rows of each
    split of the data set that the run would replace; None if it would replace none.
    """

    splits: list[JsonDict]
    rows_to_make: int
    bytes: int
    seconds: float
    sampled: int
    replaced: dict[str, int] | None = None


def _sample(generator: RowGenerator, plan: store.BuildPlan) -> tuple[int, float, float]:
    """Make the first few items; return the number of their rows, and bytes and seconds per item."""
    first = plan.tasks[0]
    replace(first, items=first.items[:1]).make()  # imports modules and fills caches
    few = replace(first, items=first.items[: generator.layout().sampled])
    start_s = time.perf_counter()
    content = few.make()
    table = content.table
    if few.size == sum(task.size for task in plan.tasks):
        require_rows([(len(table), content.skipped)])
    size_bytes = len(plan.style.encode(table)) if len(table) else 0
    return len(table), size_bytes / few.size, (time.perf_counter() - start_s) / few.size


def _existing_rows(folder: store.DataFolder) -> dict[str, int] | None:
    """Return the number of rows of each split; empty if the manifest is damaged, None without one."""
    try:
        manifest = store.Manifest.so_far(folder)
    except errors.IntegrityError:
        return {}
    if manifest is None:
        return None
    return {name: row["rows"] for name, row in manifest.split_table().items()}


@dataclass(frozen=True, eq=False)
class PlannedMeshes:
    """Meshes of a split before they are made.

    ``ids`` and ``labels``, shape (n,), are in the order of the rows. ``make`` takes an id and returns its
    :class:`tactile_toolkit.mesh.Mesh`, as it will be stored. ``row_s`` is about how long a row takes on a
    core, seconds.
    """

    ids: Int64
    labels: Int64
    make: Callable[[int], Mesh]
    row_s: float


@dataclass(frozen=True)
class DefaultSet:
    """Default data set of a kind, which needs no input.

    ``options`` are those of the equivalent command, by name; None if it takes no ``--split``. ``plan_meshes``
    takes a split; None unless each mesh can be made by itself and all of them take long.
    """

    generator: RowGenerator
    options: JsonObject | None = None
    plan_meshes: Callable[[str], PlannedMeshes] | None = None

    @property
    def splits(self) -> tuple[str, ...]:
        """Splits that can be made, in order."""
        return tuple(self.generator.items())

    def arguments(self, split: str) -> str:
        """Return the arguments of the command that makes a split, except the folder."""
        if self.options is None:
            return ""
        options = {"split": split, **self.options}
        return " ".join(f"--{name} {value}" for name, value in options.items() if value)

    def make(self, out: str, split: str, **run: Unpack[store.RunKeywords]) -> None:
        """Make one split in a folder; an interrupted run continues."""
        self.generator.generate(out, (split,), **run)

    def rows_left(self, out: str, split: str) -> int:
        """Return the number of rows that :meth:`make` would make in a folder; raises as it would."""
        plan = plan_build(self.generator, (split,))
        return sum(task.size for task in plan.compared_with(store.open_folder(out)).remaining)
