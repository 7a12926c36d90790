"""Scenes on the fly: the records of a data set that was never written."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from starstruck_gen.columns import scene_schema
from starstruck_gen.dataset import SceneMeshDataset
from starstruck_gen.make import make_rows
from starstruck_gen.placement import SceneMeshes, build_meshes
from starstruck_gen.sampling import sample_scenes
from starstruck_gen.scene import Scene
from starstruck_gen.spec import SceneSpec
from starstruck_gen.streams import MOST_SCENES, SPLITS, scene_id, scene_seed
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.columns import FACES, VERTICES
from tactile_toolkit.read.columns import RaggedColumn, RowGroup, column_names
from tactile_toolkit.read.parquet import ShardedTable
from tactile_toolkit.rows import table_of
from tactile_toolkit.wording import is_whole, plain_number

DEFAULT_SIZE = 300_000
"""Scenes of a split on the fly, where no size is given (package tactile-mnist 0.13.0)."""

_KNOWN = ("id", "label", "star_count", "seed")
"""Columns that follow from the number of a scene."""


class SceneTable(ShardedTable):
    """The rows of a split, each made when it is asked for; pickles as the four values that make them."""

    spec: SceneSpec
    split: str
    size: int
    seed: int

    def __init__(self, spec: SceneSpec, split: str, size: int, seed: int) -> None:
        # There are no files: all that the base asks of shards is answered below.
        super().__init__(())
        self.__dict__.update(spec=spec, split=split, size=size, seed=seed)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.spec, self.split, self.size, self.seed)

    def __len__(self) -> int:
        return self.size

    @property
    def schema(self) -> Any:
        """Arrow schema of the rows."""
        return scene_schema(self.spec.class_names)

    @property
    def identity(self) -> str:
        """What tells these scenes from all others."""
        return repr((self.spec, self.split, self.size, self.seed))

    @property
    def origins(self) -> list[tuple[str, str]]:
        """The seed, in place of a name, and the split."""
        return [(f"seed {self.seed}", self.split)]

    def locate(self, row: int) -> tuple[RowGroup, int]:
        """Return a row as a group of its own; nothing of it is made yet."""
        return LazyRow(self, row), 0

    def made(self, start: int, count: int) -> Any:
        """Make some rows at once, as an Arrow table."""
        rows = make_rows(self.spec, self.split, self.seed, start, count)
        return table_of(rows, scene_schema(self.spec.class_names))

    def column(self, name: str, _: Any = None) -> NDArray[Any]:
        """Return one column of all rows, of those that need no scene."""
        return self.known(name, range(self.size))

    def known(self, name: str, rows: range) -> NDArray[np.int64]:
        """Return what follows from the number of each of some rows; KeyError for any other column."""
        numbers = np.arange(rows.start, rows.stop, dtype=np.int64)
        classes = numbers % len(self.spec.stars)
        if name == "id":
            return numbers + scene_id(self.split, 0)
        if name == "label":
            return classes
        if name == "star_count":
            return np.array(self.spec.stars, dtype=np.int64)[classes]
        if name == "seed":
            return np.array([scene_seed(self.seed, self.split, row) for row in rows], dtype=np.int64)
        raise KeyError(name)


class LazyRow(RowGroup):
    """One row that looks like a stored one; scene and mesh are made on first use."""

    _origin: SceneTable

    def __init__(self, origin: SceneTable, row: int) -> None:
        # The base's fields would be set through its frozen constructor, which wants the table at once.
        self.__dict__.update(_origin=origin, path="", first_row=row)

    @cached_property
    def table(self) -> Any:
        """The row as an Arrow table, for pickling."""
        origin = self._origin
        return origin.made(self.first_row, 1)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Columns by dotted name."""
        return column_names(self._origin.schema)

    @cached_property
    def _scene(self) -> Scene:
        origin = self._origin
        return sample_scenes(origin.spec, origin.split, origin.seed, self.first_row, 1)[0]

    @cached_property
    def _meshes(self) -> SceneMeshes:
        meshes = build_meshes([self._scene.placements])
        for column in (meshes.vertices_m, meshes.faces):
            column.values.setflags(write=False)
        return meshes

    def ragged(self, name: str) -> RaggedColumn:
        """Return the vertices or the faces."""
        if name == VERTICES:
            return self._meshes.vertices_m
        return self._meshes.faces if name == FACES else super().ragged(name)

    def flat(self, name: str) -> NDArray[Any]:
        """Return a plain column of one value."""
        if name in _KNOWN:
            return self._origin.known(name, range(self.first_row, self.first_row + 1))
        # Filled by index: numpy would spread a list over an array of its own.
        values = np.empty(1, dtype=object)
        if name == "placements":
            values[0] = [placement._asdict() for placement in self._scene.placements]
        else:
            values[0] = getattr(self._scene, name)
        return values


class SceneDataset(SceneMeshDataset):
    """Scenes on the fly: the records that ``starstruck generate`` writes, index by index, without any files.

    Parameters
    ----------
    spec : SceneSpec, optional
        How scenes are made; as published by default.
    split : str
        One of :data:`starstruck_gen.SPLITS`. Splits never share a scene.
    size : int
        Number of scenes; scene i does not depend on it.
    seed : int
        Seed of the data set.

    Raises
    ------
    InputError
        Unknown split, a size outside 0 to 1,000,000,000, or a negative seed.

    Examples
    --------
    >>> scenes = SceneDataset(size=1_000_000, seed=3)
    >>> scenes[123_456].star_count
    1
    >>> scenes[123_456].mesh.is_watertight
    True
    """

    def __init__(
        self, spec: SceneSpec | None = None, split: str = "train", size: int = DEFAULT_SIZE, seed: int = 0
    ) -> None:
        spec = spec or SceneSpec()
        size, seed = plain_number(size), plain_number(seed)
        if split not in SPLITS:
            raise InputError(f"unknown split {split!r}; expected one of {', '.join(SPLITS)}")
        if not (is_whole(size, seed) and 0 <= size <= MOST_SCENES and seed >= 0):
            found = f"size is {size!r} and seed is {seed!r}"
            raise InputError(f"{found}; expected a size of 0 to {MOST_SCENES:,} and a seed from 0")
        super().__init__([SceneTable(spec, split, size, seed)], label_names=spec.class_names)

    def int_column(self, name: str) -> NDArray[np.int64]:
        """Return one column of integers, shape (len,), int64; none is stored, so that none is damaged.

        Raises
        ------
        InputError
            When the records have no such field.
        """
        return self.column(name).astype(np.int64, copy=False)

    def column(self, name: str) -> NDArray[Any]:
        """Return one plain column, shape (len,); all but id, label, star count and seed make the scenes.

        Raises
        ------
        InputError
            When the records have no such column.
        """
        if name in _KNOWN or name not in self._plain_columns:
            return super().column(name)
        return np.array([record._row.value(name) for record in self], np.int64)
