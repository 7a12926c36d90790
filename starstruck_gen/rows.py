"""Rows of Starstruck (published columns first, then ours), and their proof before they are written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np

from starstruck_gen.kind import KIND
from starstruck_gen.placement import CLEAR, Placement, SceneMeshes, stamp
from starstruck_gen.sampling import sample_scenes
from starstruck_gen.scene import Scene
from starstruck_gen.solid import prism
from starstruck_gen.spec import SceneSpec
from starstruck_gen.streams import scene_id, scene_seed
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.mesh.columns import FACES, VERTICES, mesh_set_schema
from tactile_toolkit.read.columns import ragged_array
from tactile_toolkit.store.parquet import ParquetStyle

__all__ = [
    "CLASS_NAMES",
    "PARQUET_STYLE",
    "SceneRows",
    "make_rows",
    "require_sound",
    "scene_schema",
    "scene_table",
]

CLASS_NAMES = KIND.class_names
"""Classes of the published data set (Tactile MNIST paper, section Starstruck)."""

PARQUET_STYLE = ParquetStyle(
    rows_per_group=1_000,
    compression="zstd",
    # Level 9: scenes are few bytes, and repeat the triangles of their shapes.
    compression_level=9,
    encodings=(
        # A corner stands twice, on the plate and above it: zstd finds the pair in plain bytes, where any
        # encoding that takes numbers apart hides it.
        (f"{VERTICES}.list.element.list.element", "PLAIN"),
        (f"{FACES}.list.element.list.element", "DELTA_BINARY_PACKED"),
    ),
)
"""1,000 scenes are about 5 MB unpacked: enough for the codec to meet the triangles of each shape again."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneRows:
    """Rows before they become Arrow: what stands where in each scene, and the same as solids."""

    ids: Sequence[int]
    labels: Sequence[int]
    seeds: Sequence[int]
    scenes: Sequence[Scene]
    meshes: SceneMeshes
    class_names: tuple[str, ...]


def make_rows(spec: SceneSpec, split: str, seed: int, start: int, count: int) -> SceneRows:
    """Make rows ``start`` to ``start + count - 1`` of a split; each depends on nothing but its number.

    Raises SamplingExhausted when a scene cannot be made.
    """
    numbers = range(start, start + count)
    scenes = sample_scenes(spec, split, seed, start, count)
    return SceneRows(
        ids=[scene_id(split, number) for number in numbers],
        labels=[number % len(spec.stars) for number in numbers],
        seeds=[scene_seed(seed, split, number) for number in numbers],
        scenes=scenes,
        meshes=stamp([scene.placements for scene in scenes]),
        class_names=spec.class_names,
    )


@cache
def scene_schema(class_names: tuple[str, ...] = CLASS_NAMES) -> Any:
    """Return the Arrow schema of a shard."""
    import pyarrow as pa

    return mesh_set_schema(
        class_names,
        [
            ("star_count", pa.int64()),
            ("distractor_count", pa.int64()),
            ("placements", pa.list_(_placement_type())),
            ("seed", pa.int64()),
            ("attempts", pa.list_(pa.int32())),
            ("restarts", pa.int32()),
        ],
    )


def scene_table(rows: SceneRows) -> Any:
    """Pack rows into an Arrow table of :func:`scene_schema`."""
    import pyarrow as pa

    scenes, kind = rows.scenes, _placement_type()
    ends = np.cumsum([0, *(len(scene.placements) for scene in scenes)])
    fields = zip(*(placement for scene in scenes for placement in scene.placements), strict=True)
    values = [pa.array(field, each.type) for field, each in zip(fields, kind, strict=True)]
    objects = pa.StructArray.from_arrays(values, fields=list(kind))
    columns = [
        pa.array(rows.ids, pa.int64()),
        pa.array(rows.labels, pa.int64()),
        ragged_array(rows.meshes.vertices_m, pa.float32()),
        ragged_array(rows.meshes.faces, pa.int32()),
        pa.array([scene.star_count for scene in scenes], pa.int64()),
        pa.array([scene.distractor_count for scene in scenes], pa.int64()),
        pa.ListArray.from_arrays(pa.array(ends, pa.int32()), objects, type=pa.list_(kind)),
        pa.array(rows.seeds, pa.int64()),
        pa.array([scene.attempts for scene in scenes], pa.list_(pa.int32())),
        pa.array([scene.restarts for scene in scenes], pa.int32()),
    ]
    return pa.Table.from_arrays(columns, schema=scene_schema(rows.class_names))


def _placement_type() -> Any:
    import pyarrow as pa

    numbers = [(name, pa.float64()) for name in Placement._fields if name != "shape"]
    return pa.struct([("shape", pa.string()), *numbers])


def require_sound(spec: SceneSpec, rows: SceneRows) -> None:
    """Prove rows before they are written; raises IntegrityError naming a scene that breaks a promise.

    The solids of the shapes were proved once by manifold3d (:mod:`starstruck_gen.solid`). A scene only turns,
    moves and rounds them, so that three cheap facts prove it: the caps kept their orientation after rounding,
    all pairs of objects keep their distance, and the stars are as many as the label says. ``starstruck
    validate`` proves the same from the stored triangles.
    """
    for number, (scene, label) in enumerate(zip(rows.scenes, rows.labels, strict=True)):
        wrong = _broken_promise(spec, scene, label)
        if wrong is not None:
            raise _broken(rows.ids[number], wrong)
    turned = _turned_scene(rows)
    if turned is not None:
        raise _broken(rows.ids[turned], "rounding to float32 turned a triangle over")


def _broken_promise(spec: SceneSpec, scene: Scene, label: int) -> str | None:
    """Hold a scene to its number of stars, the valid area and the collision rule."""
    stars = sum(placement.is_star for placement in scene.placements)
    if not stars == scene.star_count == spec.stars[label]:
        declared = f"{scene.star_count} are declared, class {label} has {spec.stars[label]}"
        return f"{stars} stars stand there, {declared}"
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
    # A shape at a time, all its objects at once; walls stand upright and cannot turn.
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
