"""Meshes as environments use them, whether they come from a data set, from files or from memory."""

from __future__ import annotations

import contextlib
import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from tactile_toolkit.array_types import AnyArray, Float32, Float64, Floating, Int32
from tactile_toolkit.cache import MemoryCache
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh, SolidRecord
from tactile_toolkit.read import AnyRecords, RecordDataset, picks_several, positions

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True, eq=False)
class LazyMesh:
    """A record whose mesh is read on first use; ``name`` is that of its file."""

    id: int
    label: int
    read: Callable[[], trimesh.Trimesh]
    name: str = ""

    @property
    def mesh(self) -> trimesh.Trimesh:
        """The mesh, metres; the least recently used are evicted from memory."""
        return _MESHES.get_or_make(self, self.read)

    @property
    def vertices_m(self) -> Float32:
        """Vertices, shape (V, 3), metres."""
        return np.asarray(self.mesh.vertices, np.float32)

    @property
    def faces(self) -> Int32:
        """Triangles, shape (F, 3), counter-clockwise seen from outside."""
        return np.asarray(self.mesh.faces, np.int32)


MeshRecord = SolidRecord | LazyMesh
"""A mesh with its number, unique among the meshes of a split, and its class."""

_MESHES = MemoryCache[LazyMesh, "trimesh.Trimesh"](64)


@dataclass(frozen=True, eq=False)
class MeshView(Sequence[MeshRecord]):
    """A sequence of records of meshes, with their classes and measures.

    Attributes
    ----------
    records : sequence of MeshRecord
        The meshes.
    label_names : tuple of str
        Classes, in order.
    flat : bool
        Whether each mesh is turned onto its broadest side when it is read (``flat_turn``).
    """

    records: Sequence[MeshRecord]
    label_names: tuple[str, ...]
    flat: bool = False

    @classmethod
    def of(cls, meshes: MeshView | AnyRecords) -> MeshView:
        """Return a view of a data set of meshes; a view as it is."""
        if isinstance(meshes, MeshView):
            return meshes
        return cls(meshes, tuple(meshes.label_names))

    def __len__(self) -> int:
        return len(self.records)

    @overload
    def __getitem__(self, key: int) -> MeshRecord: ...
    @overload
    def __getitem__(self, key: slice | Sequence[int] | AnyArray) -> MeshView: ...
    def __getitem__(self, key: Any) -> MeshRecord | MeshView:
        """Return a record (int), or a view of some of them (slice, ints, mask)."""
        if not picks_several(key):
            record = self.records[operator.index(key)]
            if self.flat:
                return LazyMesh(record.id, record.label, partial(_laid_flat, record))
            return record
        if isinstance(self.records, RecordDataset):
            return MeshView(self.records[key], self.label_names, self.flat)
        chosen = [self.records[row] for row in positions(key, len(self)).tolist()]
        return MeshView(chosen, self.label_names, self.flat)

    def column(self, name: str) -> AnyArray:
        """Return one value of each record, shape (n,); reads no mesh of a data set."""
        if isinstance(self.records, RecordDataset):
            return self.records.column(name)
        return np.array([getattr(record, name) for record in self.records])

    @cached_property
    def volumes_m3(self) -> Float64:
        """Volume of each mesh, shape (n,), cubic metres; negative if the triangles face inwards."""
        if isinstance(self.records, RecordDataset):
            with contextlib.suppress(InputError):  # the published data sets store no volumes
                return np.asarray(self.records.column("volume_m3"), np.float64)
        return np.array([_volume_m3(record) for record in self.records], np.float64)

    @cached_property
    def bounds_m(self) -> Float64:
        """Lowest and highest corner of each mesh before it is turned, shape (n, 2, 3), metres."""
        bounds = [mesh_bounds_m(record.vertices_m, f"mesh {record.id}") for record in self.records]
        return np.array(bounds, np.float64).reshape(-1, 2, 3)


@dataclass(frozen=True, eq=False)
class PlannedView(MeshView):
    """Meshes of a data set that is not made yet: each is made on first use.

    ``finished`` returns the data set once it is made, otherwise None. ``left`` is the number of meshes that
    were not made when it was planned, which take about ``left_s`` seconds on one core.
    """

    finished: Callable[[], AnyRecords | None] = lambda: None
    left: int = 0
    left_s: float = 0.0


def mesh_bounds_m(vertices_m: Floating, where: str) -> Float64:
    """Return the lowest and highest corner of vertices, shape (2, 3), metres; InputError without vertices."""
    if not len(vertices_m):
        raise InputError(
            f"{where} has no vertices", next="run `validate` on the data set and generate it again"
        )
    # Column by column: numpy reduces short rows slowly.
    return np.array([[reduce(column) for column in vertices_m.T] for reduce in (np.min, np.max)], np.float64)


def _volume_m3(record: MeshRecord) -> float:
    vertices_m, faces = record.vertices_m, record.faces
    # numpy would raise an error of its own, or take the last vertex for -1.
    missing = faces[(faces < 0) | (faces >= len(vertices_m))]
    if len(missing):
        raise InputError(
            f"mesh {record.id} has triangles that name vertex {missing[0]}, but only {len(vertices_m):,} "
            "vertices",
            next="run `validate` on the data set and generate it again",
        )
    return Mesh(vertices_m, faces).volume_m3


def flat_turn(mesh: trimesh.Trimesh) -> Float64:
    """Return the rotation, shape (3, 3), that turns the shortest side of the box around a mesh upright.

    The other side that lies more along x becomes x; the upper side stays up. The package
    does so itself with ``smallest_dimension_up``, but fails with scipy 1.17, whose rotations refuse the
    read-only corners of trimesh's boxes.
    """
    box = mesh.bounding_box_oriented.primitive
    short, *others = np.asarray(box.transform)[:3, :3].T[np.argsort(box.extents)]
    up = math.copysign(1.0, short[2]) * short
    # From the longest on: of two sides that lie alike, the package takes the longer one.
    along = max(reversed(others), key=lambda side: abs(side[0]))
    return np.stack([along, np.cross(up, along), up])


def _laid_flat(record: MeshRecord) -> trimesh.Trimesh:
    turned = record.mesh.copy()
    turned.vertices = turned.vertices @ flat_turn(record.mesh).T
    return turned
