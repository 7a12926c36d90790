"""Digits as a gallery: a static page of thumbnails, filters and meshes to turn around."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mnist3d.dataset import MeshDataset, MeshRecord, load
from mnist3d.kind import KIND
from mnist3d.rows import REPORT_FILE
from mnist3d.sources import NO_WRITER
from tactile_toolkit.catalog.choose import Choice, chosen_rows, portions, short_name, splits_to_show
from tactile_toolkit.catalog.kinds import require_kind
from tactile_toolkit.gallery.items import NONE, Facet, Gallery, Item, Measure
from tactile_toolkit.gallery.meshes import packed_mesh, require_mesh, size_text
from tactile_toolkit.gallery.pictures import THUMBNAIL_PX, thumbnail
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh
from tactile_toolkit.mesh.printability import WARNINGS, inspect
from tactile_toolkit.pictures.relief import relief
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.parquet import read_report

__all__ = ["plan_gallery"]

_ROWS_PER_TASK = 8
_OVERSAMPLING = 2
_MARGIN_PX = 9  # of `relief`, on both sides together

_FACETS = (
    Facet("label", "Class"),
    Facet("split", "Split"),
    Facet("warnings", "Print warnings", (NONE, *WARNINGS)),
    Facet("bodies", "Separate bodies"),
    Facet("writer", "Writer"),
)
_MEASURES = (
    Measure("volume_mm3", "Volume", "mm³"),
    Measure("size_z_mm", "Height", "mm", 2),
    Measure("thinnest_wall_mm", "Thinnest wall", "mm", 2),
    Measure("mass_g", "Mass in PLA", "g", 1),
    Measure("overhang_mm2", "Overhang", "mm²"),
    Measure("contact_mm2", "First layer", "mm²"),
    Measure("vertices", "Vertices"),
    Measure("faces", "Triangles"),
)

Findings = Mapping[str, Any]


@dataclass(frozen=True)
class _DigitTask:
    """Makes the items of some digits.

    Attributes
    ----------
    dataset : MeshDataset
        The digits.
    split : str
        Their split.
    reports : tuple
        What the data set's report says of each; None where it says nothing.
    """

    dataset: MeshDataset
    split: str
    reports: tuple[Findings | None, ...] = field(repr=False)

    @property
    def size(self) -> int:
        return len(self.dataset)

    def make(self) -> list[Item]:
        return [
            _item(record, self.split, self.dataset.label_names, report)
            for record, report in zip(self.dataset, self.reports, strict=True)
        ]


def plan_gallery(choice: Choice) -> Gallery:
    """Say what a gallery of digits shows; reads ids and labels, no mesh.

    Raises
    ------
    InputError
        No such data set or split, or it is none of digits.
    IntegrityError
        The data set is damaged or unfinished.
    HubError
        The repository cannot be reached or does not exist.
    """
    reports = _stored_reports(choice.name)
    tasks, splits = [], {}
    for split in splits_to_show(choice.name, choice.split):
        dataset = load(choice.name, split)
        require_kind(KIND, "gallery", choice.name, [dataset])
        rows = chosen_rows(dataset.labels, choice.limit, choice.per_class)
        splits[split] = len(rows)
        ids = dataset.ids
        for portion in portions(rows, _ROWS_PER_TASK):
            known = tuple(reports.get((split, int(number))) for number in ids[portion])
            tasks.append(_DigitTask(dataset[portion], split, known))
    title = f"3D digits · {short_name(choice.name)}"
    return Gallery("mnist3d", title, ("digit", "digits"), _FACETS, _MEASURES, tuple(tasks), splits)


def _stored_reports(name: str) -> dict[tuple[str, int], Findings]:
    """Read what the data set's own report says of each digit; nothing where it has none."""
    if not Path(name).expanduser().is_dir():
        return {}
    folder = DataFolder(name)
    if not folder.exists(REPORT_FILE):
        return {}
    table = read_report(folder, REPORT_FILE)
    wanted = [measure.name for measure in _MEASURES] + ["split", "id", "bodies", "warnings"]
    rows = table.select([column for column in wanted if column in table.column_names]).to_pylist()
    return {(row["split"], row["id"]): row for row in rows}


def _item(record: MeshRecord, split: str, names: tuple[str, ...], report: Findings | None) -> Item:
    require_mesh(record, split)
    findings = _inspected(record) if report is None else report
    writer = record.writer
    label = names[record.label] if 0 <= record.label < len(names) else str(record.label)
    return Item(
        id=str(record.id),
        title=f"digit {label}",
        facets={
            "label": (label,),
            "split": (split,),
            "warnings": tuple(findings["warnings"]) or (NONE,),
            "bodies": (str(findings["bodies"]),),
            "writer": ("unknown" if writer == NO_WRITER else str(writer),),
        },
        measures={measure.name: findings.get(measure.name) for measure in _MEASURES},
        thumbnail=_thumbnail(record),
        content={
            "notes": _notes(record),
            "mesh": packed_mesh(record.vertices_m, record.faces),
        },
    )


def _inspected(record: MeshRecord) -> Findings:
    report = inspect(Mesh(record.vertices_m, record.faces))
    broken = (report.problem,) if report.problem else ()
    return {**report.to_row(), "warnings": (*broken, *report.warnings)}


def _notes(record: MeshRecord) -> list[tuple[str, str]]:
    notes = [("Size", size_text(record.vertices_m))]
    return [*notes, ("Source", record.source)] if record.source else notes


def _thumbnail(record: MeshRecord) -> bytes:
    """Draw the digit twice as large as the thumbnail, which smooths its edges."""
    longest_m = float(np.ptp(record.vertices_m[:, :2], axis=0).max())
    pitch_m = max(longest_m, 1e-3 / MM_PER_M) / (_OVERSAMPLING * THUMBNAIL_PX - _MARGIN_PX)
    return thumbnail(relief(record.vertices_m, record.faces, pitch_m), opaque_from=1)
