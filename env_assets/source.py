"""The shape of a source of assets: what an environment may ask for, whoever answers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Sequence

    from realtouch.dataset import TouchSeqDataset, TouchSingleDataset
    from tactile_toolkit.mesh.height_map import HeightMap


@runtime_checkable
class AssetSource(Protocol):
    """Gives assets by name. :class:`env_assets.AssetProvider` is one; an environment needs only this shape.

    Data sets keep order and length for as long as the source lives. All methods may be called from several
    threads, and in processes that were forked or spawned after the source was made.
    """

    def meshes(self, name: str, split: str = "train") -> Sequence[Any]:
        """Return the meshes of a split: records with ``id``, ``label``, ``vertices_m``, ``faces``, ``mesh``.

        Vertices are (V, 3) float32 in metres, faces (F, 3) int32, counter-clockwise seen from outside,
        ``mesh`` is a ``trimesh.Trimesh``. A plain list of such records will do: their classes are then those
        of the name.
        """
        ...

    def touches(self, name: str, split: str = "train") -> TouchSeqDataset | TouchSingleDataset:
        """Return the rounds of real touches of a split, such as ``realtouch.load`` opens them."""
        ...

    def volumes_m3(self, name: str, split: str = "train") -> NDArray[np.float64]:
        """Return the volume of each mesh of a split, shape (n,), cubic metres."""
        ...

    def height_map(self, record: Any, pitch_m: float = 0.0002) -> HeightMap:
        """Return the top surface of a mesh as a grid; see :class:`env_assets.HeightMap`."""
        ...

    def bounds(self, record: Any) -> NDArray[np.float64]:
        """Return lowest and highest corner of a mesh, shape (2, 3), metres, in its own frame."""
        ...

    def placements(self, record: Any) -> Sequence[Any]:
        """Return what stands where in a Starstruck scene, stars first."""
        ...
