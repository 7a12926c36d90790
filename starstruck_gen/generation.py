"""The main job: from a specification to a finished data set folder, and what that would take."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from starstruck_gen.card import write_card
from starstruck_gen.kind import KIND
from starstruck_gen.rows import PARQUET_STYLE, make_rows, require_sound, scene_table
from starstruck_gen.sampling import LayoutFailed, SamplingExhausted, require_feasible
from starstruck_gen.spec import SceneSpec
from starstruck_gen.streams import MOST_SCENES, SPLITS, scene_seed
from starstruck_gen.summary import count_scenes
from tactile_toolkit.checked_fields import check_fields, integer
from tactile_toolkit.errors import InputError
from tactile_toolkit.run.processes import Runner, runner_for
from tactile_toolkit.store.build import Progress, build
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.forecast import Forecast, Sample, forecast_build
from tactile_toolkit.store.job import manifest_so_far
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import encode_parquet
from tactile_toolkit.store.plan import BuildPlan, ShardContent, require_known_splits
from tactile_toolkit.store.shards import ShardName, shard_ranges
from tactile_toolkit.wording import is_whole, plain_pairs

__all__ = [
    "GenerateSpec",
    "PUBLISHED_SIZES",
    "SceneRecipe",
    "SceneShard",
    "forecast",
    "generate",
    "plan_build",
]

PUBLISHED_SIZES = (("train", 3_000), ("test", 300))
"""Scenes of each split (Tactile MNIST paper, section Starstruck)."""

# A scene takes tens of microseconds: fewer would measure the clock.
_SAMPLED = 200
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
    seed: int = integer(0)
    limit: int | None = integer(None, 1, optional=True)

    def __post_init__(self) -> None:
        check_fields(self, "the data set's specification")
        object.__setattr__(self, "scenes", plain_pairs(self.scenes))
        pairs = isinstance(self.scenes, tuple) and all(
            isinstance(entry, tuple) and len(entry) == 2 and is_whole(entry[1]) for entry in self.scenes
        )
        for name, holds, expected in (
            ("scene", isinstance(self.scene, SceneSpec), "a SceneSpec"),
            ("scenes", pairs, "a whole number for each split, such as {'train': 3000, 'test': 300}"),
        ):
            if not holds:
                message = (
                    f"{name} of the data set's specification is {getattr(self, name)!r}; expected {expected}"
                )
                raise InputError(message)
        names = [split for split, _ in self.scenes]
        if len(set(names)) < len(names):
            message = f"--scenes names a split twice: {', '.join(names)}; expected each once"
            raise InputError(message)
        for split, count in self.scenes:
            scene_seed(self.seed, split, 0)
            if not 0 <= count <= MOST_SCENES:
                message = f"--scenes of split {split!r} is {count}; expected 0 to {MOST_SCENES:,}"
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
    """The task of one shard: ``size`` scenes of the split from ``start`` on. Touches no file of the set."""

    shard: ShardName
    start: int
    size: int
    spec: GenerateSpec = field(repr=False)

    def make(self) -> ShardContent:
        """Make the rows, prove them and count what it took; SamplingExhausted when a scene cannot be made."""
        rows = make_rows(self.spec.scene, self.shard.split, self.spec.seed, self.start, self.size)
        require_sound(self.spec.scene, rows)
        counts = count_scenes(self.spec.scene, rows.scenes)
        return ShardContent(scene_table(rows), statistics=counts.to_dict())


def plan_build(spec: GenerateSpec, splits: Sequence[str]) -> BuildPlan:
    """Decide which shards hold which scenes; pure. InputError for an unknown split or nothing to make."""
    require_known_splits(splits, SPLITS)
    tasks = [
        SceneShard(shard, rows.start, len(rows), spec)
        for split in SPLITS
        if split in splits
        for shard, rows in shard_ranges(
            split, spec.rows(split), smallest=_SMALLEST_SHARD, largest=_LARGEST_SHARD, wanted=_SHARDS_WANTED
        )
    ]
    if not tasks:
        message = (
            f"no scenes to make for {', '.join(splits)}: --scenes gives {dict(spec.scenes)}; next: raise it"
        )
        raise InputError(message)
    return BuildPlan(
        KIND.name,
        spec.to_dict(),
        SPLITS,
        tuple(tasks),
        PARQUET_STYLE,
        libraries=("manifold3d", "numpy", "pillow", "pyarrow"),
    )


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
        Called with the :class:`~tactile_toolkit.store.build.Progress` after each shard.
    on_failure : callable
        Called after each layout that failed while it is tried whether the fullest scene has room.

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
    try:
        return build(
            folder,
            plan,
            runner_for(workers),
            overwrite=overwrite,
            on_progress=on_progress,
            write_card=write_card,
        )
    # The message has to name what stays: the next attempt with other numbers is refused there.
    except SamplingExhausted as error:
        so_far = manifest_so_far(folder)
        if so_far is None or not so_far.shards:
            raise
        raise replace(error, kept_in=os.fspath(out)) from error


def forecast(
    spec: GenerateSpec,
    out: str | os.PathLike[str],
    splits: Sequence[str],
    workers: int | Runner,
    *,
    overwrite: bool = False,
    on_failure: LayoutFailed = lambda _failed, _allowed: None,
) -> Forecast:
    """Estimate a run of :func:`generate` by making some of its scenes; writes nothing."""
    plan = plan_build(spec, splits)
    require_feasible(spec.scene, spec.seed, on_failure)
    first = plan.tasks[0].shard.split

    def encoded_bytes(count: int) -> int:
        rows = make_rows(spec.scene, first, spec.seed, 0, count)
        require_sound(spec.scene, rows)
        return len(encode_parquet(scene_table(rows), PARQUET_STYLE))

    def measure() -> Sample:
        encoded_bytes(1)  # the first scene pays for imports and for the solids of the shapes
        sampled = min(_SAMPLED, spec.rows(first))
        start_s = time.perf_counter()
        size = encoded_bytes(sampled)
        return Sample(sampled, size / sampled, (time.perf_counter() - start_s) / sampled)

    return forecast_build(out, plan, workers, measure, overwrite=overwrite)


@dataclass(frozen=True, slots=True)
class SceneRecipe:
    """How a data set of scenes is made without any input: as published, or with fewer scenes."""

    seed: int
    per_class: int | None
    splits: tuple[str, ...] = SPLITS

    def spec(self) -> Any:
        """Return the specification."""
        return GenerateSpec(scenes=self._scenes(), seed=self.seed)

    def begun(self, spec: Mapping[str, Any]) -> SceneRecipe | None:
        """Return the recipe of a folder with this specification."""
        counts = spec.get("scenes")
        most = max(counts.values(), default=0) if isinstance(counts, Mapping) else 0
        seed, per_class = spec.get("seed", 0), most // len(KIND.class_names)
        return SceneRecipe(seed, per_class) if per_class and isinstance(seed, int) else None

    def arguments(self, split: str) -> str:
        """Return the arguments of the command that makes a split."""
        sizes = ",".join(f"{name}={size}" for name, size in self._scenes())
        scenes = "" if self.per_class is None else f" --scenes {sizes}"
        return f"--split {split}{scenes}" + (f" --seed {self.seed}" if self.seed else "")

    def make(self, out: str, split: str, workers: int) -> None:
        """Make one split."""
        generate(self.spec(), out, (split,), workers=workers)

    def _scenes(self) -> tuple[tuple[str, int], ...]:
        most = None if self.per_class is None else self.per_class * len(KIND.class_names)
        return tuple((split, size if most is None else min(size, most)) for split, size in PUBLISHED_SIZES)
