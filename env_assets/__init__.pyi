"""The public names: type checkers read this list, and the package imports each on first use."""

from tactile_toolkit.mesh.records import SolidDataset as SolidDataset
from env_assets.provider import AssetProvider as AssetProvider, AssetSource as AssetSource
from env_assets.published.datasets import (
    as_mesh_dataset as as_mesh_dataset,
    as_touch_dataset as as_touch_dataset,
)
from env_assets.published.environments import make as make
from env_assets.wrench.making import write_wrench as write_wrench
from env_assets.wrench.solid import wrench_mesh as wrench_mesh
from env_assets.wrench.spec import WrenchSpec as WrenchSpec
from env_assets.wrenches import WrenchDataset as WrenchDataset, WrenchRecord as WrenchRecord
from env_assets.height_map import HeightMap as HeightMap, top_surface as top_surface

__version__: str
