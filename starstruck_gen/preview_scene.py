"""Scenes in pictures: many from above, or one with the positions that were rejected and in oblique view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from starstruck_gen.dataset import SceneRecord
from starstruck_gen.picture import DISTRACTOR, STAR, draw_scene, draw_trace
from starstruck_gen.sampling import SceneTrace, trace_scene
from starstruck_gen.spec import SceneSpec
from starstruck_gen.stamping import stamp
from starstruck_gen.streams import scene_rng
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh
from tactile_toolkit.pictures.render import TOP, Body, Picture3d, Studio, fitting_scale, shaded
from tactile_toolkit.pictures.sheets import ScaleBar, Sheet, Tile, in_rows, sheet, with_scale_bar
from tactile_toolkit.pictures.writing import Drawing
from tactile_toolkit.wording import counted

__all__ = ["draw_one", "draw_sheet", "traced"]

_TILE_PX = 150
_PANEL_PX = 600
_PLATE = (236, 233, 226)
_PLATE_DEPTH_M = 2e-4
_OBJECT = (150, 160, 172)
"""Colour of objects of which it is not stored whether they are stars."""


def draw_sheet(records: Sequence[SceneRecord], spec: SceneSpec, per_row: int, title: str) -> Drawing:
    """Draw scenes from above at one scale, in a row (or some) for each class.

    Parameters
    ----------
    records : sequence of SceneRecord
        Scenes; those of a class one after another.
    spec : SceneSpec
        How they were made: the size of the cell.
    per_row : int
        Most scenes in a row.
    title : str
        Heading.
    """
    px_per_mm = _TILE_PX / (max(spec.cell_m) * MM_PER_M)
    counts = [record.star_count for record in records]
    groups = [
        (
            counted(count, "stars"),
            [
                Tile(_from_above(record, spec, px_per_mm), f"{record.id}")
                for record in records
                if record.star_count == count
            ],
        )
        for count in dict.fromkeys(counts)
    ]
    columns, cells, row_labels = in_rows(groups, per_row)
    known = all(record.has_placements for record in records)
    colours = "stars are yellow" if known else "it is not stored which objects are stars"
    words = (f"{counted(len(records), 'scenes')} from above, the id of each below it; {colours}",)
    drawn = sheet(cells, Sheet(columns, title, words, ("",), row_labels, gap_px=12))
    return Drawing(with_scale_bar(drawn, px_per_mm, ScaleBar.fitting(4 * _TILE_PX, px_per_mm)))


def draw_one(studio: Studio, record: SceneRecord, spec: SceneSpec | None, title: str) -> Drawing:
    """Draw a scene from above, with the positions that were rejected where they are known, and obliquely.

    Parameters
    ----------
    studio : Studio
        Where the oblique view is made.
    record : SceneRecord
        The scene.
    spec : SceneSpec or None
        How it was made, where that is known.
    title : str
        Heading.
    """
    known = spec or SceneSpec()
    px_per_mm = _PANEL_PX / (max(known.cell_m) * MM_PER_M)
    trace = traced(record, spec)
    if trace is None:
        above, caption = _from_above(record, known, px_per_mm), "from above; rejected positions are not known"
    else:
        above = np.asarray(draw_trace(trace.scene.placements, trace.rejected, known, px_per_mm))
        caption = _caption(trace)
    bodies = _bodies(record, known)
    scale = fitting_scale(bodies, (round(0.96 * _PANEL_PX), round(0.96 * _PANEL_PX)))
    view, notes = studio.draw(Picture3d(bodies, (_PANEL_PX, _PANEL_PX), scale))
    tiles = (
        Tile(with_scale_bar(above, px_per_mm), caption),
        Tile(with_scale_bar(view, scale / MM_PER_M), "oblique view; the bar holds along the picture plane"),
    )
    return Drawing(sheet(tiles, Sheet(2, title, _facts(record, trace, known))), notes)


def traced(record: SceneRecord, spec: SceneSpec | None) -> SceneTrace | None:
    """Make a stored scene again from its seed to learn which positions were rejected.

    Returns
    -------
    SceneTrace or None
        None where the data set does not say how it was made, or where the seed now gives another scene.
    """
    if spec is None or not record.has_placements or record.star_count not in spec.stars:
        return None
    trace = trace_scene(spec, scene_rng(record.seed), record.star_count)
    return trace if trace.scene == record.scene else None


def _from_above(record: SceneRecord, spec: SceneSpec, px_per_mm: float) -> NDArray[np.uint8]:
    if record.has_placements:
        return np.asarray(draw_scene(record.placements, spec.cell_m, px_per_mm))
    size_px = (round(spec.cell_m[0] * MM_PER_M * px_per_mm), round(spec.cell_m[1] * MM_PER_M * px_per_mm))
    return shaded(Picture3d(_bodies(record, spec), size_px, px_per_mm * MM_PER_M, TOP))


def _bodies(record: SceneRecord, spec: SceneSpec) -> tuple[Body, ...]:
    plate = Body(_plate(spec), _PLATE, lit=False)
    if not record.has_placements:
        return (plate, Body(Mesh(record.vertices_m, record.faces), _OBJECT))
    objects = (
        Body(stamp([[placement]])[0], STAR if placement.is_star else DISTRACTOR)
        for placement in record.placements
    )
    return (plate, *objects)


def _plate(spec: SceneSpec) -> Mesh:
    x, y = spec.cell_m[0] / 2, spec.cell_m[1] / 2
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    vertices_m = np.array([(*corner, -_PLATE_DEPTH_M) for corner in corners])
    return Mesh(vertices_m, np.array([(0, 1, 2), (0, 2, 3)], np.int32))


def _caption(trace: SceneTrace) -> str:
    if not trace.rejected:
        return "from above; no position was rejected; the dashed frame holds all centres"
    return "from above; red: rejected positions; the dashed frame holds all centres"


def _facts(record: SceneRecord, trace: SceneTrace | None, spec: SceneSpec) -> tuple[str, ...]:
    stars = counted(record.star_count, "stars")
    if trace is None:
        return (stars,)
    scene = trace.scene
    others = counted(scene.distractor_count, "other objects")
    given_up = sum(lost.given_up for lost in trace.rejected)
    drawn = f"{counted(sum(scene.attempts), 'positions')} drawn, {len(trace.rejected)} rejected"
    over = f", {given_up} of them (grey crosses) in layouts that were given up" if given_up else ""
    rule = "circles must not meet" if spec.collision == "circles" else "outlines must not touch"
    return (f"{stars}, {others}; {drawn}{over}; {rule}",)
