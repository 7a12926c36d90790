"""Objects laid onto their broadest sides before an environment gets them.

The package does so itself where ``smallest_dimension_up`` is set, and fails with scipy 1.17, whose rotations
refuse the read-only corners of trimesh's boxes. The same turn is made here instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from env_assets.mesh_sets import PlainMeshes, RecordView
from tactile_toolkit.read.dataset import RecordDataset

__all__ = ["FlatMeshes", "flat_turn"]


def flat_turn(mesh: Any) -> NDArray[np.float64]:
    """Return the rotation, shape (3, 3), that turns the shortest side of the box around a mesh upright.

    Of the other two sides, the one that lies more along x becomes x; what was above stays above.
    """
    box = mesh.bounding_box_oriented.primitive
    short, *others = np.asarray(box.transform)[:3, :3].T[np.argsort(box.extents)]
    up = -short if short[2] < 0 else short
    # From the longest on: of two sides that lie alike, the package takes that one.
    along = max(reversed(others), key=lambda side: abs(side[0]))
    return np.stack([along, np.cross(up, along), up])


@dataclass(frozen=True, eq=False)
class _FlatRecord(RecordView):
    """A record in the pose that :func:`flat_turn` gives it."""

    @property
    def faces(self) -> NDArray[np.int32]:
        """As the record's."""
        faces: NDArray[np.int32] = self.record.faces
        return faces

    @property
    def vertices_m(self) -> NDArray[np.float32]:
        """Vertices, shape (V, 3), metres."""
        return np.asarray(self.mesh.vertices, np.float32)

    @cached_property
    def mesh(self) -> Any:
        """The turned mesh."""
        turned = self.record.mesh.copy()
        turned.vertices = turned.vertices @ flat_turn(self.record.mesh).T
        return turned


@dataclass(frozen=True, eq=False)
class FlatMeshes(PlainMeshes):
    """Meshes of a data set, each laid flat when it is read; ``records`` is that data set."""

    records: Any

    @classmethod
    def of(cls, meshes: RecordDataset[Any] | PlainMeshes) -> FlatMeshes:
        """Lay the meshes of a data set flat."""
        return cls(meshes, tuple(meshes.label_names))

    def __getitem__(self, key: Any) -> Any:
        """Return a record (int), or some of them (slice, ints, mask)."""
        found = self.records[key]
        if isinstance(key, (int, np.integer)):
            return _FlatRecord(found)
        return FlatMeshes(found, self.label_names)

    def column(self, name: str) -> NDArray[np.int64]:
        """Return ids or labels, shape (len,); no mesh is read."""
        column: NDArray[np.int64] = self.records.column(name)
        return column
