"""Sheets of scenes, and the gallery: a static page of top views, filters and meshes."""

from __future__ import annotations

from functools import partial

import pyarrow as pa

from starstruck_gen import kind, scene_dataset, scene_rows
from tactile_toolkit import gallery, mesh, pictures, rows
from tactile_toolkit.json_types import JsonDict

_SHOWN = (
    *rows.with_role(scene_rows.SceneRow, "facet", "measure"),
    rows.Column(pa.list_(pa.string()), name="shapes", role="facet", title="Shapes"),
    rows.Column(pa.int64(), name="objects", role="measure", title="Objects"),
    rows.Column(pa.int64(), name="positions", role="measure", title="Positions drawn"),
    *(rows.columns(mesh.PrintReport)[name] for name in ("volume_mm3", "vertices", "faces")),
)


def _facts(record: scene_dataset.SceneRecord, _known: None) -> JsonDict:
    if not record.has_placements:
        return {}
    return {
        "shapes": sorted({placement.shape for placement in record.placements}),
        "objects": len(record.placements),
        "positions": sum(record.scene.attempts),
    }


plan_previews = partial(pictures.plan_sheets, kind.KIND)
plan_gallery = partial(
    gallery.gallery_of_solids, kind.KIND, title="Starstruck scenes", columns=_SHOWN, facts=_facts
)
