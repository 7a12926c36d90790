"""Pictures of scenes: contact sheets, and single scenes with their rejected positions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from starstruck_gen.kind import KIND
from starstruck_gen.loader import SceneMeshDataset, SceneRecord
from starstruck_gen.placement import Placement, Rejected, build_meshes
from starstruck_gen.sampling import SceneTrace, scene_rng, trace_scene
from starstruck_gen.scene import (
    DISTRACTOR,
    STAR,
    SUPERSAMPLING,
    centre_px,
    corners_px,
    draw_scene,
    empty_plate,
    paint_object,
    reduced,
)
from starstruck_gen.shapes import outline
from starstruck_gen.spec import SceneSpec
from tactile_toolkit.catalog.locate import specification_read
from tactile_toolkit.catalog.spec import PreviewSpec
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh
from tactile_toolkit.pictures.previews import (
    MeshPreviews,
    draw_by_class,
    draw_two_views,
)
from tactile_toolkit.pictures.render import TOP, Body, draw_bodies, fitting_scale
from tactile_toolkit.pictures.sheets import PicturePlan, Pixels, Tile, plan_kinds, with_scale_bar
from tactile_toolkit.wording import counted

if TYPE_CHECKING:
    from PIL.Image import Image


REJECTED = (213, 94, 0)
_AREA = (150, 156, 164)
_CROSS = 4.0 * SUPERSAMPLING
_TILE_PX = 150
_PANEL_PX = 600
_PLATE = (236, 233, 226)
# Below the feet of the objects: at one height the two would be drawn through one another.
_PLATE_DEPTH_M = 2e-4
# Colour of objects of which it is not stored whether they are stars.
_OBJECT = (150, 160, 172)


def plan_previews(name: str, spec: PreviewSpec) -> PicturePlan:
    """Decide which pictures of a folder or Parquet file of scenes to draw; draws none.

    Kinds are sheet and scene. InputError as :class:`MeshPreviews`; IntegrityError where the data set is
    damaged or unfinished.
    """
    opened: MeshPreviews[SceneMeshDataset] = MeshPreviews(KIND, name, spec)
    with specification_read(name):
        made_by = SceneSpec.from_dict(opened.made_by["scene"]) if opened.made_by else None

    def sheet_of(rows: SceneMeshDataset, title: str) -> Pixels:
        return draw_sheet(list(rows), made_by or SceneSpec(), spec.per_class, title)

    def one(record: SceneRecord, where: str) -> Pixels:
        return draw_one(record, made_by, f"Scene {record.id} {where}")

    plans = {
        "sheet": lambda: opened.plan_sheets(sheet_of),
        "scene": lambda: opened.plan_each("scene", "from above and obliquely", one),
    }
    return plan_kinds(spec.kinds, plans, ("scene",) if spec.ids else ("sheet",))


def draw_sheet(records: Sequence[SceneRecord], spec: SceneSpec, per_row: int, title: str) -> Pixels:
    """Draw scenes from above at one scale; ``spec`` states the size of the cell."""
    px_per_mm = _TILE_PX / (max(spec.cell_m) * MM_PER_M)
    tiles = [
        (counted(record.star_count, "stars"), Tile(_from_above(record, spec, px_per_mm), f"{record.id}"))
        for record in records
    ]
    known = all(record.has_placements for record in records)
    colours = "stars are yellow" if known else "it is not stored which objects are stars"
    words = f"{counted(len(records), 'scenes')} from above, the id of each below it; {colours}"
    return draw_by_class(tiles, per_row, title, words, px_per_mm)


def draw_one(record: SceneRecord, spec: SceneSpec | None, title: str) -> Pixels:
    """Draw a scene from above and obliquely; where ``spec`` says how it was made, with rejected positions."""
    known = spec or SceneSpec()
    px_per_mm = _PANEL_PX / (max(known.cell_m) * MM_PER_M)
    facts = counted(record.star_count, "stars")
    trace = traced(record, spec)
    if trace is None:
        above, caption = _from_above(record, known, px_per_mm), "from above; rejected positions are not known"
    else:
        above = np.asarray(draw_trace(trace.scene.placements, trace.rejected, known, px_per_mm))
        lost = "red: rejected positions" if trace.rejected else "no position was rejected"
        caption = f"from above; {lost}; the frame holds all centres"
        given_up = sum(each.given_up for each in trace.rejected)
        facts += (
            f", {counted(trace.scene.distractor_count, 'other objects')}; "
            f"{counted(sum(trace.scene.attempts), 'positions')} drawn, {len(trace.rejected)} rejected"
        )
        facts += f", {given_up} of them (grey crosses) in layouts that were given up" if given_up else ""
        circles = known.collision == "circles"
        facts += "; circles must not meet" if circles else "; outlines must not touch"
    bodies = _bodies(record, known)
    scale = fitting_scale(bodies, (round(0.96 * _PANEL_PX), round(0.96 * _PANEL_PX)))
    oblique = draw_bodies(bodies, (_PANEL_PX, _PANEL_PX), scale)
    return draw_two_views(Tile(with_scale_bar(above, px_per_mm), caption), oblique, scale, title, (facts,))


def traced(record: SceneRecord, spec: SceneSpec | None) -> SceneTrace | None:
    """Make a stored scene again from its seed to learn which positions were rejected.

    None where the data set does not say how it was made, or where the seed now gives another scene.
    """
    if spec is None or not record.has_placements or record.star_count not in spec.stars or record.seed < 0:
        return None
    trace = trace_scene(spec, scene_rng(record.seed), record.star_count)
    return trace if trace.scene == record.scene else None


def draw_trace(
    placements: Iterable[Placement], rejected: Iterable[Rejected], spec: SceneSpec, px_per_mm: float
) -> Image:
    """Draw a scene with the room that collision takes around each object, and the positions not taken.

    Objects that were not placed are outlined in red where they would have stood, with a cross at their
    centre; those of layouts that were given up have a grey cross only. The frame holds all centres.
    """
    from PIL import ImageDraw

    picture = empty_plate(spec.cell_m, px_per_mm)
    scale = px_per_mm * 1e3 * SUPERSAMPLING
    pen = ImageDraw.Draw(picture)
    middle, half = np.array(picture.size) / 2, np.array(spec.half_area_m) * scale
    pen.rectangle((*(middle - half), *(middle + half)), outline=_AREA, width=SUPERSAMPLING)
    for placement in placements:
        paint_object(picture, placement, scale)
        if spec.collision == "circles":
            x, y = centre_px(placement, picture.size, scale)
            radius = (placement.radius_m + spec.clearance_m / 2) * scale
            box = (x - radius, y - radius, x + radius, y + radius)
            pen.ellipse(box, outline=_AREA, width=SUPERSAMPLING)
    # Those of layouts that were given up first: what was rejected in the scene itself lies above them.
    for lost in sorted(rejected, key=lambda each: not each.given_up):
        colour = _AREA if lost.given_up else REJECTED
        if not lost.given_up:
            for ring in outline(lost.candidate.shape):
                edge = corners_px(ring, lost.candidate, picture.size, scale)
                pen.line([*edge, edge[0]], fill=colour, width=SUPERSAMPLING)
        x, y = centre_px(lost.candidate, picture.size, scale)
        for slope in (1, -1):
            line = (x - _CROSS, y - slope * _CROSS, x + _CROSS, y + slope * _CROSS)
            pen.line(line, fill=colour, width=2 * SUPERSAMPLING)
    return reduced(picture)


def _from_above(record: SceneRecord, spec: SceneSpec, px_per_mm: float) -> NDArray[np.uint8]:
    if record.has_placements:
        return np.asarray(draw_scene(record.placements, spec.cell_m, px_per_mm))
    width, height = (round(side * MM_PER_M * px_per_mm) for side in spec.cell_m)
    return draw_bodies(_bodies(record, spec), (width, height), px_per_mm * MM_PER_M, TOP)


def _bodies(record: SceneRecord, spec: SceneSpec) -> tuple[Body, ...]:
    x, y = spec.cell_m[0] / 2, spec.cell_m[1] / 2
    corners_m = [(px, py, -_PLATE_DEPTH_M) for px, py in ((-x, -y), (x, -y), (x, y), (-x, y))]
    plate = Body(Mesh(np.array(corners_m), np.array([(0, 1, 2), (0, 2, 3)], np.int32)), _PLATE, lit=False)
    if not record.has_placements:
        return (plate, Body(Mesh(record.vertices_m, record.faces), _OBJECT))
    return (
        plate,
        *(
            Body(build_meshes([[each]])[0], STAR if each.is_star else DISTRACTOR)
            for each in record.placements
        ),
    )
