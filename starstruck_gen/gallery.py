"""Scenes as a gallery: a static page of top views, filters and meshes to turn around."""

from __future__ import annotations

import numpy as np

from starstruck_gen.kind import KIND
from starstruck_gen.loader import SceneRecord
from starstruck_gen.placement import prism
from starstruck_gen.scene import draw_scene
from starstruck_gen.spec import SceneSpec
from tactile_toolkit import catalog, gallery, places
from tactile_toolkit.mesh import MM_PER_M, Mesh

_ROWS_PER_TASK = 32
_OPAQUE_FROM = 150  # levels darker than the plate, as the fill of every object is
_PUBLISHED_CELL_M = SceneSpec.cell_m

_FACETS = (
    gallery.Facet("stars", "Stars"),
    gallery.Facet("distractors", "Distractors"),
    gallery.Facet("split", "Split"),
    gallery.Facet("shapes", "Shapes"),
)
_MEASURES = (
    gallery.Measure("volume_mm3", "Volume", "mm³"),
    gallery.Measure("objects", "Objects"),
    gallery.Measure("attempts", "Positions drawn"),
    gallery.Measure("restarts", "Restarts"),
    gallery.Measure("vertices", "Vertices"),
    gallery.Measure("faces", "Triangles"),
)


def plan_gallery(
    name: places.Name | places.Place, chosen: catalog.Chosen = catalog.ALL_ROWS
) -> gallery.Gallery:
    """State what a gallery of scenes shows; see :func:`~tactile_toolkit.gallery.items.gallery_of_rows`."""
    return gallery.gallery_of_rows(
        KIND, name, chosen, "Starstruck scenes", _FACETS, _MEASURES, _item, _ROWS_PER_TASK
    )


def _item(record: SceneRecord, split: str, _names: tuple[str, ...], _known: None) -> gallery.Item:
    gallery.require_mesh(record, split)
    known = record.has_placements
    stars = record.star_count
    mesh = Mesh(record.vertices_m, record.faces)
    seed = [("Seed", str(record.seed))] if known else []
    return gallery.Item(
        id=str(record.id),
        title=f"{stars} star" if stars == 1 else f"{stars} stars",
        facets={
            "stars": (str(stars),),
            "distractors": (str(record.distractor_count) if known else "unknown",),
            "split": (split,),
            "shapes": tuple(sorted({placement.shape for placement in record.placements})) if known else (),
        },
        measures={
            "volume_mm3": mesh.volume_m3 * MM_PER_M**3,
            "objects": len(record.placements) if known else None,
            "attempts": sum(record.scene.attempts) if known else None,
            "restarts": record.scene.restarts if known else None,
            "vertices": len(mesh.vertices_m),
            "faces": len(mesh.faces),
        },
        thumbnail=_thumbnail(record),
        content={
            "notes": [("Size over all", gallery.size_text(mesh.vertices_m)), *seed],
            "mesh": gallery.packed_mesh(mesh.vertices_m, mesh.faces, _parts(record), flat=True),
        },
    )


def _parts(record: SceneRecord) -> list[tuple[int, str]]:
    """Separate stars from other objects; nothing where the triangles are not those of the declared objects.

    Where it is not stored which objects are stars, none is painted as one.
    """
    if not record.has_placements:
        return [(len(record.faces), "other")]
    runs = [
        (len(prism(placement.shape).faces), "main" if placement.is_star else "other")
        for placement in record.placements
    ]
    return runs if sum(count for count, _ in runs) == len(record.faces) else []


def _thumbnail(record: SceneRecord) -> bytes:
    """Show the scene from above, in the published cell or a larger one where it reaches beyond that."""
    if not record.has_placements:
        return gallery.relief_thumbnail(record.vertices_m, record.faces)
    # Twice the farthest corner, and a little room.
    reach_m = 2.05 * np.abs(record.vertices_m[:, :2]).max(axis=0)
    width_m, depth_m = (max(cell, float(side)) for cell, side in zip(_PUBLISHED_CELL_M, reach_m, strict=True))
    px_per_mm = gallery.THUMBNAIL_PX / (max(width_m, depth_m) * MM_PER_M)
    return gallery.thumbnail(
        np.asarray(draw_scene(record.placements, (width_m, depth_m), px_per_mm)), _OPAQUE_FROM
    )
