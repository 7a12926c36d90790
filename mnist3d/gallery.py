"""Digits as a gallery: a static page of thumbnails, filters and meshes to turn around."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mnist3d.columns import REPORT_FILE
from mnist3d.kind import KIND
from mnist3d.loader import MeshDataset, MeshRecord
from mnist3d.sources import NO_WRITER
from tactile_toolkit.catalog.spec import ALL_ROWS, Chosen
from tactile_toolkit.gallery.items import (
    NONE,
    Facet,
    Gallery,
    Item,
    Measure,
    gallery_of_rows,
    packed_mesh,
    relief_thumbnail,
    require_mesh,
    size_text,
)
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.mesh.printability import WARNINGS, inspect
from tactile_toolkit.places.place import Name, Place, open_place
from tactile_toolkit.store.parquet import read_report
from tactile_toolkit.wording import class_name

_ROWS_PER_TASK = 8

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


def plan_gallery(name: Name | Place, chosen: Chosen = ALL_ROWS) -> Gallery:
    """State what a gallery of digits shows; see :func:`~tactile_toolkit.gallery.items.gallery_of_rows`."""
    # What the data set's own report says of each digit that is shown; nothing where it has none.
    place = open_place(name)
    folder = place.folder
    has_report = folder is not None and folder.exists(REPORT_FILE)

    def known(rows: MeshDataset, split: str) -> list[Mapping[str, Any] | None]:
        import pyarrow as pa
        import pyarrow.compute as pc

        if folder is None or not has_report:
            return [None] * len(rows)
        report = read_report(folder, REPORT_FILE)
        chosen = pc.and_(pc.equal(report["split"], split), pc.is_in(report["id"], pa.array(rows.ids)))
        found = {row["id"]: row for row in report.filter(chosen).to_pylist()}
        return [found.get(number) for number in rows.ids.tolist()]

    return gallery_of_rows(KIND, place, chosen, "3D digits", _FACETS, _MEASURES, _item, _ROWS_PER_TASK, known)


def _item(record: MeshRecord, split: str, names: tuple[str, ...], report: Mapping[str, Any] | None) -> Item:
    require_mesh(record, split)
    vertices_m, faces = record.vertices_m, record.faces
    if report is None:
        found = inspect(Mesh(vertices_m, faces))
        broken = (found.problem,) if found.problem else ()
        report = {**found.to_row(), "warnings": (*broken, *found.warnings)}
    label = class_name(names, record.label)
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
        thumbnail=relief_thumbnail(vertices_m, faces),
        content={"notes": [("Size", size_text(vertices_m)), *source], "mesh": packed_mesh(vertices_m, faces)},
    )
