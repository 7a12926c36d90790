"""Data sets of scenes: their columns, published ones first, and generation from a specification."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any, Unpack

import pyarrow as pa

from starstruck_gen import kind, sampling, scene
from starstruck_gen.kind import KIND
from tactile_toolkit import checked_fields, generation, mesh, rows, store
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonDict

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
_PLACEMENTS = pa.list_(
    pa.struct([(name, pa.string() if name == "shape" else pa.float64()) for name in scene.Placement._fields])
)
_OBJECTS = (
    "each object in the order of placing, stars first: `shape`, centre `x_m` and `y_m`, `angle_rad` about z, "
    "`radius_m` of the circumscribed circle, `height_m`"
)

PUBLISHED_SIZES = (("train", 3_000), ("test", 300))
"""Scenes of each split (Tactile MNIST paper, section Starstruck)."""


@rows.row
class SceneRow(mesh.MeshRow):
    """One scene."""

    id: int = rows.column(
        pa.int64(),
        "",
        f"number of the scene: from 0 in train, from {sampling.scene_id(sampling.SPLITS[1], 0):,} in test",
    )
    label: int = rows.column(pa.int64(), "", "the class, named by the number of stars")
    star_count: int = rows.column(pa.int64(), "", "number of stars", role="facet", title="Stars")
    distractor_count: int = rows.column(
        pa.int64(), "", "number of objects that are not stars", role="facet", title="Distractors"
    )
    placements: Sequence[scene.Placement] = rows.column(
        _PLACEMENTS, "one per object: m, rad, frame below", _OBJECTS
    )
    seed: int = rows.column(
        pa.int64(),
        "",
        "seed of the scene: with the specification and the star count it makes the scene again",
    )
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
    return SceneRow.schema(class_names)


def make_rows(spec: sampling.SceneSpec, split: str, seed: int, start: int, count: int) -> list[SceneRow]:
    """Make rows ``start`` to ``start + count - 1`` of a split; each depends on its number only.

    Raises SamplingExhausted if a scene cannot be made.
    """
    scenes = sampling.sample_scenes(spec, split, seed, start, count)
    meshes = scene.build_meshes([scene.placements for scene in scenes])
    return [
        SceneRow(
            id=sampling.scene_id(split, number),
            label=number % len(spec.stars),
            vertices_m=meshes.vertices_m[index],
            faces=meshes.faces[index],
            star_count=scene.star_count,
            distractor_count=scene.distractor_count,
            placements=scene.placements,
            seed=sampling.scene_seed(seed, split, number),
            attempts=scene.attempts,
            restarts=scene.restarts,
        )
        for index, (number, scene) in enumerate(zip(range(start, start + count), scenes, strict=True))
    ]


@dataclass(frozen=True)
class SceneSetSpec:
    """Everything that decides the rows of a data set.

    Attributes
    ----------
    scene : SceneSpec
        How scenes are made.
    scenes : tuple of (str, int)
        Number of scenes of each split; a mapping is accepted, too.
    seed : int
        Random seed.
    limit : int or None
        Make only the first ``limit`` rows of a split.

    Notes
    -----
    The splits of a call and the number of workers are not part of it: a folder can be filled split by split,
    on any machine.
    """

    scene: sampling.SceneSpec = field(default_factory=sampling.SceneSpec)
    scenes: tuple[tuple[str, int], ...] = PUBLISHED_SIZES
    seed: int = checked_fields.integer(0)
    limit: int | None = checked_fields.integer(None, 1, optional=True)

    def __post_init__(self) -> None:
        checked_fields.check_fields(self, "the data set's specification")
        scenes = checked_fields.split_counts(
            self.scenes, "scenes", sampling.SPLITS, sampling.MAX_SCENES, "of the data set's specification "
        )
        object.__setattr__(self, "scenes", scenes)
        if not isinstance(self.scene, sampling.SceneSpec):
            raise InputError(f"scene of the data set's specification is {self.scene!r}; expected a SceneSpec")

    def rows(self, split: str) -> int:
        """Return the number of rows of a split."""
        count = dict(self.scenes).get(split, 0)
        return count if self.limit is None else min(count, self.limit)

    def to_dict(self) -> JsonDict:
        """Return JSON values that identify the rows; two equal values give equal Parquet."""
        return {
            "scene": self.scene.to_dict(),
            "scenes": dict(self.scenes),
            "seed": self.seed,
            "limit": self.limit,
        }


@dataclass(frozen=True)
class SceneGenerator(generation.RowGenerator):
    """Generator of scenes: samples layouts by rejection and makes their solids."""

    spec: SceneSetSpec
    kind = KIND

    def items(self) -> Mapping[str, range]:
        """Return the numbers of the scenes of each split."""
        return {split: range(self.spec.rows(split)) for split in sampling.SPLITS}

    def layout(self) -> generation.StorageLayout:
        """Return the storage layout of rows."""
        return generation.StorageLayout(
            PARQUET_STYLE,
            libraries=("manifold3d", "numpy", "pillow", "pyarrow"),
            smallest=1_000,
            largest=10_000,
            wanted=48,
            sampled=200,  # a scene takes tens of microseconds, too short to measure fewer
        )

    def schema(self, split: str) -> pa.Schema:
        """Return the Arrow schema of a shard."""
        return scene_schema(self.spec.scene.class_names)

    def make(self, split: str, items: Any) -> list[SceneRow]:
        """Return the rows of some scenes; SamplingExhausted if a scene cannot be made."""
        with store.without_collecting():
            return make_rows(self.spec.scene, split, self.spec.seed, items.start, len(items))


def generate(
    spec: SceneSetSpec,
    out: str | os.PathLike[str],
    splits: Sequence[str] = sampling.SPLITS,
    *,
    on_failure: sampling.LayoutFailed = lambda _failed, _allowed: None,
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Make a data set of scenes.

    A folder with an interrupted run of the same specification is completed. The same specification gives
    byte-identical Parquet for any number of workers and interruptions.

    Parameters
    ----------
    spec : SceneSetSpec
        Specification of the data set.
    out : str or path-like
        Folder to write.
    splits : sequence of str
        Splits to make; other splits in the folder stay.
    on_failure : callable
        Called after each failed layout while the fullest scene is tried.
    **run
        Fields of :class:`~tactile_toolkit.store.RunOptions`, such as ``workers`` and ``overwrite``.

    Returns
    -------
    Manifest
        Content of the folder.

    Raises
    ------
    InputError
        An option cannot be used.
    SamplingExhausted
        The specification cannot be satisfied. Finished shards stay.
    SpecMismatchError, StorageError
        The folder has a data set of another specification, or cannot be written. Finished shards stay.
    """
    require = partial(sampling.require_feasible, spec.scene, spec.seed, on_failure)
    return SceneGenerator(spec).generate(out, splits, require=require, **run)


def scene_recipe(seed: int, per_class: int | None) -> generation.Recipe:
    """Return the recipe that makes scenes without input: as published, or fewer."""
    scenes = dict(PUBLISHED_SIZES)
    sizes = None
    if per_class is not None:
        most = per_class * len(KIND.class_names)
        scenes = {split: min(size, most) for split, size in scenes.items()}
        sizes = ",".join(f"{split}={size}" for split, size in scenes.items())
    spec = SceneSetSpec(scenes=tuple(scenes.items()), seed=seed)
    return generation.Recipe(SceneGenerator(spec), {"scenes": sizes, "seed": seed})
