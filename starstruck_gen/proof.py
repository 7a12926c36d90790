"""What holds for every scene that is written, proved before it is.

The solids of the shapes were proved once by manifold3d (:mod:`starstruck_gen.solid`). A scene only turns,
moves and rounds them, so that three cheap facts prove it: the caps kept their orientation after rounding, all
pairs of objects keep their distance, and the stars are as many as the label says. ``starstruck validate``
proves the same from the stored triangles.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from starstruck_gen.placement import CLEAR
from starstruck_gen.rows import SceneRows
from starstruck_gen.scene import Scene
from starstruck_gen.solid import prism
from starstruck_gen.spec import SceneSpec
from tactile_toolkit.errors import IntegrityError

__all__ = ["require_sound"]


def require_sound(spec: SceneSpec, rows: SceneRows) -> None:
    """Prove rows before they are written; raises IntegrityError naming a scene that breaks a promise."""
    for number, (scene, label) in enumerate(zip(rows.scenes, rows.labels, strict=True)):
        wrong = _miscounted(spec, scene, label) or _misplaced(spec, scene)
        if wrong is not None:
            raise _broken(rows.ids[number], wrong)
    turned = _turned_scene(rows)
    if turned is not None:
        raise _broken(rows.ids[turned], "rounding to float32 turned a triangle over")


def _miscounted(spec: SceneSpec, scene: Scene, label: int) -> str | None:
    stars = sum(placement.is_star for placement in scene.placements)
    if stars == scene.star_count == spec.stars[label]:
        return None
    return (
        f"{stars} stars stand there, {scene.star_count} are declared, class {label} has {spec.stars[label]}"
    )


def _misplaced(spec: SceneSpec, scene: Scene) -> str | None:
    half_x_m, half_y_m = spec.half_area_m
    for placement in scene.placements:
        if abs(placement.x_m) > half_x_m or abs(placement.y_m) > half_y_m:
            return f"a {placement.shape} stands outside the valid area, at {placement.x_m}, {placement.y_m} m"
    clear = CLEAR[spec.collision]
    for one, other in combinations(scene.placements, 2):
        if not clear(one, other, spec.clearance_m):
            return f"a {one.shape} and a {other.shape} collide"
    return None


def _turned_scene(rows: SceneRows) -> int | None:
    """Return a scene with a cap triangle whose orientation changed, as stored; None when there is none."""
    prisms = [prism(placement.shape) for scene in rows.scenes for placement in scene.placements]
    starts = np.cumsum([0, *(made.vertex_count for made in prisms)])
    flat = rows.meshes.vertices_m.values[:, :2].astype(np.float64)
    for made in dict.fromkeys(prisms):
        members = [start for start, other in zip(starts[:-1], prisms, strict=True) if other is made]
        corners = flat[np.array(members)[:, None, None] + 2 * made.cap]
        ab, ac = corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]
        turned = ((ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0]) <= 0).any(axis=1)
        if turned.any():
            first = members[int(turned.argmax())]
            return int(np.searchsorted(rows.meshes.vertices_m.offsets, first, side="right")) - 1
    return None


def _broken(scene_id: int, wrong: str) -> IntegrityError:
    message = (
        f"scene {scene_id} must not be written: {wrong}; this is a fault of the toolkit, please report it"
    )
    return IntegrityError(message)
