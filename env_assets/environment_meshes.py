"""Meshes as the package ``tactile-mnist`` wants them: its own class of data set, read by our loader."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from env_assets.environment_packages import published_package
from env_assets.environment_rows import Reader, Records, StoredRows, label_feature

if TYPE_CHECKING:
    import tactile_mnist
else:
    tactile_mnist = published_package("tactile_mnist")

__all__ = ["CELL_SIZE_M", "CacheSize", "MeshPoint", "StoredMeshDataset", "has_equal_rows", "mesh_keywords"]

CELL_SIZE_M: tuple[float, float] = tuple(tactile_mnist.CELL_SIZE.tolist())
"""Width and depth of the cell of the digits, metres."""

_MERGED_M = 1e-8
"""Vertices closer than this are one to ``trimesh`` (its ``tol.merge``)."""

_MIXERS = np.array([0x1E3779B97F4A7C15, 0x42B2AE3D27D4EB4F, 0x165667B19E3779F9])
"""Odd numbers without a pattern: sums of multiples of them, which wrap around, rarely meet."""

CacheSize = int | Literal["full"]


@dataclass(frozen=True, eq=False)
class MeshPoint:
    """One mesh, as the environments want it: ``id``, ``label`` and ``mesh``.

    Parameters
    ----------
    record : SolidRecord
        The stored row.
    """

    record: Any

    @property
    def id(self) -> int:
        """Number of the row, unique in its data set."""
        return int(self.record.id)

    @property
    def label(self) -> int:
        """Number of the class."""
        return int(self.record.label)

    @cached_property
    def mesh(self) -> Any:
        """The mesh, metres, a ``trimesh.Trimesh``; equal vertices are merged, as the package does."""
        if not has_equal_rows(self.record.vertices_m):
            return self.record.mesh
        import trimesh

        return trimesh.Trimesh(self.record.vertices_m, self.record.faces)


class StoredMeshDataset(tactile_mnist.HuggingfaceMeshDataset):  # type: ignore[misc]
    """A ``tactile_mnist.MeshDataset`` that reads meshes by our loader; see :func:`as_mesh_dataset`.

    Parameters
    ----------
    meshes : RecordDataset or PlainMeshes
        What it holds.
    cache_size : int or "full"
        How many points are kept once read, as for every data set of the package.
    """

    def __init__(self, meshes: Records, cache_size: CacheSize = 0) -> None:
        super().__init__(_mesh_rows(meshes), cache_size=cache_size)
        self._meshes = meshes

    @property
    def meshes(self) -> Records:
        """The records behind the points."""
        return self._meshes

    def __iter__(self) -> Iterator[MeshPoint]:
        return (self[index] for index in range(len(self)))

    def __reduce__(self) -> tuple[Any, ...]:
        return (type(self), (self._meshes, self.cache_size))

    def _get_data_point_type(self) -> type[MeshPoint]:
        return MeshPoint

    def _get_item(self, index: int) -> MeshPoint:
        return MeshPoint(self._meshes[index])

    def _select(self, indices: NDArray[np.int64]) -> StoredMeshDataset:
        return StoredMeshDataset(self._meshes[indices], self.cache_size)


def mesh_keywords(record: Any) -> dict[str, Any]:
    """Return what ``trimesh.Trimesh`` makes the mesh of a record from, as the package would make it.

    The package lets ``trimesh`` merge equal vertices, without which a published mesh would not be closed.
    That costs more than all the rest, so it is left out for meshes that have none.
    """
    vertices_m = record.vertices_m
    return {"vertices": vertices_m, "faces": record.faces, "process": has_equal_rows(vertices_m)}


def has_equal_rows(vertices_m: NDArray[np.float32]) -> bool:
    """Tell whether vertices may be equal; now and then two unlike ones look so, which only costs time."""
    grid = np.round(vertices_m.astype(np.float64) / _MERGED_M).astype(np.int64)
    mixed = grid @ _MIXERS
    mixed.sort()
    return bool((mixed[1:] == mixed[:-1]).any())


def _mesh_rows(meshes: Records) -> StoredRows:
    readers: dict[str, Reader] = {"id": attrgetter("id"), "label": attrgetter("label"), "mesh": mesh_keywords}
    return StoredRows(meshes, readers, label_feature(meshes))
