"""From a specification to a finished data set folder, and what that would take."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from starstruck_gen.columns import PARQUET_STYLE, SceneRow, scene_schema
from starstruck_gen.kind import KIND
from starstruck_gen.make import make_rows, validate_rows
from starstruck_gen.sampling import LayoutFailed, SamplingExhausted, require_feasible
from starstruck_gen.spec import SceneSpec
from starstruck_gen.streams import MOST_SCENES, SPLITS, scene_seed
from starstruck_gen.summary import count_scenes
from tactile_toolkit import making
from tactile_toolkit.checked_fields import check_fields, integer
from tactile_toolkit.errors import InputError
from tactile_toolkit.run.processes import Runner
from tactile_toolkit.store.build import Progress
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.forecast import Forecast
from tactile_toolkit.store.job import manifest_so_far
from tactile_toolkit.store.manifest import Manifest, without_collecting
from tactile_toolkit.wording import is_whole, plain_pairs

PUBLISHED_SIZES = (("train", 3_000), ("test", 300))
"""Scenes of each split (Tactile MNIST paper, section Starstruck)."""

_LARGEST_SHARD = 10_000
_SMALLEST_SHARD = 1_000


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
            ("scenes", pairs, "an integer for each split, such as {'train': 3000, 'test': 300}"),
        ):
            if not holds:
                raise InputError(
                    f"{name} of the data set's specification is {getattr(self, name)!r}; expected {expected}"
                )
        names = [split for split, _ in self.scenes]
        if len(set(names)) < len(names):
            raise InputError(f"--scenes names a split twice: {', '.join(names)}; expected each once")
        for split, count in self.scenes:
            scene_seed(self.seed, split, 0)
            if not 0 <= count <= MOST_SCENES:
                raise InputError(f"--scenes of split {split!r} is {count}; expected 0 to {MOST_SCENES:,}")

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
class SceneMaking(making.Making):
    """How scenes are made: drawn by rejection, made solids, proved."""

    spec: GenerateSpec
    kind = KIND

    def manifest(self) -> Mapping[str, Any]:
        """Return the specification."""
        return self.spec.to_dict()

    def items(self) -> Mapping[str, range]:
        """Return the numbers of the scenes of each split."""
        return {split: range(self.spec.rows(split)) for split in SPLITS}

    def layout(self) -> making.Layout:
        """Return how rows are stored."""
        return making.Layout(
            PARQUET_STYLE,
            libraries=("manifold3d", "numpy", "pillow", "pyarrow"),
            smallest=_SMALLEST_SHARD,
            largest=_LARGEST_SHARD,
            wanted=48,
            sampled=200,  # a scene takes tens of microseconds: fewer would measure the clock
        )

    def schema(self, split: str) -> Any:
        """Return the Arrow schema of a shard."""
        return scene_schema(self.spec.scene.class_names)

    def make(self, split: str, items: Any) -> list[SceneRow]:
        """Make the rows and prove them; SamplingExhausted when a scene cannot be made."""
        with without_collecting():
            rows = make_rows(self.spec.scene, split, self.spec.seed, items.start, len(items))
            validate_rows(self.spec.scene, rows)
        return rows

    def statistics(self, rows: Sequence[SceneRow]) -> Mapping[str, Any]:
        """Count what it took."""
        return count_scenes(self.spec.scene, rows).to_dict()


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
    try:
        return making.generate(
            SceneMaking(spec),
            out,
            splits,
            workers=workers,
            overwrite=overwrite,
            on_progress=on_progress,
            require=partial(require_feasible, spec.scene, spec.seed, on_failure),
        )
    # The message has to name what stays: the next attempt with other numbers is refused there.
    except SamplingExhausted as error:
        so_far = manifest_so_far(DataFolder(os.fspath(out)))
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
    require = partial(require_feasible, spec.scene, spec.seed, on_failure)
    return making.forecast(SceneMaking(spec), out, splits, workers, overwrite=overwrite, require=require)


def scene_recipe(seed: int, per_class: int | None) -> making.Recipe:
    """Return how scenes are made without any input: as published, or with fewer scenes."""
    most = MOST_SCENES if per_class is None else per_class * len(KIND.class_names)
    scenes = {split: min(size, most) for split, size in PUBLISHED_SIZES}
    sizes = None if per_class is None else ",".join(f"{split}={size}" for split, size in scenes.items())
    spec = GenerateSpec(scenes=plain_pairs(scenes), seed=seed)
    return making.Recipe(SceneMaking(spec), {"scenes": sizes, "seed": seed})
