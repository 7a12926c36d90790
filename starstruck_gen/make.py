"""Rows of scenes, and their proof before they are written."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from starstruck_gen.columns import SceneRow
from starstruck_gen.placement import COLLISION_TESTS, build_meshes
from starstruck_gen.sampling import sample_scenes
from starstruck_gen.solid import prism
from starstruck_gen.spec import SceneSpec
from starstruck_gen.streams import scene_id, scene_seed
from tactile_toolkit.errors import IntegrityError


def make_rows(spec: SceneSpec, split: str, seed: int, start: int, count: int) -> list[SceneRow]:
    """Make rows ``start`` to ``start + count - 1`` of a split; each depends on nothing but its number.

    Raises SamplingExhausted when a scene cannot be made.
    """
    scenes = sample_scenes(spec, split, seed, start, count)
    meshes = build_meshes([scene.placements for scene in scenes])
    return [
        SceneRow(
            id=scene_id(split, number),
            label=number % len(spec.stars),
            vertices_m=meshes.vertices_m[index],
            faces=meshes.faces[index],
            star_count=scene.star_count,
            distractor_count=scene.distractor_count,
            placements=scene.placements,
            seed=scene_seed(seed, split, number),
            attempts=scene.attempts,
            restarts=scene.restarts,
        )
        for index, (number, scene) in enumerate(zip(range(start, start + count), scenes, strict=True))
    ]


def validate_rows(spec: SceneSpec, rows: Sequence[SceneRow]) -> None:
    """Prove rows before they are written; raises IntegrityError naming a scene that is invalid.

    The solids of the shapes were proved once by manifold3d (:mod:`starstruck_gen.solid`). A scene only turns,
    moves and rounds them, so that three cheap facts prove it: the caps kept their orientation after rounding,
    all pairs of objects keep their distance, and the stars are as many as the label says. ``starstruck
    validate`` proves the same from the stored triangles.
    """
    for row in rows:
        wrong = _misplaced(spec, row)
        if wrong is not None:
            raise _invalid(row, wrong)
    _require_orientation(rows)


def _misplaced(spec: SceneSpec, row: SceneRow) -> str | None:
    """Compare a scene with its number of stars, the valid area and the collision rule."""
    stars = sum(placement.is_star for placement in row.placements)
    if not stars == row.star_count == spec.stars[row.label]:
        declared = f"{row.star_count} are declared, class {row.label} has {spec.stars[row.label]}"
        return f"{stars} stars stand there, {declared}"
    half_x_m, half_y_m = spec.half_area_m
    for placement in row.placements:
        if abs(placement.x_m) > half_x_m or abs(placement.y_m) > half_y_m:
            return f"a {placement.shape} stands outside the valid area, at {placement.x_m}, {placement.y_m} m"
    clear = COLLISION_TESTS[spec.collision]
    for one, other in combinations(row.placements, 2):
        if not clear(one, other, spec.clearance_m):
            return f"a {one.shape} and a {other.shape} collide"
    return None


def _require_orientation(rows: Sequence[SceneRow]) -> None:
    """Refuse a scene with a cap triangle whose orientation changed, as stored."""
    prisms = [prism(placement.shape) for row in rows for placement in row.placements]
    starts = np.cumsum([0, *(made.vertex_count for made in prisms)])
    owners = np.repeat(np.arange(len(rows)), [len(row.placements) for row in rows])
    flat = np.concatenate([row.vertices_m for row in rows])[:, :2].astype(np.float64)
    # A shape at a time, all its objects at once; walls stand upright and cannot turn.
    for made in dict.fromkeys(prisms):
        members = np.flatnonzero([other is made for other in prisms])
        corners = flat[starts[members][:, None, None] + 2 * made.cap]
        ab, ac = corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]
        turned = ((ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0]) <= 0).any(axis=1)
        if turned.any():
            first = rows[owners[members[turned.argmax()]]]
            raise _invalid(first, "rounding to float32 turned a triangle over")


def _invalid(row: SceneRow, wrong: str) -> IntegrityError:
    message = f"scene {row.id} must not be written: {wrong}; this is a fault of the toolkit, please report it"
    return IntegrityError(message)
