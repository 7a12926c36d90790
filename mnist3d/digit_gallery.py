"""Gallery of digits: a static page of thumbnails, filters and meshes."""

from __future__ import annotations

import pyarrow as pa
import pyarrow.compute as pc

from mnist3d import digit_records, kind, sources
from tactile_toolkit import catalog, gallery, mesh, places, store
from tactile_toolkit.json_types import JsonObject
from tactile_toolkit.rows import with_role
from tactile_toolkit.wording import class_name

_ROWS_PER_TASK = 8
_SHOWN = (*with_role(digit_records.DigitRow, "facet"), *with_role(mesh.PrintReport, "facet", "measure"))


def plan_gallery(
    name: places.Name | places.Place, chosen: catalog.RowFilter = catalog.NO_FILTER
) -> gallery.Gallery:
    """Plan a gallery of digits; see :func:`~tactile_toolkit.gallery.gallery_of_rows`."""
    # The report of the data set, if it has one, is read instead of inspecting meshes again.
    place = places.open_place(name)
    folder = place.folder
    has_report = folder is not None and folder.exists(digit_records.REPORT_FILE)

    def known(rows: digit_records.DigitDataset, split: str) -> list[JsonObject | None]:
        if folder is None or not has_report:
            return [None] * len(rows)
        report = store.read_report(folder, digit_records.REPORT_FILE)
        chosen = pc.and_(pc.equal(report["split"], split), pc.is_in(report["id"], pa.array(rows.ids)))
        found = {row["id"]: row for row in report.filter(chosen).to_pylist()}
        return [found.get(number) for number in rows.ids.tolist()]

    return gallery.gallery_of_rows(
        kind.KIND, place, chosen, "3D digits", _SHOWN, _item, _ROWS_PER_TASK, known
    )


def _item(
    record: digit_records.DigitRecord, split: str, names: tuple[str, ...], report: JsonObject | None
) -> gallery.GalleryItem:
    gallery.require_mesh(record, split)
    vertices_m, faces = record.vertices_m, record.faces
    if report is None:
        found = mesh.inspect(mesh.Mesh(vertices_m, faces))
        report = {**found.to_row(), "warnings": [*filter(None, [found.problem]), *found.warnings]}
    label = class_name(names, record.label)
    source = [("Source", record.source)] if record.source else []
    return gallery.GalleryItem(
        id=str(record.id),
        title=f"digit {label}",
        values={**report, "writer": None if record.writer == sources.NO_WRITER else record.writer},
        thumbnail=gallery.relief_thumbnail(vertices_m, faces),
        content={
            "notes": [("Size", gallery.size_text(vertices_m)), *source],
            "mesh": gallery.packed_mesh(vertices_m, faces),
        },
    )
