"""Digits as a gallery: a static page of thumbnails, filters and meshes to turn around."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mnist3d.columns import REPORT_FILE
from mnist3d.dataset import MeshDataset, MeshRecord
from mnist3d.kind import KIND
from mnist3d.sources import NO_WRITER
from tactile_toolkit.catalog.choose import Choice
from tactile_toolkit.gallery.items import (
    NONE,
    THUMBNAIL_PX,
    Facet,
    Gallery,
    Item,
    Measure,
    gallery_of_rows,
    packed_mesh,
    require_mesh,
    size_text,
    thumbnail,
)
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh
from tactile_toolkit.mesh.printability import WARNINGS, inspect
from tactile_toolkit.pictures.render import relief
from tactile_toolkit.store.derived import report_columns, report_pieces
from tactile_toolkit.store.files import expanded
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.wording import class_name

_ROWS_PER_TASK = 8
_OVERSAMPLING = 2  # a thumbnail is drawn larger, which smooths its edges
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


def plan_gallery(choice: Choice) -> Gallery:
    """State what a gallery of digits shows; see :func:`~tactile_toolkit.gallery.items.gallery_of_rows`."""
    # What the data set's own report says of each digit that is shown; nothing where it has none.
    is_folder = expanded(choice.name).is_dir()
    has_report = is_folder and DataFolder(choice.name).exists(REPORT_FILE)

    def known(rows: MeshDataset, split: str) -> list[Mapping[str, Any] | None]:
        reports = _reported(DataFolder(choice.name), split, rows.ids) if has_report else {}
        return [reports.get(int(number)) for number in rows.ids]

    return gallery_of_rows(KIND, choice, "3D digits", _FACETS, _MEASURES, _item, _ROWS_PER_TASK, known)


def _reported(folder: DataFolder, split: str, ids: NDArray[np.int64]) -> dict[int, Mapping[str, Any]]:
    """Return the rows of some digits of a split in the report of printability, by id."""
    import pyarrow as pa
    import pyarrow.compute as pc

    wanted = {*(measure.name for measure in _MEASURES), "split", "id", "bodies", "warnings"}
    columns = [name for name in report_columns(folder, REPORT_FILE) if name in wanted]
    values = pa.array(ids)
    found: dict[int, Mapping[str, Any]] = {}
    for piece in report_pieces(folder, REPORT_FILE, columns):
        chosen = pc.and_(pc.equal(piece["split"], split), pc.is_in(piece["id"], values))
        found |= {row["id"]: row for row in piece.filter(chosen).to_pylist()}
    return found


def _item(record: MeshRecord, split: str, names: tuple[str, ...], report: Mapping[str, Any] | None) -> Item:
    require_mesh(record, split)
    vertices_m, faces = record.vertices_m, record.faces
    if report is None:
        found = inspect(Mesh(vertices_m, faces))
        broken = (found.problem,) if found.problem else ()
        report = {**found.to_row(), "warnings": (*broken, *found.warnings)}
    label = class_name(names, record.label)
    # Each in the size of its tile: a digit of 3 cm is recognised like one of 8.
    longest_m = float(np.ptp(vertices_m[:, :2], axis=0).max())
    # Another source's mesh may have no extent at all.
    pitch_m = max(longest_m, 1e-3 / MM_PER_M) / (_OVERSAMPLING * THUMBNAIL_PX - _MARGIN_PX)
    source = [("Source", record.source)] if record.source else []
    return Item(
        id=str(record.id),
        title=f"digit {label}",
        facets={
            "label": (label,),
            "split": (split,),
            "warnings": tuple(report["warnings"]) or (NONE,),
            "bodies": (str(report["bodies"]),),
            "writer": ("unknown" if record.writer == NO_WRITER else str(record.writer),),
        },
        measures={measure.name: report.get(measure.name) for measure in _MEASURES},
        thumbnail=thumbnail(relief(vertices_m, faces, pitch_m), opaque_from=1),
        content={"notes": [("Size", size_text(vertices_m)), *source], "mesh": packed_mesh(vertices_m, faces)},
    )
