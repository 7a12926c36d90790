"""Contact sheets of scenes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from starstruck_gen import kind, scene_dataset, scene_drawing, scene_spec
from tactile_toolkit import catalog, mesh, pictures, places
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.wording import with_count

_TILE_PX = 150


def plan_previews(name: places.Name | places.Place, spec: catalog.PreviewSpec) -> pictures.PicturePlan:
    """Plan the pictures of a folder or Parquet file of scenes; nothing is drawn yet.

    Raises InputError if there is nothing to draw, or an option does not fit the data.
    """
    opened: pictures.MeshPreviews[scene_dataset.SceneMeshDataset] = pictures.MeshPreviews(
        kind.KIND, name, spec
    )
    with catalog.specification_read(opened.name):
        made_by = (
            scene_spec.SceneSpec.from_dict(opened.made_by["scene"])
            if opened.made_by
            else scene_spec.SceneSpec()
        )

    def sheet_of(rows: scene_dataset.SceneMeshDataset, title: str) -> UInt8:
        return draw_scene_sheet(list(rows), made_by, spec.per_class, title)

    return pictures.plan_kinds(spec.kinds, {"sheet": lambda: opened.plan_sheets(sheet_of)})


def draw_scene_sheet(
    records: Sequence[scene_dataset.SceneRecord], spec: scene_spec.SceneSpec, per_row: int, title: str
) -> UInt8:
    """Draw scenes from above at one scale; ``spec`` states the size of the cell."""
    px_per_mm = _TILE_PX / (max(spec.cell_m) * mesh.MM_PER_M)

    def from_above(record: scene_dataset.SceneRecord) -> UInt8:
        if record.has_placements:
            return np.asarray(scene_drawing.draw_scene(record.placements, spec.cell_m, px_per_mm))
        return pictures.relief_of(mesh.Mesh(record.vertices_m, record.faces), px_per_mm)

    tiles = [
        (with_count(record.star_count, "stars"), pictures.Tile(from_above(record), f"{record.id}"))
        for record in records
    ]
    known = all(record.has_placements for record in records)
    # These words are part of pictures whose bytes must not change.
    colours = "stars are yellow" if known else "it is not stored which objects are stars"
    words = f"{with_count(len(records), 'scenes')} from above, the id of each below it; {colours}"
    return pictures.draw_by_class(tiles, per_row, title, words, px_per_mm)
