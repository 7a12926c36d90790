"""Data sets of meshes of any kind: recognised by their columns, opened as what they are.

Those of a provider keep the records used last, with the meshes that they have built.
"""

from __future__ import annotations

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
from tactile_toolkit.mesh.columns import class_names, require_mesh_columns
from tactile_toolkit.mesh.records import SolidDataset, SolidRecord
from tactile_toolkit.read.dataset import RecordDataset
from tactile_toolkit.read.parquet import Shard, ShardedTable

R = TypeVar("R")
Memory = MemoryCache[Any, Any]


class CachedRecords(RecordDataset[R]):
    """Mixin of the data sets of a provider: records, with the meshes that they built, come from a memory."""

    memory: Memory | None = None

    def with_memory(self, memory: Memory) -> Self:
        """Use a memory from now on, also in views; returns itself."""
        self.memory = memory
        return self

    def _stored(self, row: int) -> R:
        if self.memory is None:
            return super()._stored(row)
        stored = self._row(row)
        key = (type(self), stored.path, stored.number)
        # The kind of record is in the key, as all data sets of a provider share one memory.
        kept: R = self.memory.get_or_make(key, lambda: self.record_class(stored))
        return kept


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
        from tactile_toolkit.pictures.render import relief
        from tactile_toolkit.pictures.writing import figure_html

        return figure_html(relief(self.vertices_m, self.faces), repr(self))

    def _tile_html(self) -> str:
        from tactile_toolkit.pictures.render import relief_tile_html

        return relief_tile_html(self.vertices_m, self.faces, f"{self.opening_mm:g} mm, id {self.id}")


class WrenchDataset(RecordDataset[WrenchRecord]):
    """A lazy sequence of :class:`WrenchRecord`."""

    record_class = WrenchRecord
    things = "wrenches"

    @property
    def volumes_m3(self) -> NDArray[np.float64]:
        """Volume of each row, shape (len,), cubic metres; loads no mesh."""
        return self.column("volume_m3")


class DigitMeshes(CachedRecords[MeshRecord], MeshDataset):
    """Digits of a provider."""


class SceneMeshes(CachedRecords[SceneRecord], SceneMeshDataset):
    """Scenes of a provider."""


class WrenchMeshes(CachedRecords[WrenchRecord], WrenchDataset):
    """Wrenches of a provider."""


class SolidMeshes(CachedRecords[SolidRecord], SolidDataset):
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


def _import_readers() -> None:
    """Import now what reading imports.

    A process that is forked while another thread imports something waits for ever for that import's lock.
    """
    for module in ("pyarrow.parquet", "pyarrow.compute", "trimesh"):
        import_module(module)
    # The first time that Arrow makes an array of numpy, it looks for pandas.
    import_module("pyarrow").array([0]).to_numpy()
