"""Generation of a data set folder of scenes from a specification."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any, Unpack

import pyarrow as pa

from starstruck_gen import acceptance, rejection, scene_meshes, scene_rows, scene_seeds, scene_spec
from starstruck_gen.kind import KIND
from tactile_toolkit import checked_fields, generation, store
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonDict, JsonObject

PUBLISHED_SIZES = (("train", 3_000), ("test", 300))
"""Scenes of each split (Tactile MNIST paper, section Starstruck)."""


def make_rows(
    spec: scene_spec.SceneSpec, split: str, seed: int, start: int, count: int
) -> list[scene_rows.SceneRow]:
    """Make rows ``start`` to ``start + count - 1`` of a split; each depends on its number only.

    Raises SamplingExhausted if a scene cannot be made.
    """
    scenes = rejection.sample_scenes(spec, split, seed, start, count)
    meshes = scene_meshes.build_meshes([scene.placements for scene in scenes])
    return [
        scene_rows.SceneRow(
            id=scene_seeds.scene_id(split, number),
            label=number % len(spec.stars),
            vertices_m=meshes.vertices_m[index],
            faces=meshes.faces[index],
            star_count=scene.star_count,
            distractor_count=scene.distractor_count,
            placements=scene.placements,
            seed=scene_seeds.scene_seed(seed, split, number),
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

    scene: scene_spec.SceneSpec = field(default_factory=scene_spec.SceneSpec)
    scenes: tuple[tuple[str, int], ...] = PUBLISHED_SIZES
    seed: int = checked_fields.integer(0)
    limit: int | None = checked_fields.integer(None, 1, optional=True)

    def __post_init__(self) -> None:
        checked_fields.check_fields(self, "the data set's specification")
        scenes = checked_fields.split_counts(
            self.scenes, "scenes of the data set's specification", scene_seeds.SPLITS, scene_seeds.MAX_SCENES
        )
        object.__setattr__(self, "scenes", scenes)
        if not isinstance(self.scene, scene_spec.SceneSpec):
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
        return {split: range(self.spec.rows(split)) for split in scene_seeds.SPLITS}

    def layout(self) -> generation.StorageLayout:
        """Return the storage layout of rows."""
        return generation.StorageLayout(
            scene_rows.PARQUET_STYLE,
            libraries=("manifold3d", "numpy", "pillow", "pyarrow"),
            smallest=1_000,
            largest=10_000,
            wanted=48,
            sampled=200,  # a scene takes tens of microseconds, too short to measure fewer
        )

    def schema(self, split: str) -> pa.Schema:
        """Return the Arrow schema of a shard."""
        return scene_rows.scene_schema(self.spec.scene.class_names)

    def make(self, split: str, items: Any) -> list[scene_rows.SceneRow]:
        """Return the rows of some scenes; SamplingExhausted if a scene cannot be made."""
        with store.without_collecting():
            return make_rows(self.spec.scene, split, self.spec.seed, items.start, len(items))

    def statistics(self, rows: Sequence[scene_rows.SceneRow]) -> JsonObject:
        """Count positions drawn and scenes started over."""
        return asdict(acceptance.count_scenes(self.spec.scene, rows))


def generate(
    spec: SceneSetSpec,
    out: str | os.PathLike[str],
    splits: Sequence[str] = scene_seeds.SPLITS,
    *,
    on_failure: rejection.LayoutFailed = lambda _failed, _allowed: None,
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
    require = partial(rejection.require_feasible, spec.scene, spec.seed, on_failure)
    return generation.generate(SceneGenerator(spec), out, splits, require=require, **run)


def scene_recipe(seed: int, per_class: int | None) -> generation.Recipe:
    """Return the recipe that makes scenes without input: as published, or fewer."""
    scenes, sizes = dict(PUBLISHED_SIZES), None
    if per_class is not None:
        most = per_class * len(KIND.class_names)
        scenes = {split: min(size, most) for split, size in scenes.items()}
        sizes = ",".join(f"{split}={size}" for split, size in scenes.items())
    spec = SceneSetSpec(scenes=tuple(scenes.items()), seed=seed)
    return generation.Recipe(SceneGenerator(spec), {"scenes": sizes, "seed": seed})
