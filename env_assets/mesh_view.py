"""Meshes in the one shape that environments use: those of a data set, of files, or records in memory."""

from __future__ import annotations

import contextlib
import operator
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.read.dataset import RecordDataset
from tactile_toolkit.read.sequence import positions

_FIELDS = ("id", "label", "vertices_m", "faces", "mesh")


@dataclass(frozen=True, eq=False)
class MeshView(Sequence[Any]):
    """A sequence of records of meshes, with their classes and measures.

    Attributes
    ----------
    records : sequence
        Records as :meth:`env_assets.AssetSource.meshes` describes them.
    label_names : tuple of str
        Classes, in order.
    flat : bool
        Each mesh is turned onto its broadest side when it is read (:func:`flat_turn`).
    """

    records: Sequence[Any]
    label_names: tuple[str, ...]
    flat: bool = False

    @classmethod
    def of(cls, meshes: Any, label_names: Sequence[str] = ()) -> MeshView | None:
        """Return a view of a sequence of meshes; None where it holds something else.

        ``label_names`` are the classes of a sequence that does not name its own; numbers by default.
        InputError where a label is not a number.
        """
        if isinstance(meshes, MeshView):
            return meshes
        if isinstance(meshes, RecordDataset):
            return cls(meshes, tuple(meshes.label_names)) if hasattr(meshes.record_class, "mesh") else None
        if not isinstance(meshes, Sequence) or isinstance(meshes, (str, bytes)) or not meshes:
            return None
        # Of the first alone: reading all fields of a lazy sequence would read all meshes.
        if not all(hasattr(meshes[0], name) for name in _FIELDS):
            return None
        most = -1
        for row, record in enumerate(meshes):
            label: Any = getattr(record, "label", None)
            try:
                most = max(most, operator.index(label))
            except TypeError:
                raise InputError(
                    f"record {row} has label {label!r}; expected the number of its class, from 0 on"
                ) from None
        names = tuple(getattr(meshes, "label_names", label_names))
        return cls(meshes, names or tuple(map(str, range(most + 1))))

    def __len__(self) -> int:
        return len(self.records)

    def __getitem__(self, key: Any) -> Any:
        """Return a record (int), or a view of some of them (slice, ints, mask)."""
        if isinstance(key, (int, np.integer)):
            record = self.records[int(key)]
            return _FlatRecord(record) if self.flat else record
        chosen: Any = self.records
        if isinstance(chosen, RecordDataset):
            return MeshView(chosen[key], self.label_names, self.flat)
        rows = positions(key, len(self)).tolist()
        return MeshView([chosen[row] for row in rows], self.label_names, self.flat)

    @property
    def ids(self) -> NDArray[np.int64]:
        """Id of each record, shape (n,)."""
        return self.column("id")

    @property
    def labels(self) -> NDArray[np.int64]:
        """Label of each record, shape (n,)."""
        return self.column("label")

    def column(self, name: str) -> NDArray[Any]:
        """Return one value of each record, shape (n,); of a data set no mesh is read."""
        if isinstance(self.records, RecordDataset):
            return self.records.column(name)
        return np.array([getattr(record, name) for record in self.records])

    @cached_property
    def volumes_m3(self) -> NDArray[np.float64]:
        """Volume of each mesh, shape (n,), cubic metres; negative where the triangles face inwards."""
        if isinstance(self.records, RecordDataset):
            with contextlib.suppress(InputError):  # the published data sets store no volumes
                return np.asarray(self.records.column("volume_m3"), np.float64)
        return np.array([_volume_m3(record, f"mesh {record.id}") for record in self.records], np.float64)

    @cached_property
    def bounds_m(self) -> NDArray[np.float64]:
        """Lowest and highest corner of each mesh before it is turned, shape (n, 2, 3), metres."""
        bounds = [mesh_bounds_m(record.vertices_m, f"mesh {record.id}") for record in self.records]
        return np.array(bounds, np.float64).reshape(-1, 2, 3)


def mesh_bounds_m(vertices_m: NDArray[np.floating[Any]], where: str) -> NDArray[np.float64]:
    """Return lowest and highest corner of some vertices, shape (2, 3), metres; InputError without any."""
    if not len(vertices_m):
        raise InputError(
            f"{where} has no vertices", next="run `validate` on the data set and generate it again"
        )
    # Column by column: numpy reduces short rows slowly.
    return np.array([[reduce(column) for column in vertices_m.T] for reduce in (np.min, np.max)], np.float64)


def _volume_m3(record: Any, where: str) -> float:
    vertices_m, faces = record.vertices_m, record.faces
    # Data may be of any origin: numpy would raise an error of its own, or for -1 take the last vertex.
    if len(faces) and not (faces.min() >= 0 and faces.max() < len(vertices_m)):
        missing = faces[(faces < 0) | (faces >= len(vertices_m))]
        raise InputError(
            f"{where} has triangles that name vertex {missing[0]}, but only {len(vertices_m):,} vertices",
            next="run `validate` on the data set and generate it again",
        )
    return float(Mesh(vertices_m, faces).volume_m3)


def flat_turn(mesh: Any) -> NDArray[np.float64]:
    """Return the rotation, shape (3, 3), that turns the shortest side of the box around a mesh upright.

    Of the other two sides, the one that lies more along x becomes x; what was above stays above. The package
    does so itself where ``smallest_dimension_up`` is set, and fails with scipy 1.17, whose rotations refuse
    the read-only corners of trimesh's boxes.
    """
    box = mesh.bounding_box_oriented.primitive
    short, *others = np.asarray(box.transform)[:3, :3].T[np.argsort(box.extents)]
    up = -short if short[2] < 0 else short
    # From the longest on: of two sides that lie alike, the package takes that one.
    along = max(reversed(others), key=lambda side: abs(side[0]))
    return np.stack([along, np.cross(up, along), up])


class _MeshRecord:
    """A record of which the mesh is given."""

    mesh: Any

    @property
    def vertices_m(self) -> NDArray[np.float32]:
        """Vertices, shape (V, 3), metres."""
        return np.asarray(self.mesh.vertices, np.float32)

    @property
    def faces(self) -> NDArray[np.int32]:
        """Triangles, shape (F, 3)."""
        return np.asarray(self.mesh.faces, np.int32)


class _FlatRecord(_MeshRecord):
    """A record in the pose that :func:`flat_turn` gives it."""

    def __init__(self, record: Any) -> None:
        self.id, self.label = record.id, record.label
        self._record = record

    @cached_property
    def mesh(self) -> Any:
        """The turned mesh."""
        turned = self._record.mesh.copy()
        turned.vertices = turned.vertices @ flat_turn(self._record.mesh).T
        return turned


@dataclass(frozen=True, eq=False)
class PointRecord(_MeshRecord):
    """A point of a ``tactile_mnist.MeshDataset`` as a record; its number is its id: ids there may be text."""

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
