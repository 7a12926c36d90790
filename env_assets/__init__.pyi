"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .provider import SolidDataset as SolidDataset
from .provider import inventory as inventory, AssetProvider as AssetProvider, AssetSource as AssetSource
from .published.datasets import (
    as_mesh_dataset as as_mesh_dataset,
    as_touch_dataset as as_touch_dataset,
)
from .published.environments import make as make
from .wrench.making import wrench_facts as wrench_facts, write_wrench as write_wrench
from .wrench.solid import wrench_mesh as wrench_mesh
from .wrench.spec import WrenchSpec as WrenchSpec
from .wrenches import WrenchDataset as WrenchDataset, WrenchRecord as WrenchRecord
from .height_map import HeightMap as HeightMap, top_surface as top_surface
from .published.packages import overview as overview

__version__: str
