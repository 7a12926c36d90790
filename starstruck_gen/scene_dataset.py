"""Data sets of scenes: columns, generation, and records, loaded or made from a seed on request."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
from typing import Any, Unpack

import numpy as np
import pyarrow as pa

from starstruck_gen import sampling, scene, shapes
from starstruck_gen.kind import KIND
from starstruck_gen.scene import Scene
from tactile_toolkit import (
    catalog,
    checked_fields,
    generation,
    mesh,
    pictures,
    places,
    read,
    rows,
    store,
    touch,
)
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import Int64, JsonDict, UInt8
from tactile_toolkit.wording import with_count

DEFAULT_SIZE = 300_000
"""Default number of scenes of a split on the fly (package tactile-mnist 0.13.0)."""
_MADE_TOGETHER = 4096  # rows that training shuffles as it does those of a shard
# Columns that follow from the number of a scene.
_KNOWN = ("id", "label", "star_count", "seed")
_SURFACE = pictures.DrawnSolid.drawn_columns

PARQUET_STYLE = store.ParquetStyle(
    rows_per_group=1_000,
    compression="zstd",
    # Level 9: scenes are small and repeat the triangles of their shapes.
    compression_level=9,
    # Each corner occurs twice, on the plate and above it. zstd finds the pair in plain bytes; encodings that
    # split numbers hide it.
    encodings=mesh.MeshRow.encodings("PLAIN"),
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
def scene_schema(class_names: tuple[str, ...] = KIND.class_names) -> pa.Schema:
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
            usual_shards=48,
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


def default_set(seed: int, per_class: int | None) -> generation.DefaultSet:
    """Return the scenes that need no input: as published, or fewer."""
    scenes = dict(PUBLISHED_SIZES)
    sizes = None
    if per_class is not None:
        most = per_class * len(KIND.class_names)
        scenes = {split: min(size, most) for split, size in scenes.items()}
        sizes = ",".join(f"{split}={size}" for split, size in scenes.items())
    spec = SceneSetSpec(scenes=tuple(scenes.items()), seed=seed)
    return generation.DefaultSet(SceneGenerator(spec), {"scenes": sizes, "seed": seed})


class SceneRecord(pictures.DrawnSolid):
    """One scene; fields are loaded on first use.

    Frame of the mesh: origin at the centre of the cell, x right, y away from the robot, z up, objects on
    z = 0; metres. Data sets without our columns (the published one) have ``id``, ``label``, ``star_count``
    and the mesh; other fields raise :class:`~tactile_toolkit.errors.InputError`.
    """

    __slots__ = ()
    is_faceted = True
    drawn_columns = (*_SURFACE, "star_count", "placements")

    @property
    def star_count(self) -> int:
        """Number of stars; that of the published class if it is not stored."""
        return self.row.integer("star_count") if self.row.has("star_count") else self.label + 1

    @property
    def distractor_count(self) -> int:
        """Number of objects that are not stars; InputError if it is not stored."""
        return self._stated("distractor_count").integer("distractor_count")

    @property
    def has_placements(self) -> bool:
        """Whether the data set stores placements; the published one does not."""
        return self.row.has("placements")

    @property
    def placements(self) -> tuple[scene.Placement, ...]:
        """Objects in the order of placing, stars first; InputError if they are not stored."""
        return self._once(
            "placements",
            lambda: tuple(
                scene.Placement(**entry) for entry in self._stated("placements").required("placements")
            ),
        )

    @property
    def seed(self) -> int:
        """Seed of the scene: specification, star count and seed make the scene again."""
        return self._stated("seed").integer("seed")

    @property
    def scene(self) -> Scene:
        """The scene: its placements, and statistics of sampling."""
        attempts = tuple(int(count) for count in self._stated("attempts").required("attempts"))
        return Scene(self.star_count, self.placements, attempts, self._stated("restarts").integer("restarts"))

    def _stated(self, name: str) -> read.Row:
        """Return the row; InputError if the data set has no such column."""
        if not self.row.has(name):
            raise InputError(
                f"this data set stores no {name!r}", next="use one written by `starstruck generate`"
            )
        return self.row

    def __repr__(self) -> str:
        return f"SceneRecord(id={self.id}, label={self.label}, star_count={self.star_count})"

    def caption(self, label_names: Sequence[str] = ()) -> str:
        """Return the number of stars."""
        return with_count(self.star_count, "stars")

    @property
    def notes(self) -> list[tuple[str, str]]:
        """Size and seed."""
        return [*super().notes, ("Seed", str(self.seed))] if self.has_placements else super().notes

    @property
    def details(self) -> str:
        """Text below a large picture."""
        if not self.has_placements:
            return super().details
        return f"{super().details}, {with_count(self.distractor_count, 'distractors')}"

    @property
    def legend(self) -> str:
        """Meaning of the colours of a picture."""
        return "stars are yellow" if self.has_placements else "it is not stored which objects are stars"

    @property
    def cell_m(self) -> tuple[float, float]:
        """Width and depth of the cell, metres: those of the specification, or larger if the scene is.

        Rows without a manifest beside them are taken to have the published cell.
        """
        width_m, depth_m = self.row.group.once("cell_m", partial(_stored_cell_m, self.row))
        # Twice the distance of the farthest corner, and a margin.
        reach_m = 2.05 * np.abs(self.vertices_m[:, :2]).max(axis=0)
        return max(width_m, float(reach_m[0])), max(depth_m, float(reach_m[1]))

    @property
    def extent_m(self) -> float:
        """Longer side of what a picture shows, metres."""
        return max(self.cell_m) if self.has_placements else super().extent_m

    @property
    def parts(self) -> list[tuple[int, str]]:
        """Runs of triangles of stars and of other objects.

        Without placements, all objects are others. Empty if the triangles are not those of the declared
        objects.
        """
        if not self.has_placements:
            return [(len(self.faces), "other")]
        runs = [
            (len(shapes.prism(placed.shape).faces), "main" if placed.is_star else "other")
            for placed in self.placements
        ]
        return runs if sum(count for count, _ in runs) == len(self.faces) else []

    def picture(self, width_px: float) -> UInt8:
        """Draw the cell from above, stars in their own colour; without placements, the mesh in relief."""
        if not self.has_placements:
            return super().picture(width_px)
        px_per_mm = width_px / self.extent_m / mesh.MM_PER_M
        return np.asarray(scene.draw_scene(self.placements, self.cell_m, px_per_mm))

    def cutout(self, width_px: float) -> UInt8:
        """Draw the objects with opacity, (H, W, 4); without placements, the mesh in relief, (H, W, 2)."""
        if not self.has_placements:
            return super().cutout(width_px)
        return scene.without_plate(self.picture(width_px))


def _stored_cell_m(row: read.Row) -> tuple[float, float]:
    """Return the cell of the specification beside the file of a row; without one, the published cell."""
    manifest = read.Shard(row.path).manifest()
    made_by = {} if manifest is None else manifest.made_by
    with catalog.specification_read(row.path):
        width_m, depth_m = made_by.get("scene", {}).get("cell_m", touch.CELL_M)
    return width_m, depth_m


class SceneMeshDataset(mesh.SolidDataset[SceneRecord]):
    """A lazy sequence of :class:`SceneRecord`; see :class:`tactile_toolkit.read.RecordDataset`."""

    record_class = SceneRecord
    things = "scenes"

    @property
    def star_counts(self) -> Int64:
        """Number of stars of each row, shape (len,); loads no mesh. As :attr:`SceneRecord.star_count`."""
        return self._integers("star_count", lambda: self.labels + 1, lambda scene: scene.star_count)


load = places.loader(KIND, SceneMeshDataset, SceneRecord)


class MadeScenes:
    """A source of rows without a file: each scene of a split is made when it is requested."""

    path = ""

    def __init__(self, spec: sampling.SceneSpec, split: str, size: int, seed: int) -> None:
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
        return scene_schema(self.spec.class_names)

    @property
    def part_sizes(self) -> Sequence[int]:
        """Rows of the parts that training mixes."""
        return [min(_MADE_TOGETHER, self.size - row) for row in range(0, self.size, _MADE_TOGETHER)]

    def __len__(self) -> int:
        return self.size

    def unpack(self, _index: int) -> int:
        """Return 0: nothing is unpacked."""
        return 0

    def locate(self, row: int) -> tuple[read.RowGroup, int]:
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
        return SceneRow.table(make_rows(self.spec, self.split, self.seed, start, count), self.schema)

    def column(self, name: str) -> pa.Array:
        """Return one column of all rows, which must be known without the scenes."""
        return pa.array(self.known(name, range(self.size)))

    def known(self, name: str, held: range) -> Int64:
        """Return a column that follows from row numbers; KeyError for any other column."""
        numbers = np.arange(held.start, held.stop, dtype=np.int64)
        classes = numbers % len(self.spec.stars)
        if name == "id":
            return numbers + sampling.scene_id(self.split, 0)
        if name == "label":
            return classes
        if name == "star_count":
            return np.array(self.spec.stars, dtype=np.int64)[classes]
        if name == "seed":
            return np.array([sampling.scene_seed(self.seed, self.split, row) for row in held], dtype=np.int64)
        raise KeyError(name)


class MadeScene(read.RowGroup):
    """One row, whose scene and mesh are made on first use."""

    def __init__(self, source: MadeScenes, row: int) -> None:
        super().__init__(first_row=row)
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
        made = self._source
        return self.once(
            "scene",
            lambda: sampling.sample_scenes(made.spec, made.split, made.seed, self.first_row, 1)[0],
        )

    def _built(self) -> scene.SceneMeshes:
        meshes = scene.build_meshes([self._scene.placements])
        for column in (meshes.vertices_m, meshes.faces):
            column.values.setflags(write=False)
        return meshes

    def ragged(self, name: str) -> read.RaggedColumn:
        """Return the vertices or the faces."""
        if name not in _SURFACE:
            return super().ragged(name)
        meshes = self.once("meshes", self._built)
        return dict(zip(_SURFACE, (meshes.vertices_m, meshes.faces), strict=True))[name]

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


class SceneDataset(SceneMeshDataset):
    """Scenes on the fly: the records that ``starstruck generate`` writes, without files.

    Parameters
    ----------
    spec : SceneSpec, optional
        How scenes are made; as published by default.
    split : str
        ``"train"`` or ``"test"``. Splits never share a scene.
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
        spec: sampling.SceneSpec | None = None,
        split: str = "train",
        size: int = DEFAULT_SIZE,
        seed: int = 0,
    ) -> None:
        spec = spec or sampling.SceneSpec()
        size = checked_fields.checked_integer(size, "size", 0, sampling.MAX_SCENES)
        seed = checked_fields.checked_integer(seed, "seed")
        sampling.scene_seed(seed, split, 0)  # refuses an unknown split
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
