"""Opening data sets of wrenches, as the packages of other kinds open theirs."""

from __future__ import annotations

from env_assets.mesh_sets import WrenchMeshes
from env_assets.provider import AssetProvider


def load(name: str, split: str = "train") -> WrenchMeshes:
    """Open a folder, a Parquet file or a repository of the Hub; raises as ``AssetProvider.meshes``."""
    return AssetProvider(places={"wrench": name}).meshes("wrench", split)
