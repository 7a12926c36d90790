"""Checking meshes as they are read back from disk, whoever wrote them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tactile_toolkit.catalog.locate import find_shards, splits_to_check
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.mesh.printability import UNREADABLE, PrintProfile, PrintReport, inspect, unreadable
from tactile_toolkit.read.columns import null_fields
from tactile_toolkit.read.parquet import RowGroup, Shard
from tactile_toolkit.run.processes import runner_for

__all__ = ["Checked", "CheckedItem", "validate_paths"]

_ROWS_SHOWN = 20
_COLUMNS = ("id", "label", "mesh.vertices", "mesh.faces")


@dataclass(frozen=True, slots=True)
class CheckedItem:
    """One mesh and what was found about it.

    Attributes
    ----------
    name : str
        File name, or split and id of a row.
    report : PrintReport
        The findings.
    """

    name: str
    report: PrintReport


@dataclass(frozen=True)
class Checked:
    """Everything found below one path.

    Attributes
    ----------
    path : str
        As given.
    items : tuple of CheckedItem
        One per mesh.
    """

    path: str
    items: tuple[CheckedItem, ...]

    @property
    def checked(self) -> int:
        """How many meshes were checked."""
        return len(self.items)

    @property
    def failed(self) -> int:
        """How many of them bound no solid."""
        return sum(not item.report.is_solid for item in self.items)

    @property
    def unreadable(self) -> tuple[CheckedItem, ...]:
        """Files, and rows, that no mesh could be read from."""
        return tuple(item for item in self.items if item.report.problem == UNREADABLE)

    def warnings(self) -> dict[str, int]:
        """Count the meshes that carry each print warning."""
        return dict(sorted(Counter(word for item in self.items for word in item.report.warnings).items()))

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "path": self.path,
            "checked": self.checked,
            "failed": self.failed,
            "warnings": self.warnings(),
            "meshes": [{"name": item.name, **_json_row(item.report)} for item in self.items],
        }

    def table(self) -> tuple[Sequence[str], Sequence[Sequence[object]], str]:
        """Return header, rows and title of a table of the meshes that fail or, of a few, all."""
        wall = "thinnest wall at half height mm"
        header = ("mesh", "solid", "volume mm³", "size mm", "bodies", wall, "findings")
        worth = [item for item in self.items if not item.report.is_solid]
        shown = self.items if len(self.items) <= _ROWS_SHOWN else worth[:_ROWS_SHOWN]
        words = ", ".join(f"{word} {count:,}" for word, count in self.warnings().items())
        title = f"{self.path}: {self.checked:,} checked, {self.failed:,} failed; warnings: {words or 'none'}"
        return header, [_table_row(item) for item in shown], title


@dataclass(frozen=True)
class _CheckRowGroup:
    """Picklable: check the meshes of one row group."""

    profile: PrintProfile = field(default_factory=PrintProfile)

    def __call__(self, task: _RowGroupTask) -> tuple[_RowGroupTask, tuple[CheckedItem, ...]]:
        import pyarrow as pa

        table = task.shard.read(groups=[task.group]).slice(0, task.rows).combine_chunks()
        nulls = null_fields(table, _COLUMNS)
        whole = [row for row in range(len(table)) if row not in nulls]
        # One null spoils its whole column; without such rows the others can be read.
        group = RowGroup(table.take(pa.array(whole, pa.int64())).combine_chunks() if nulls else table)
        vertices, faces = group.ragged("mesh.vertices"), group.ragged("mesh.faces")
        reports = {
            row: inspect(Mesh(vertices[place], faces[place]), self.profile) for place, row in enumerate(whole)
        }
        first_row = task.shard.group_starts[task.group]
        for row, name in nulls.items():
            where = f"split {task.split!r}, row {first_row + row} of {Path(task.shard.path).name}"
            reports[row] = unreadable(f"{where}: field {name!r} is null; expected a value")
        ids = table["id"].to_pylist()
        return task, tuple(
            CheckedItem(f"{task.split} {_named(ids[row], first_row + row)}", reports[row])
            for row in range(len(table))
        )


def _named(digit_id: int | None, row: int) -> str:
    return f"row {row}" if digit_id is None else str(digit_id)


@dataclass(frozen=True, order=True)
class _RowGroupTask:
    split: str
    position: int
    shard: Shard = field(compare=False)
    group: int
    rows: int


def validate_paths(
    paths: Sequence[str],
    split: str | None = None,
    limit: int | None = None,
    workers: int = 1,
    *,
    profile: PrintProfile | None = None,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> list[Checked]:
    """Check data set folders and mesh files.

    Parameters
    ----------
    paths : sequence of str
        Folders of data sets, and STL, 3MF, PLY, OBJ or GLB files.
    split : str, optional
        Only this split of folders.
    limit : int, optional
        Only the first so many rows of each split.
    workers : int
        Processes that check rows of folders.
    profile : PrintProfile, optional
        Printer and material.
    on_progress : callable
        Told meshes done and in all.

    Returns
    -------
    list of Checked
        One per path. A file that cannot be read is reported as no solid, and does not stop the others.

    Raises
    ------
    InputError
        A path does not exist, or is a folder without a data set.
    IntegrityError
        A shard is damaged, or the run that makes a data set is not finished.
    """
    profile = profile or PrintProfile()
    missing = [path for path in paths if not Path(path).exists()]
    if missing:
        message = f"{missing[0]!r} does not exist; expected a data set folder or a mesh file"
        raise InputError(message)
    results = []
    for path in paths:
        if Path(path).is_dir():
            items = _check_folder(path, split, limit, workers, profile, on_progress)
        else:
            items = (_check_file(path, profile),)
        results.append(Checked(path, items))
    return results


def _check_file(path: str, profile: PrintProfile) -> CheckedItem:
    from tactile_toolkit.mesh.files import read_mesh

    try:
        report = inspect(read_mesh(path), profile)
    except InputError as error:
        report = unreadable(str(error))
    return CheckedItem(Path(path).name, report)


def _check_folder(
    path: str,
    split: str | None,
    limit: int | None,
    workers: int,
    profile: PrintProfile,
    on_progress: Callable[[int, int], None],
) -> tuple[CheckedItem, ...]:
    splits = [split] if split else splits_to_check(path)
    tasks = [task for name in splits for task in _tasks(path, name, limit)]
    total = sum(task.rows for task in tasks)
    done = 0
    found = {}
    for task, items in runner_for(workers).run(_CheckRowGroup(profile), tasks):
        found[task] = items
        done += task.rows
        on_progress(done, total)
    return tuple(item for task in tasks for item in found[task])


def _tasks(path: str, split: str, limit: int | None) -> Iterator[_RowGroupTask]:
    left = limit
    for position, shard in enumerate(find_shards(path, split)):
        for group in range(shard.metadata.num_row_groups):
            rows = shard.group_starts[group + 1] - shard.group_starts[group]
            take = rows if left is None else min(rows, left)
            if take:
                yield _RowGroupTask(split, position, shard, group, take)
            left = None if left is None else left - take


def _json_row(report: PrintReport) -> dict[str, Any]:
    import math

    values = {**report.to_row(), "warnings": list(report.warnings)}
    # JSON has no NaN: what is unknown of a broken mesh is null.
    return {
        name: None if isinstance(value, float) and math.isnan(value) else value
        for name, value in values.items()
    }


def _table_row(item: CheckedItem) -> tuple[object, ...]:
    report = item.report
    if not report.is_solid:
        return (item.name, "NO", "-", "-", report.bodies, "-", report.detail or report.problem or "")
    size = " x ".join(f"{side:.1f}" for side in report.size_mm)
    words = ", ".join(report.warnings) or "none"
    return (
        item.name,
        "yes",
        f"{report.volume_mm3:.0f}",
        size,
        report.bodies,
        f"{report.thinnest_wall_mm:.2f}",
        words,
    )
