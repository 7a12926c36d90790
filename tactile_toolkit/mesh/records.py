"""Records of stored meshes, data sets of them, and reading them in one pass."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.mesh.columns import FACES, VERTICES, require_mesh_columns
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.read.columns import class_names
from tactile_toolkit.read.dataset import Record, RecordDataset, Row, with_origins
from tactile_toolkit.read.parquet import Shard, ShardedTable
from tactile_toolkit.wording import counted

if TYPE_CHECKING:
    import trimesh


R = TypeVar("R", bound=Record)
S = TypeVar("S", bound="SolidRecord")
D = TypeVar("D", bound=RecordDataset[Any])
W = TypeVar("W", bound="RecordStream[Any]")


class SolidRecord(Record):
    """One row of the published mesh layout: an id, a label and a mesh. Fields are loaded on first use."""

    __slots__ = ()

    @property
    def id(self) -> int:
        """Number of the row, unique in its data set."""
        return int(self._row.required("id"))

    @property
    def label(self) -> int:
        """Number of the class."""
        return int(self._row.required("label"))

    @property
    def vertices_m(self) -> NDArray[np.float32]:
        """Vertices, shape (V, 3), float32, metres; a read-only view of the stored values."""
        return self._row.array(VERTICES)

    @property
    def faces(self) -> NDArray[np.int32]:
        """Triangles, shape (F, 3), int32, counter-clockwise seen from outside; a read-only view."""
        return self._row.array(FACES)

    @property
    def mesh(self) -> trimesh.Trimesh:
        """The mesh, metres. Vertices stay as they are stored: none is merged, dropped or moved."""
        # Nearly all of the 76 µs of a mesh are trimesh's own, which takes no float32 as it is
        # (benchmarks/README.md).
        found: trimesh.Trimesh = self._once("mesh", lambda: Mesh(self.vertices_m, self.faces).to_trimesh())
        return found

    @property
    def volume_m3(self) -> float:
        """Volume in cubic metres: the stored one, or that of the mesh where none is stored."""
        return float(self._row.required("volume_m3") if self._row.has("volume_m3") else self.mesh.volume)

    def __repr__(self) -> str:
        return f"{type(self).__name__}(id={self.id}, label={self.label}, {len(self.faces):,} faces)"


class SolidDataset(RecordDataset[S]):
    """A lazy sequence of meshes: any data set in the published layout of meshes."""

    record_class: ClassVar[Any] = SolidRecord
    things = "solids"

    @property
    def volumes_m3(self) -> NDArray[np.float64]:
        """Volume of each row, shape (len,), cubic metres; loads no mesh."""
        return self.column("volume_m3")


class RecordStream(Generic[R]):
    """Records one after another, read from the address piece by piece; nothing is stored locally.

    Parameters
    ----------
    shards : tuple of Shard
        Shards to read in turn.
    record : type
        Kind of record.
    default_names : tuple of str
        Class names where the shards name none.
    """

    def __init__(self, shards: tuple[Shard, ...], record: type[R], default_names: tuple[str, ...]) -> None:
        self._shards = shards
        self._record = record
        self._default_names = default_names

    @property
    def label_names(self) -> tuple[str, ...]:
        """Name of each class."""
        return class_names(self._shards[0].schema, self._default_names)

    def __repr__(self) -> str:
        words = with_origins(counted(len(self._shards), "shards"), ShardedTable(self._shards))
        return f"{type(self).__name__}({self._record.__name__}, {', '.join(words)})"

    def __iter__(self) -> Iterator[R]:
        """Decode one block of rows at a time."""
        for shard in self._shards:
            for block in shard.all_blocks():
                yield from (self._record(Row(block, row)) for row in range(len(block.table)))


def open_solids(
    shards: tuple[Shard, ...],
    name: str,
    dataset: type[D],
    kind: DatasetKind,
    stream: type[W] | None = None,
) -> D | W:
    """Open shards as a data set of one kind, or as a stream of its records, of a class that is given.

    ``name`` is the data set in the user's words. Raises InputError when a mesh column is missing.
    """
    table = ShardedTable(shards)
    require_mesh_columns(table.schema, name, kind.made_by)
    if stream is not None:
        return stream(shards, dataset.record_class, kind.class_names)
    return dataset(table, label_names=class_names(table.schema, kind.class_names, name))
