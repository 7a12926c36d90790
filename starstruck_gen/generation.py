"""The main job: from a specification to a finished data set folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from starstruck_gen.card import write_card
from starstruck_gen.kind import KIND
from starstruck_gen.proof import require_sound
from starstruck_gen.rows import PARQUET_STYLE, make_rows, scene_table
from starstruck_gen.sampling import LayoutFailed, SamplingExhausted, require_feasible
from starstruck_gen.spec import SceneSpec
from starstruck_gen.streams import MOST_SCENES, SPLITS, scene_seed
from starstruck_gen.summary import count_scenes
from tactile_toolkit.errors import InputError
from tactile_toolkit.run.processes import Runner, runner_for
from tactile_toolkit.store.build import BuildPlan, BuildState, Progress, ShardContent, build, inspect_folder
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest, manifest_so_far
from tactile_toolkit.store.shards import ShardName
from tactile_toolkit.wording import plain_number, plain_pairs

__all__ = ["PUBLISHED_SIZES", "GenerateSpec", "SceneShard", "generate", "inspect_out", "plan_build"]

PUBLISHED_SIZES = (("train", 3_000), ("test", 300))
"""Scenes of each split (Tactile MNIST paper, section Starstruck)."""

_LARGEST_SHARD = 10_000
_SMALLEST_SHARD = 1_000
_SHARDS_WANTED = 48


@dataclass(frozen=True)
class GenerateSpec:
    """Everything that decides which rows a data set holds.

    Attributes
    ----------
    scene : SceneSpec
        How scenes are made.
    scenes : tuple of (str, int)
        Number of scenes of each split; a mapping is taken too.
    seed : int
        Seed of everything that is drawn at random.
    limit : int or None
        Make only the first so many rows of a split.

    Notes
    -----
    The splits made in one call and the number of workers are not part of it: a folder can be filled split by
    split, on any machine.
    """

    scene: SceneSpec = field(default_factory=SceneSpec)
    scenes: tuple[tuple[str, int], ...] = PUBLISHED_SIZES
    seed: int = 0
    limit: int | None = None

    def __post_init__(self) -> None:
        for name in ("seed", "limit"):
            object.__setattr__(self, name, plain_number(getattr(self, name)))
        object.__setattr__(self, "scenes", plain_pairs(self.scenes))
        self._require_types()
        names = [split for split, _ in self.scenes]
        if len(set(names)) < len(names):
            message = f"--scenes names a split twice: {', '.join(names)}; expected each once"
            raise InputError(message)
        for split, count in self.scenes:
            scene_seed(self.seed, split, 0)
            if not 0 <= count <= MOST_SCENES:
                message = f"--scenes of split {split!r} is {count}; expected 0 to {MOST_SCENES:,}"
                raise InputError(message)
        if self.limit is not None and self.limit < 1:
            message = f"--limit is {self.limit}; expected a whole number of at least 1"
            raise InputError(message)

    def _require_types(self) -> None:
        pairs = isinstance(self.scenes, tuple) and all(
            isinstance(entry, tuple) and len(entry) == 2 and _is_whole(entry[1]) for entry in self.scenes
        )
        for name, holds, expected in (
            ("scene", isinstance(self.scene, SceneSpec), "a SceneSpec"),
            ("scenes", pairs, "a whole number for each split, such as {'train': 3000, 'test': 300}"),
            ("seed", _is_whole(self.seed), "a whole number from 0"),
            ("limit", self.limit is None or _is_whole(self.limit), "None or a whole number of at least 1"),
        ):
            if not holds:
                message = (
                    f"{name} of the data set's specification is {getattr(self, name)!r}; expected {expected}"
                )
                raise InputError(message)

    def rows(self, split: str) -> int:
        """Return how many rows a split has."""
        count = dict(self.scenes).get(split, 0)
        return count if self.limit is None else min(count, self.limit)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values that identify the rows; two equal values give equal Parquet."""
        return {
            "scene": self.scene.to_dict(),
            "scenes": dict(self.scenes),
            "seed": self.seed,
            "limit": self.limit,
        }


@dataclass(frozen=True)
class SceneShard:
    """The task of one shard: a range of scenes. Small, picklable, touches no file of the data set.

    Attributes
    ----------
    shard : ShardName
        Which shard.
    start, size : int
        Its scenes: ``start`` to ``start + size - 1`` of the split.
    spec : GenerateSpec
        How they are made.
    """

    shard: ShardName
    start: int
    size: int
    spec: GenerateSpec = field(repr=False)

    def make(self) -> ShardContent:
        """Make the rows, prove them and count what it took.

        Raises
        ------
        SamplingExhausted
            When a scene cannot be made.
        """
        rows = make_rows(self.spec.scene, self.shard.split, self.spec.seed, self.start, self.size)
        require_sound(self.spec.scene, rows)
        counts = count_scenes(self.spec.scene, rows.scenes)
        return ShardContent(scene_table(rows), statistics=counts.to_dict())


def plan_build(spec: GenerateSpec, splits: Sequence[str]) -> BuildPlan:
    """Decide which shards hold which scenes; pure.

    Parameters
    ----------
    spec : GenerateSpec
        What to make.
    splits : sequence of str
        Splits asked for.

    Raises
    ------
    InputError
        Unknown split, or nothing to make.
    """
    for split in splits:
        if split not in SPLITS:
            message = f"unknown split {split!r}; expected one of {', '.join(SPLITS)}, or all"
            raise InputError(message)
    tasks = [task for split in SPLITS if split in splits for task in _split_tasks(spec, split)]
    if not tasks:
        message = (
            f"no scenes to make for {', '.join(splits)}: --scenes gives {dict(spec.scenes)}; next: raise it"
        )
        raise InputError(message)
    return BuildPlan(KIND.name, spec.to_dict(), SPLITS, tuple(tasks), PARQUET_STYLE)


def generate(
    spec: GenerateSpec,
    out: str | os.PathLike[str],
    splits: Sequence[str] = SPLITS,
    *,
    workers: int | Runner = 1,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] = lambda _: None,
    on_failure: LayoutFailed = lambda _failed, _allowed: None,
) -> Manifest:
    """Make a data set of scenes.

    A folder that holds a finished or interrupted run of the same specification is completed: finished shards
    are kept. The same specification gives byte-identical Parquet whatever the number of workers and however
    often the run was interrupted.

    Parameters
    ----------
    spec : GenerateSpec
        What to make.
    out : str or path-like
        Folder to write.
    splits : sequence of str
        Splits to make; others that the folder holds already stay.
    workers : int or Runner
        Number of local processes, or a runner of another kind.
    overwrite : bool
        Start again in a folder that holds another data set of this toolkit.
    on_progress : callable
        Told after each shard.
    on_failure : callable
        Told after each layout that failed while it is tried whether the fullest scene has room.

    Returns
    -------
    Manifest
        What the folder holds now.

    Raises
    ------
    InputError
        An option cannot be used.
    SamplingExhausted
        The specification cannot be satisfied. The folder stays as it was, unless shards were finished before.
    SpecMismatchError
        The folder holds a data set of another specification.
    StorageError
        The folder cannot be written. What was finished stays.
    """
    folder = DataFolder(os.fspath(out))
    plan = plan_build(spec, splits)
    require_feasible(spec.scene, spec.seed, on_failure)
    runner = runner_for(workers)
    try:
        manifest = build(folder, plan, runner, overwrite=overwrite, on_progress=on_progress)
    except SamplingExhausted as error:
        so_far = manifest_so_far(folder)
        if so_far is None or not so_far.receipts:
            raise
        raise replace(error, kept_in=os.fspath(out)) from error
    write_card(folder, manifest)
    return manifest


def inspect_out(
    spec: GenerateSpec, out: str | os.PathLike[str], splits: Sequence[str] = SPLITS
) -> BuildState:
    """Tell what :func:`generate` would keep and make, changing nothing."""
    return inspect_folder(DataFolder(os.fspath(out)), plan_build(spec, splits))


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _split_tasks(spec: GenerateSpec, split: str) -> list[SceneShard]:
    rows = spec.rows(split)
    size = _rows_per_shard(rows)
    starts = range(0, rows, size)
    return [
        SceneShard(ShardName(split, index, len(starts)), start, min(size, rows - start), spec)
        for index, start in enumerate(starts)
    ]


def _rows_per_shard(rows: int) -> int:
    """Return a shard size that follows from the split alone, so that any number of workers agrees on it."""
    wanted = -(-rows // _SHARDS_WANTED)
    return min(_LARGEST_SHARD, max(_SMALLEST_SHARD, wanted))
