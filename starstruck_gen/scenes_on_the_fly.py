"""Scenes on the fly: made from a seed when they are requested."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np
import pyarrow as pa

from starstruck_gen import (
    rejection,
    scene,
    scene_dataset,
    scene_generation,
    scene_meshes,
    scene_rows,
    scene_seeds,
    scene_spec,
)
from tactile_toolkit import checked_fields, mesh, read
from tactile_toolkit.array_types import Int64
from tactile_toolkit.rows import table_of

DEFAULT_SIZE = 300_000
"""Default number of scenes of a split on the fly (package tactile-mnist 0.13.0)."""

_MADE_TOGETHER = 4096  # rows that training shuffles as it does those of a shard
# Columns that follow from the number of a scene.
_KNOWN = ("id", "label", "star_count", "seed")


class MadeScenes:
    """A source of rows without a file: each scene of a split is made when it is requested."""

    path = ""

    def __init__(self, spec: scene_spec.SceneSpec, split: str, size: int, seed: int) -> None:
        self.spec = spec
        self.split = split
        self.size = size
        self.seed = seed
        self.identity = (spec, split, size, seed)
        self.origin = self.set_name = (f"seed {seed}", split)
        self.class_names = spec.class_names
        self.group_starts = (0, size)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.spec, self.split, self.size, self.seed)

    @cached_property
    def schema(self) -> pa.Schema:
        """Arrow schema of the rows."""
        return scene_rows.scene_schema(self.spec.class_names)

    @property
    def part_sizes(self) -> Sequence[int]:
        """Rows of the parts that training mixes."""
        return [min(_MADE_TOGETHER, self.size - row) for row in range(0, self.size, _MADE_TOGETHER)]

    def __len__(self) -> int:
        return self.size

    def unpack(self, _index: int) -> int:
        """Return 0: nothing is unpacked."""
        return 0

    def locate(self, row: int) -> tuple[read.Rows, int]:
        """Return a single row, which is not made yet."""
        return MadeScene(self, row), 0

    def blocks(self, _index: int, columns: Sequence[str] | None = None) -> Iterator[read.RowGroup]:
        """Make all rows, which form one row group, in blocks."""
        start = 0
        for count in self.part_sizes:
            table = self.made(start, count)
            yield read.RowGroup(table if columns is None else table.select(columns), first_row=start)
            start += count

    def made(self, start: int, count: int) -> pa.Table:
        """Make a block of rows as an Arrow table."""
        return table_of(
            scene_generation.make_rows(self.spec, self.split, self.seed, start, count), self.schema
        )

    def column(self, name: str) -> pa.Array:
        """Return one column of all rows, which must be known without the scenes."""
        return pa.array(self.known(name, range(self.size)))

    def known(self, name: str, rows: range) -> Int64:
        """Return a column that follows from row numbers; KeyError for any other column."""
        numbers = np.arange(rows.start, rows.stop, dtype=np.int64)
        classes = numbers % len(self.spec.stars)
        if name == "id":
            return numbers + scene_seeds.scene_id(self.split, 0)
        if name == "label":
            return classes
        if name == "star_count":
            return np.array(self.spec.stars, dtype=np.int64)[classes]
        if name == "seed":
            return np.array(
                [scene_seeds.scene_seed(self.seed, self.split, row) for row in rows], dtype=np.int64
            )
        raise KeyError(name)


class MadeScene(read.Rows):
    """One row, whose scene and mesh are made on first use."""

    def __init__(self, source: MadeScenes, row: int) -> None:
        super().__init__("", row)
        self._source = source
        self.once("cell_m", lambda: source.spec.cell_m)

    @cached_property
    def table(self) -> pa.Table:
        """The row as an Arrow table, for pickling."""
        return self._source.made(self.first_row, 1)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Columns by dotted name."""
        return read.column_names(self._source.schema)

    # Not cached properties, whose locks take 1/20 of the time of a scene and its mesh.
    @property
    def _scene(self) -> scene.Scene:
        source, row = self._source, self.first_row
        return self.once(
            "scene", lambda: rejection.sample_scenes(source.spec, source.split, source.seed, row, 1)[0]
        )

    def _built(self) -> scene_meshes.SceneMeshes:
        meshes = scene_meshes.build_meshes([self._scene.placements])
        for column in (meshes.vertices_m, meshes.faces):
            column.values.setflags(write=False)
        return meshes

    def ragged(self, name: str) -> read.RaggedColumn:
        """Return the vertices or the faces."""
        if name not in (mesh.VERTICES, mesh.FACES):
            return super().ragged(name)
        meshes = self.once("meshes", self._built)
        return meshes.vertices_m if name == mesh.VERTICES else meshes.faces

    def flat(self, name: str) -> pa.ArrayArray:
        """Return a plain column of one value."""
        if name in _KNOWN:
            return self._source.known(name, range(self.first_row, self.first_row + 1))
        # Assigned by index: numpy would convert a list to an array.
        values = np.empty(1, dtype=object)
        values[0] = getattr(self._scene, name)
        if name == "placements":
            values[0] = [placement._asdict() for placement in values[0]]
        return values


class SceneDataset(scene_dataset.SceneMeshDataset):
    """Scenes on the fly: the records that ``starstruck generate`` writes, without files.

    Parameters
    ----------
    spec : SceneSpec, optional
        How scenes are made; as published by default.
    split : str
        One of :data:`starstruck_gen.SPLITS`. Splits never share a scene.
    size : int
        Number of scenes; a scene does not depend on it.
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
        self,
        spec: scene_spec.SceneSpec | None = None,
        split: str = "train",
        size: int = DEFAULT_SIZE,
        seed: int = 0,
    ) -> None:
        spec = spec or scene_spec.SceneSpec()
        size = checked_fields.checked_integer(size, "size", 0, scene_seeds.MAX_SCENES)
        seed = checked_fields.checked_integer(seed, "seed")
        scene_seeds.scene_seed(seed, split, 0)  # refuses an unknown split
        super().__init__(
            read.ShardedTable((MadeScenes(spec, split, size, seed),)), label_names=spec.class_names
        )

    def column(self, name: str) -> pa.ArrayArray:
        """Return one plain column, shape (len,); all but id, label, star_count and seed need the scenes.

        Raises
        ------
        InputError
            The records have no such column.
        """
        if name in _KNOWN or name not in self.plain_columns:
            return super().column(name)
        return np.array([record.row.value(name) for record in self], np.int64)
