"""Gallery of scenes: a static page of top views, filters and meshes."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from starstruck_gen import kind, prisms, scene_dataset, scene_drawing, scene_rows
from tactile_toolkit import catalog, gallery, places, rows, touch
from tactile_toolkit.json_types import JsonDict
from tactile_toolkit.mesh import MM_PER_M, Mesh, PrintReport
from tactile_toolkit.wording import with_count

_ROWS_PER_TASK = 32
_OPAQUE_FROM = 150  # each object is at least this many levels darker than the plate

_SHOWN = (
    *rows.with_role(scene_rows.SceneRow, "facet", "measure"),
    rows.Column(pa.list_(pa.string()), name="shapes", role="facet", title="Shapes"),
    rows.Column(pa.int64(), name="objects", role="measure", title="Objects"),
    rows.Column(pa.int64(), name="positions", role="measure", title="Positions drawn"),
    *(rows.columns(PrintReport)[name] for name in ("volume_mm3", "vertices", "faces")),
)


def plan_gallery(
    name: places.Name | places.Place, chosen: catalog.RowFilter = catalog.NO_FILTER
) -> gallery.Gallery:
    """Plan a gallery of scenes; see :func:`~tactile_toolkit.gallery.gallery_of_rows`."""
    return gallery.gallery_of_rows(
        kind.KIND, name, chosen, "Starstruck scenes", _SHOWN, _item, _ROWS_PER_TASK
    )


def _item(
    record: scene_dataset.SceneRecord, split: str, _names: tuple[str, ...], _known: None
) -> gallery.GalleryItem:
    gallery.require_mesh(record, split)
    stars = record.star_count
    mesh = Mesh(record.vertices_m, record.faces)
    notes = [("Overall size", gallery.size_text(mesh.vertices_m))]
    values: JsonDict = {
        "star_count": stars,
        "distractor_count": None,
        "volume_mm3": mesh.volume_m3 * MM_PER_M**3,
        "vertices": len(mesh.vertices_m),
        "faces": len(mesh.faces),
    }
    if record.has_placements:
        notes.append(("Seed", str(record.seed)))
        values |= {
            "distractor_count": record.distractor_count,
            "shapes": sorted({placement.shape for placement in record.placements}),
            "objects": len(record.placements),
            "positions": sum(record.scene.attempts),
            "restarts": record.scene.restarts,
        }
    return gallery.GalleryItem(
        id=str(record.id),
        title=with_count(stars, "stars"),
        values=values,
        thumbnail=_thumbnail(record),
        content={
            "notes": notes,
            "mesh": gallery.packed_mesh(mesh.vertices_m, mesh.faces, _parts(record), flat=True),
        },
    )


def _parts(record: scene_dataset.SceneRecord) -> list[tuple[int, str]]:
    """Return runs of triangles of stars and of other objects.

    Without placements, all objects are others. Empty if the triangles are not those of the declared objects.
    """
    if not record.has_placements:
        return [(len(record.faces), "other")]
    runs = [
        (len(prisms.prism(placement.shape).faces), "main" if placement.is_star else "other")
        for placement in record.placements
    ]
    if sum(count for count, _ in runs) != len(record.faces):
        return []
    return runs


def _thumbnail(record: scene_dataset.SceneRecord) -> bytes:
    """Draw the scene from above, in the published cell or in a larger one if it reaches beyond."""
    if not record.has_placements:
        return gallery.relief_thumbnail(record.vertices_m, record.faces)
    # Twice the distance of the farthest corner, and a margin.
    reach_m = 2.05 * np.abs(record.vertices_m[:, :2]).max(axis=0)
    width_m, depth_m = (max(cell, float(side)) for cell, side in zip(touch.CELL_M, reach_m, strict=True))
    px_per_mm = gallery.THUMBNAIL_PX / (max(width_m, depth_m) * MM_PER_M)
    return gallery.thumbnail(
        np.asarray(scene_drawing.draw_scene(record.placements, (width_m, depth_m), px_per_mm)), _OPAQUE_FROM
    )
