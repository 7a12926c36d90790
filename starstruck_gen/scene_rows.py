"""The columns of Starstruck: published ones first, then ours."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import pyarrow as pa

from starstruck_gen import kind, sampling, scene
from tactile_toolkit import mesh, rows, store

PARQUET_STYLE = store.ParquetStyle(
    rows_per_group=1_000,
    compression="zstd",
    # Level 9: scenes are small and repeat the triangles of their shapes.
    compression_level=9,
    encodings=(
        # Each corner occurs twice, on the plate and above it. zstd finds the pair in plain bytes; encodings
        # that split numbers hide it.
        (f"{mesh.VERTICES}.list.element.list.element", "PLAIN"),
        (f"{mesh.FACES}.list.element.list.element", "DELTA_BINARY_PACKED"),
    ),
)
"""1,000 scenes are about 5 MB unpacked, enough for the codec to find repeated triangles."""

_NUMBERS = [(name, pa.float64()) for name in scene.Placement._fields if name != "shape"]
_PLACEMENTS = pa.list_(pa.struct([("shape", pa.string()), *_NUMBERS]))
_IDS = f"number of the scene: from 0 in train, from {sampling.scene_id(sampling.SPLITS[1], 0):,} in test"
_OBJECTS = (
    "each object in the order of placing, stars first: `shape`, centre `x_m` and `y_m`, `angle_rad` about z, "
    "`radius_m` of the circumscribed circle, `height_m`"
)

_SEED = "seed of the scene: with the specification and the star count it makes the scene again"


@rows.row
class SceneRow(mesh.MeshRow):
    """One scene."""

    id: int = rows.column(pa.int64(), "", _IDS)
    label: int = rows.column(pa.int64(), "", "the class, named by the number of stars")
    star_count: int = rows.column(pa.int64(), "", "number of stars", role="facet", title="Stars")
    distractor_count: int = rows.column(
        pa.int64(), "", "number of objects that are not stars", role="facet", title="Distractors"
    )
    placements: Sequence[scene.Placement] = rows.column(
        _PLACEMENTS, "one per object: m, rad, frame below", _OBJECTS
    )
    seed: int = rows.column(pa.int64(), "", _SEED)
    attempts: Sequence[int] = rows.column(pa.list_(pa.int32()), "one per object", "positions drawn for it")
    restarts: int = rows.column(
        pa.int32(), "", "how often the scene was started over", role="measure", title="Restarts"
    )


def published_schema(_manifest: object = None) -> pa.Schema:
    """Return the Arrow schema of scenes with the published classes; other names do not change its columns."""
    return scene_schema()


@cache
def scene_schema(class_names: tuple[str, ...] = kind.KIND.class_names) -> pa.Schema:
    """Return the Arrow schema of a shard."""
    return mesh.mesh_schema(SceneRow, class_names)
