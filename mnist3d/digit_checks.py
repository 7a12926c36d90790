"""Checks of the meshes of data sets and of single files, and what users of digits need for it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from mnist3d import digit_card
from mnist3d.kind import KIND
from tactile_toolkit import catalog, mesh, places, read, store
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.mesh import (
    Mesh as Mesh,
    PrintProfile as PrintProfile,
    PrintReport as PrintReport,
    read_mesh as read_mesh,
    write_mesh as write_mesh,
)
from tactile_toolkit.value_types import JsonDict

inspect = mesh.PrintReport.of
_ROWS_SHOWN = 20
_SHOWN = [
    column
    for name, column in mesh.PrintReport.columns().items()
    if name in ("bodies", "volume_mm3", "thinnest_wall_mm")
]


@dataclass(frozen=True, slots=True)
class CheckedMesh:
    """One mesh, named by its file or by split and id of its row, and what was found about it."""

    name: str
    report: mesh.PrintReport

    def to_dict(self) -> JsonDict:
        """Return JSON values."""
        values = {"name": self.name, **self.report.to_row()}
        # JSON has no NaN: unknown values of a broken mesh are null.
        return {
            name: None if isinstance(value, float) and math.isnan(value) else value
            for name, value in values.items()
        }

    def table_row(self) -> tuple[object, ...]:
        """Return the cells of a row of :meth:`CheckedMeshes.table`."""
        report = self.report
        numbers = [digit_card.figure_text(column, getattr(report, column.name)) for column in _SHOWN]
        if not report.is_solid:
            findings = ", ".join((report.detail or report.problem or "", *report.notes))
            return (self.name, "NO", "-", *numbers, findings)
        size = " x ".join(f"{side:.1f}" for side in report.size_mm)
        return (self.name, "yes", size, *numbers, ", ".join((*report.warnings, *report.notes)) or "none")


@dataclass(frozen=True)
class CheckedMeshes:
    """Everything found in one data set or file, for a printer."""

    path: str
    items: tuple[CheckedMesh, ...]
    profile: mesh.PrintProfile
    is_file: bool = False

    @property
    def checked(self) -> int:
        """Number of checked meshes."""
        return len(self.items)

    @property
    def failed(self) -> int:
        """Number of meshes that do not bound a solid."""
        return sum(not item.report.is_solid for item in self.items)

    @property
    def unreadable(self) -> list[str]:
        """Reasons why files or rows could not be read."""
        reports = [item.report for item in self.items]
        return [report.detail or "" for report in reports if report.problem == report.UNREADABLE]

    def warnings(self) -> dict[str, int]:
        """Count the meshes with each print warning."""
        return dict(sorted(Counter(word for item in self.items for word in item.report.warnings).items()))

    def advice(self) -> Sequence[str]:
        """Return a line for each print warning: what to do about it, and of a file, what was measured."""
        if self.is_file:
            return self.items[0].report.explained(self.profile)
        return mesh.PrintReport.advice(self.warnings(), mesh.PrintReport.DATASET_OPTIONS)

    def to_dict(self) -> JsonDict:
        """Return JSON values."""
        return {
            "path": self.path,
            "checked": self.checked,
            "failed": self.failed,
            "warnings": self.warnings(),
            "meshes": [item.to_dict() for item in self.items],
        }

    def table(self) -> tuple[Sequence[str], Sequence[Sequence[object]], str]:
        """Return header, rows and title of a table of failed meshes, or of all if there are few."""
        header = ("mesh", "solid", "size, mm", *map(digit_card.heading, _SHOWN), "findings")
        failures = [item for item in self.items if not item.report.is_solid]
        shown = self.items if len(self.items) <= _ROWS_SHOWN else failures[:_ROWS_SHOWN]
        words = ", ".join(f"{word} {count:,}" for word, count in self.warnings().items())
        title = f"{self.path}: {self.checked:,} checked, {self.failed:,} failed; warnings: {words or 'none'}"
        return header, [item.table_row() for item in shown], title


def _unreadable(detail: str) -> mesh.PrintReport:
    return mesh.PrintReport(False, "NotTried", mesh.PrintReport.UNREADABLE, detail, 0, 0)


def _inspect_row(row: read.Row, profile: mesh.PrintProfile) -> mesh.PrintReport:
    try:
        row.integer("label")
        return mesh.PrintReport.of(mesh.SolidRecord(row), profile)
    except IntegrityError as error:
        return _unreadable(str(error))


def check_content(
    source: str | places.Place,
    split: str | None = None,
    limit: int | None = None,
    workers: int = 1,
    *,
    profile: mesh.PrintProfile | None = None,
    unit: str | None = None,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> CheckedMeshes:
    """Check the meshes of a data set, or a mesh file.

    Parameters
    ----------
    source : str or Place
        A data set, or an STL, 3MF, PLY, OBJ or GLB file; an unreadable file is reported as such.
    split, limit : optional
        Check only this split of a data set, and only the first ``limit`` rows of each split.
    workers : int
        Number of processes that check rows of a data set.
    profile : PrintProfile, optional
        Printer and material.
    unit : str, optional
        Unit of a mesh file, as in :func:`mnist3d.read_mesh`.
    on_progress : callable
        Called with the numbers of meshes done and in total.

    Raises
    ------
    InputError
        The path does not exist, or is not a data set of digits or other meshes.
    IntegrityError
        A shard is damaged, or the run that makes the data set is not finished.
    """
    profile = profile or mesh.PrintProfile()
    if isinstance(source, str) and is_mesh_file(source):
        try:
            report = mesh.PrintReport.of(mesh.read_mesh(source, unit=unit), profile)
        except InputError as error:
            report = _unreadable(str(error))
        return CheckedMeshes(source, (CheckedMesh(Path(source).name, report),), profile, is_file=True)
    opened = places.open_place(source)
    mesh.refuse_unit(unit, opened.name)
    return check_meshes(opened, KIND, split, limit, workers, profile, on_progress)


def check_meshes(
    opened: places.Place,
    kind: DatasetKind,
    split: str | None,
    limit: int | None,
    workers: int,
    profile: mesh.PrintProfile,
    on_progress: Callable[[int, int], None],
) -> CheckedMeshes:
    """Check the rows of a data set of one mesh each; arguments and errors as of :func:`check_content`."""
    check = partial(_inspect_row, profile=profile)
    items = []
    for row in catalog.check_rows(opened, split, kind, check, limit, workers, on_progress):
        report = row.result
        if report is None:
            row_name = f"split {row.split!r}, row {row.row} of {row.file}"
            report = _unreadable(f"{row_name}: field {row.null_field!r} is null; expected a value")
        number = f"row {row.row}" if row.id is None else row.id
        items.append(CheckedMesh(f"{row.split} {number}", report))
    return CheckedMeshes(opened.name, tuple(items), profile)


def is_mesh_file(path: str) -> bool:
    """Return whether a path is a local file that is not Parquet, and so is read as a mesh."""
    file = store.local_path(path)
    if file is None or not file.is_file():
        return False
    return not store.open_folder(str(file.parent)).is_parquet(file.name)
