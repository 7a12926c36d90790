"""Typed records of stored meshes, and data sets and streams of them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import numpy as np

from tactile_toolkit import read
from tactile_toolkit.array_types import Float32, Float64, Int32
from tactile_toolkit.mesh.files import write_mesh
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.mesh.mesh_columns import FACES, VERTICES

if TYPE_CHECKING:
    import trimesh

R = TypeVar("R", bound=read.Record)
S = TypeVar("S", bound="SolidRecord")


class SolidRecord(read.Record):
    """One row of the published mesh layout: an id, a label and a mesh. Fields are loaded on first use."""

    __slots__ = ()

    @property
    def id(self) -> int:
        """Number of the row, unique in its data set."""
        return self.row.integer("id")

    @property
    def label(self) -> int:
        """Number of the class."""
        return self.row.integer("label")

    @property
    def vertices_m(self) -> Float32:
        """Vertices, shape (V, 3), float32, metres; a read-only view of the stored values."""
        return self.row.array(VERTICES)

    @property
    def faces(self) -> Int32:
        """Triangles, shape (F, 3), int32, counter-clockwise seen from outside; a read-only view."""
        return self.row.array(FACES)

    @property
    def mesh(self) -> trimesh.Trimesh:
        """The mesh, in metres; no vertex is merged, dropped or moved."""
        # Nearly all of the 76 µs are spent in trimesh, which converts float32 (benchmarks/README.md).
        found: trimesh.Trimesh = self._once("mesh", lambda: Mesh(self.vertices_m, self.faces).to_trimesh())
        return found

    @property
    def volume_m3(self) -> float:
        """Volume in cubic metres: the stored value, or else that of the mesh."""
        return float(self.row.required("volume_m3") if self.row.has("volume_m3") else self.mesh.volume)

    def export(self, path: str | Path) -> None:
        """Write the mesh to a file, in the unit of the format.

        Parameters
        ----------
        path : str or Path
            Ends with .stl, .3mf, .ply or .obj, which are in millimetres, or .glb, in metres.

        Raises
        ------
        InputError, StorageError
            The ending is unknown; the file cannot be written.
        """
        write_mesh(path, self)

    def __repr__(self) -> str:
        return f"{type(self).__name__}(id={self.id}, label={self.label}, {len(self.faces):,} faces)"


class SolidDataset(read.RecordDataset[S]):
    """A lazy sequence of meshes in the published layout."""

    record_class: ClassVar[Any] = SolidRecord
    things = "solids"

    @property
    def volumes_m3(self) -> Float64:
        """Volume of each row, shape (len,), float64, cubic metres; loads meshes only where none is stored."""
        if self.has_column("volume_m3"):
            return np.asarray(self.column("volume_m3"), np.float64)
        return np.array([record.volume_m3 for record in self], np.float64)


class RecordStream(read.RowStream[read.RowSource], Generic[R]):
    """Records one after another; see :class:`tactile_toolkit.read.RowStream`.

    Parameters
    ----------
    shards : tuple of RowSource
        Shards, read in order.
    record : type
        Class of the records.
    default_names : tuple of str
        Class names for shards without any.
    """

    def __init__(
        self, shards: tuple[read.RowSource, ...], record: type[R], default_names: tuple[str, ...]
    ) -> None:
        super().__init__(shards)
        self._record = record
        self._default_names = default_names

    @property
    def label_names(self) -> tuple[str, ...]:
        """Name of each class."""
        return read.class_names(self.shards[0].schema, self._default_names)

    def __repr__(self) -> str:
        return self._described(self._record.__name__)

    def __iter__(self) -> Iterator[R]:
        """Decode one block of rows at a time."""
        for shard, index in self.row_groups():
            for block in shard.blocks(index):
                yield from (self._record(read.Row(block, row)) for row in range(len(block.table)))
