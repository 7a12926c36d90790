"""Data sets of meshes of any kind: recognised by their columns, opened as what they are.

Those of a provider remember the records used last, with the meshes that they have built, and can be measured
all at once.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from env_assets.wrench.kind import KIND as WRENCH
from mnist3d.dataset import MeshDataset, MeshRecord
from mnist3d.kind import KIND as DIGITS
from starstruck_gen.dataset import SceneMeshDataset, SceneRecord
from starstruck_gen.kind import KIND as SCENES
from tactile_toolkit.cache import MemoryCache
from tactile_toolkit.catalog.kinds import kind_of_meshes
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.columns import class_names, require_mesh_columns
from tactile_toolkit.mesh.records import SolidDataset, SolidRecord
from tactile_toolkit.read.columns import RowGroup
from tactile_toolkit.read.dataset import RecordDataset, Row
from tactile_toolkit.read.parquet import Shard, ShardedTable
from tactile_toolkit.read.sequence import positions

__all__ = [
    "DATASETS",
    "DigitMeshes",
    "MeshSet",
    "PlainMeshes",
    "PointRecord",
    "RecordView",
    "Remembering",
    "SceneMeshes",
    "SolidDataset",
    "SolidMeshes",
    "WrenchDataset",
    "WrenchMeshes",
    "WrenchRecord",
    "as_records",
    "measurable",
    "open_meshes",
]

R = TypeVar("R")
Memory = MemoryCache[Any, Any]
_FIELDS = ("id", "label", "vertices_m", "faces", "mesh")


class Remembering(RecordDataset[R]):
    """Mixin of the data sets of a provider.

    Records, and so the meshes that they have built, come from a memory, and all rows can be measured at once.
    """

    memory: Memory | None = None

    def with_memory(self, memory: Memory) -> Self:
        """Use a memory from now on, also in views; returns itself."""
        self.memory = memory
        return self

    def measured(
        self, key: str, columns: Sequence[str], measure: Callable[[RowGroup], NDArray[np.float64]]
    ) -> NDArray[np.float64]:
        """Measure all rows from a few columns, once for each data set that was opened.

        ``measure`` gives one value, or one array of values, for each row of a group; they are kept under
        ``key``.
        """
        parts = [table.derive(key, columns, measure) for table in self._tables]
        return np.concatenate(parts)[np.asarray(self._rows, np.int64)]

    def _make(self, row: Row) -> R:
        if self.memory is None:
            return super()._make(row)
        make = super()._make
        # The kind of record is in the key, as all data sets of a provider share one memory.
        kept: R = self.memory.get_or_make((type(self), row.path, row.number), lambda: make(row))
        return kept

    def _view(self, tables: Any, rows: Any) -> Self:
        view = super()._view(tables, rows)
        view.memory = self.memory
        return view


class WrenchRecord(SolidRecord):
    """One wrench.

    Frame of the mesh: origin on the axis of the handle, half way along the length, x along the handle towards
    the first jaw, z up, lowest point at z = 0; metres.
    """

    __slots__ = ()

    @property
    def opening_mm(self) -> float:
        """Width across flats of the first jaw, millimetres."""
        return float(self._row.required("opening_mm"))

    @property
    def second_opening_mm(self) -> float:
        """Width across flats of the second jaw, millimetres; 0 where the handle ends plainly."""
        return float(self._row.required("second_opening_mm"))

    def __repr__(self) -> str:
        return f"WrenchRecord(id={self.id}, {self.opening_mm:g} mm, {len(self.faces):,} faces)"

    def _repr_html_(self) -> str:
        """Show the wrench from above in a notebook."""
        from tactile_toolkit.pictures.relief import relief
        from tactile_toolkit.pictures.writing import figure_html

        return figure_html(relief(self.vertices_m, self.faces), repr(self))

    def _tile_html(self) -> str:
        from tactile_toolkit.pictures.relief import relief_tile_html

        return relief_tile_html(self.vertices_m, self.faces, f"{self.opening_mm:g} mm, id {self.id}")


class WrenchDataset(RecordDataset[WrenchRecord]):
    """A lazy sequence of :class:`WrenchRecord`."""

    record_class = WrenchRecord
    things = "wrenches"

    @property
    def volumes_m3(self) -> NDArray[np.float64]:
        """Volume of each row, shape (len,), cubic metres; loads no mesh."""
        return self.column("volume_m3")


class DigitMeshes(Remembering[MeshRecord], MeshDataset):
    """Digits of a provider."""


class SceneMeshes(Remembering[SceneRecord], SceneMeshDataset):
    """Scenes of a provider."""


class WrenchMeshes(Remembering[WrenchRecord], WrenchDataset):
    """Wrenches of a provider."""


class SolidMeshes(Remembering[SolidRecord], SolidDataset):
    """Meshes of a provider that are of no kind of their own."""


MeshSet = DigitMeshes | SceneMeshes | WrenchMeshes | SolidMeshes

DATASETS: dict[str, Any] = {
    DIGITS.name: DigitMeshes,
    SCENES.name: SceneMeshes,
    WRENCH.name: WrenchMeshes,
}


def open_meshes(shards: tuple[Shard, ...], name: str, memory: Memory) -> MeshSet:
    """Open the shards of one split as the data set that they are; InputError when these are not meshes."""
    _import_readers()
    table = ShardedTable(shards)
    require_mesh_columns(table.schema, name, DIGITS.made_by)
    kind = kind_of_meshes(table.schema)
    dataset = SolidMeshes if kind is None else DATASETS.get(kind.name, SolidMeshes)
    names = class_names(table.schema, () if kind is None else kind.class_names)
    opened: MeshSet = dataset([table], label_names=names).with_memory(memory)
    return opened


def measurable(meshes: Any) -> Remembering[Any] | PlainMeshes:
    """Return meshes that can be measured all at once; a source other than our provider may give others."""
    if isinstance(meshes, (Remembering, PlainMeshes)):
        return meshes
    # The same tables and rows as a class that can: `mnist3d.load` and its like know nothing of measuring.
    return SolidMeshes(meshes._tables, meshes._rows, meshes.label_names)


def _import_readers() -> None:
    """Import now what reading imports.

    A process that is forked while another thread imports something waits for ever for that import's lock.
    """
    for module in ("pyarrow.parquet", "pyarrow.compute", "trimesh"):
        import_module(module)
    # The first time that Arrow makes an array of numpy, it looks for pandas.
    import_module("pyarrow").array([0]).to_numpy()


@dataclass(frozen=True, eq=False)
class PlainMeshes(Sequence[Any]):
    """Records in memory, in the part of the shape of ``RecordDataset`` that environments use.

    What each has, :meth:`env_assets.AssetSource.meshes` says.
    """

    records: Sequence[Any]
    label_names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.records)

    def __getitem__(self, key: Any) -> Any:
        """Return a record (int), or some of them (slice, ints, mask)."""
        if isinstance(key, (int, np.integer)):
            return self.records[int(key)]
        rows = positions(key, len(self)).tolist()
        return PlainMeshes([self.records[row] for row in rows], self.label_names)

    @property
    def ids(self) -> NDArray[np.int64]:
        """Id of each record, shape (len,)."""
        return self.column("id")

    @property
    def labels(self) -> NDArray[np.int64]:
        """Label of each record, shape (len,)."""
        return self.column("label")

    def column(self, name: str) -> NDArray[np.int64]:
        """Return ids or labels, shape (len,)."""
        if name not in ("id", "label"):
            message = f"no column {name!r} in these meshes"
            raise InputError(message)
        return np.array([getattr(record, name) for record in self.records], np.int64)


@dataclass(frozen=True, eq=False)
class RecordView:
    """A record that is shown otherwise, with its own id and label."""

    record: Any

    @property
    def id(self) -> int:
        """Number of the row, unique in its data set."""
        return int(self.record.id)

    @property
    def label(self) -> int:
        """Number of the class."""
        return int(self.record.label)


@dataclass(frozen=True, eq=False)
class PointRecord:
    """A point of somebody's ``tactile_mnist.MeshDataset`` as a record; ids of such may be words."""

    points: Sequence[Any]
    id: int

    @property
    def label(self) -> int:
        """Number of the class."""
        return int(self.points[self.id].label)

    @property
    def mesh(self) -> Any:
        """The mesh, metres, with its colours."""
        return self.points[self.id].mesh

    @property
    def vertices_m(self) -> NDArray[np.float32]:
        """Vertices, shape (V, 3), metres."""
        return np.asarray(self.mesh.vertices, np.float32)

    @property
    def faces(self) -> NDArray[np.int32]:
        """Triangles, shape (F, 3)."""
        return np.asarray(self.mesh.faces, np.int32)


def as_records(meshes: Any, label_names: Sequence[str] = ()) -> PlainMeshes | None:
    """Take a sequence for meshes; None where it holds something else, InputError where a label is no number.

    ``label_names`` are the classes of a sequence that does not name its own; numbers by default.
    """
    if not isinstance(meshes, Sequence) or isinstance(meshes, (str, bytes)):
        return None
    # Of the first alone: reading all fields of a lazy sequence would read all meshes.
    if not all(hasattr(record, name) for record in meshes[:1] for name in _FIELDS):
        return None
    names = tuple(getattr(meshes, "label_names", label_names))
    most = -1
    for row, record in enumerate(meshes):
        label: Any = getattr(record, "label", None)
        try:
            most = max(most, operator.index(label))
        except TypeError:
            message = f"record {row} has label {label!r}; expected the number of its class, from 0 on"
            raise InputError(message) from None
    return PlainMeshes(meshes, names or tuple(str(label) for label in range(most + 1)))
