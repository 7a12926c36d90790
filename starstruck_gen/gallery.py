"""Scenes as a gallery: a static page of top views, filters and meshes to turn around."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from starstruck_gen.dataset import SceneMeshDataset, SceneRecord, load
from starstruck_gen.kind import KIND
from starstruck_gen.solid import prism
from starstruck_gen.spec import SceneSpec
from tactile_toolkit.catalog.choose import Choice, chosen_rows, portions, short_name, splits_to_show
from tactile_toolkit.catalog.kinds import require_kind
from tactile_toolkit.gallery.items import Facet, Gallery, Item, Measure
from tactile_toolkit.gallery.meshes import packed_mesh, require_mesh, size_text
from tactile_toolkit.gallery.pictures import THUMBNAIL_PX, thumbnail, top_view
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh

__all__ = ["plan_gallery"]

_ROWS_PER_TASK = 32
_OPAQUE_FROM = 150  # levels darker than the plate, as the fill of every object is
_PUBLISHED_CELL_M = SceneSpec().cell_m

_FACETS = (
    Facet("stars", "Stars"),
    Facet("distractors", "Distractors"),
    Facet("split", "Split"),
    Facet("shapes", "Shapes"),
)
_MEASURES = (
    Measure("volume_mm3", "Volume", "mm³"),
    Measure("objects", "Objects"),
    Measure("attempts", "Positions drawn"),
    Measure("restarts", "Restarts"),
    Measure("vertices", "Vertices"),
    Measure("faces", "Triangles"),
)


@dataclass(frozen=True)
class _SceneTask:
    """Makes the items of some scenes of one split."""

    dataset: SceneMeshDataset
    split: str

    @property
    def size(self) -> int:
        return len(self.dataset)

    def make(self) -> list[Item]:
        return [_item(record, self.split) for record in self.dataset]


def plan_gallery(choice: Choice) -> Gallery:
    """Say what a gallery of scenes shows; reads labels, no mesh.

    Raises
    ------
    InputError
        No such data set or split, or it is none of scenes.
    IntegrityError
        The data set is damaged or unfinished.
    HubError
        The repository cannot be reached or does not exist.
    """
    tasks, splits = [], {}
    for split in splits_to_show(choice.name, choice.split):
        dataset = load(choice.name, split)
        require_kind(KIND, "gallery", choice.name, [dataset])
        rows = chosen_rows(dataset.labels, choice.limit, choice.per_class)
        splits[split] = len(rows)
        tasks += [_SceneTask(dataset[portion], split) for portion in portions(rows, _ROWS_PER_TASK)]
    title = f"Starstruck scenes · {short_name(choice.name)}"
    return Gallery("starstruck", title, ("scene", "scenes"), _FACETS, _MEASURES, tuple(tasks), splits)


def _item(record: SceneRecord, split: str) -> Item:
    require_mesh(record, split)
    known = record.has_placements
    stars = record.star_count
    mesh = Mesh(record.vertices_m, record.faces)
    return Item(
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
            "notes": _notes(record),
            "mesh": packed_mesh(mesh.vertices_m, mesh.faces, _parts(record), flat=True),
        },
    )


def _notes(record: SceneRecord) -> list[tuple[str, str]]:
    notes = [("Size over all", size_text(record.vertices_m))]
    return [*notes, ("Seed", str(record.seed))] if record.has_placements else notes


def _parts(record: SceneRecord) -> list[tuple[int, str]]:
    """Tell stars from other objects; nothing where the triangles are not those of the declared objects.

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
    """Show the scene from above, with all of the cell around it."""
    cell_m = _cell_around(record)
    px_per_mm = THUMBNAIL_PX / (max(cell_m) * MM_PER_M)
    if record.has_placements:
        pixels = np.asarray(record.scene.draw(cell_m, px_per_mm))
    else:
        pixels = top_view(record.vertices_m, record.faces, cell_m, px_per_mm)
    return thumbnail(pixels, _OPAQUE_FROM)


def _cell_around(record: SceneRecord) -> tuple[float, float]:
    """Return the published cell, or a larger one where the scene reaches beyond it; metres."""
    reach_m = 2.05 * np.abs(record.vertices_m[:, :2]).max(axis=0)
    width_m, depth_m = (max(cell, float(side)) for cell, side in zip(_PUBLISHED_CELL_M, reach_m, strict=True))
    return width_m, depth_m
