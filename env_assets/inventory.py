"""What a provider's folder holds, as its environments would find it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from env_assets.mesh_sets import open_meshes
from env_assets.mesh_view import MeshView
from tactile_toolkit.cache import MemoryCache
from tactile_toolkit.catalog.kinds import kind_of_meshes
from tactile_toolkit.catalog.locate import find_shards, splits_of
from tactile_toolkit.errors import InputError, ToolkitError
from tactile_toolkit.mesh.mesh import MM_PER_M
from tactile_toolkit.read.parquet import ShardedTable
from tactile_toolkit.store.folder import DataFolder


@dataclass(frozen=True, slots=True)
class AssetSummary:
    """One split of one data set of a provider's folder.

    ``kind`` is ``"mnist3d"``, ``"starstruck"``, ``"wrench"``, ``"meshes"``, ``"touches"``, or ``""`` where
    unknown; ``rows`` are meshes, or rounds of touches; ``largest_mm`` the largest extents of a mesh along x,
    y and z, ``volume_mm3`` the least and greatest volume; ``problem`` says why it cannot be used.
    """

    name: str
    split: str
    kind: str = ""
    rows: int = 0
    classes: tuple[str, ...] = ()
    largest_mm: tuple[float, ...] | None = None
    volume_mm3: tuple[float, ...] | None = None
    problem: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


def inventory(root: Path) -> list[AssetSummary]:
    """Look into every data set folder of a provider's folder, reading the vertices of all meshes.

    By name, splits in the order of the data set; one that cannot be used is named with the reason. InputError
    when there is no such folder.
    """
    if not root.is_dir():
        raise InputError(
            f"{DataFolder(str(root)).lacks('data sets')}", next="give the folder of an AssetProvider"
        )
    places = sorted(place for place in root.iterdir() if place.is_dir() and not place.name.startswith("."))
    return [summary for place in places for summary in _summaries(place)]


def _summaries(place: Path) -> list[AssetSummary]:
    try:
        splits = splits_of(str(place))
    except InputError:  # some other folder: there are no Parquet files in it
        return []
    except ToolkitError as error:
        return [AssetSummary(place.name, "", problem=str(error))]
    return [_summary(place, split) for split in splits]


def _summary(place: Path, split: str) -> AssetSummary:
    try:
        shards = find_shards(str(place), split)
        schema = ShardedTable(shards).schema
        # Only touches have the column; they are not opened, as no mesh is to be measured.
        if "pos_in_cell" in schema.names:
            return AssetSummary(place.name, split, "touches", sum(len(shard) for shard in shards))
        # Nothing is kept: every mesh is measured once.
        meshes = open_meshes(shards, place.name, MemoryCache(0))
        kind = kind_of_meshes(schema)
        name = "meshes" if kind is None else kind.name
        if not len(meshes):
            return AssetSummary(place.name, split, name, 0, meshes.label_names)
        view = MeshView(meshes, meshes.label_names)
        corners_mm, volumes_mm3 = view.bounds_m * MM_PER_M, view.volumes_m3 * MM_PER_M**3
    except ToolkitError as error:
        return AssetSummary(place.name, split, problem=str(error))
    largest_mm = tuple(np.max(corners_mm[:, 1] - corners_mm[:, 0], axis=0).round(3).tolist())
    volume_mm3 = (round(float(volumes_mm3.min()), 3), round(float(volumes_mm3.max()), 3))
    return AssetSummary(place.name, split, name, len(meshes), meshes.label_names, largest_mm, volume_mm3)
