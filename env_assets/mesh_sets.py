"""Data sets of meshes of any kind: recognised by their columns, opened as what they are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dataset_store.mesh_columns import class_names, require_mesh_columns
from dataset_store.mesh_records import SolidRecord
from dataset_store.records import RecordDataset
from dataset_store.rowgroups import Shard, ShardedTable
from env_assets.mesh_memory import MeshMemory, Remembering
from mnist3d.dataset import MeshDataset
from mnist3d.rows import CLASS_NAMES as DIGIT_NAMES
from starstruck_gen.dataset import SceneMeshDataset
from starstruck_gen.rows import CLASS_NAMES as STAR_NAMES

__all__ = [
    "DigitMeshes",
    "MeshSet",
    "SceneMeshes",
    "SolidDataset",
    "SolidMeshes",
    "WrenchDataset",
    "WrenchMeshes",
    "WrenchRecord",
    "kind_of",
    "open_meshes",
]


class SolidDataset(RecordDataset[SolidRecord]):
    """A lazy sequence of meshes of no kind of its own: any data set in the published mesh layout."""

    record = SolidRecord


class WrenchRecord(SolidRecord):
    """One wrench.

    Frame of the mesh: origin on the axis of the handle, half way along the length, x along the handle towards
    the first jaw, z up, lowest point at z = 0; metres.
    """

    __slots__ = ()

    @property
    def opening_mm(self) -> float:
        """Width across flats of the first jaw, millimetres."""
        return float(self._row.value("opening_mm"))

    @property
    def second_opening_mm(self) -> float:
        """Width across flats of the second jaw, millimetres; 0 where the handle ends plainly."""
        return float(self._row.value("second_opening_mm"))

    @property
    def volume_m3(self) -> float:
        """Volume in cubic metres."""
        return float(self._row.value("volume_m3"))

    def __repr__(self) -> str:
        return f"WrenchRecord(id={self.id}, {self.opening_mm:g} mm, {len(self.faces):,} faces)"


class WrenchDataset(RecordDataset[WrenchRecord]):
    """A lazy sequence of :class:`WrenchRecord`."""

    record = WrenchRecord

    @property
    def volumes_m3(self) -> NDArray[np.float64]:
        """Volume of each row, shape (len,), cubic metres; loads no mesh."""
        return self.column("volume_m3")


class DigitMeshes(Remembering, MeshDataset):
    """Digits of a provider."""


class SceneMeshes(Remembering, SceneMeshDataset):
    """Scenes of a provider."""


class WrenchMeshes(Remembering, WrenchDataset):
    """Wrenches of a provider."""


class SolidMeshes(Remembering, SolidDataset):
    """Meshes of a provider that are of no kind of their own."""


MeshSet = DigitMeshes | SceneMeshes | WrenchMeshes | SolidMeshes

_KINDS: dict[str, tuple[Any, tuple[str, ...]]] = {
    "mnist3d": (DigitMeshes, DIGIT_NAMES),
    "starstruck": (SceneMeshes, STAR_NAMES),
    "wrench": (WrenchMeshes, ("wrench",)),
    "meshes": (SolidMeshes, ()),
}
_COLUMNS = {"star_count": "starstruck", "opening_mm": "wrench", "writer": "mnist3d"}
"""Columns that only one kind has; the published data sets have none of them."""


def kind_of(schema: Any) -> str:
    """Tell the kind of a data set of meshes by its columns, or else by the names of its classes.

    Returns
    -------
    str
        ``"mnist3d"``, ``"starstruck"``, ``"wrench"``, or ``"meshes"`` for anything else.
    """
    for column, kind in _COLUMNS.items():
        if column in schema.names:
            return kind
    known = {DIGIT_NAMES: "mnist3d", STAR_NAMES: "starstruck"}
    return known.get(class_names(schema, ()), "meshes")


def open_meshes(shards: tuple[Shard, ...], name: str, memory: MeshMemory) -> MeshSet:
    """Open shards as the data set that they are.

    Parameters
    ----------
    shards : tuple of Shard
        Of one split.
    name : str
        The data set, in the user's words.
    memory : MeshMemory
        Where its records are kept.

    Raises
    ------
    InputError
        When these are no meshes.
    """
    table = ShardedTable(shards)
    require_mesh_columns(table.schema, name, "mnist3d generate")
    dataset, names = _KINDS[kind_of(table.schema)]
    opened: MeshSet = dataset([table], label_names=class_names(table.schema, names)).with_memory(memory)
    return opened
