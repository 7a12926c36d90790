"""What environments consume: meshes, touches, volumes and height maps, from files, from the Hub or made here.

``env_assets.AssetProvider`` hands them out, ``env_assets.AssetSource`` is the shape that an environment may
depend on instead, ``env_assets.make`` builds the published environments on them, ``env_assets.top_surface``
turns a mesh into a height map and ``env_assets.write_wrench`` makes the wrench. Names are imported on first
use, so that ``import env_assets`` costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tactile_toolkit.lazy_names import on_first_use

if TYPE_CHECKING:
    from env_assets.mesh_sets import SolidDataset, WrenchDataset, WrenchRecord
    from env_assets.provider import AssetProvider
    from env_assets.published.datasets import as_mesh_dataset, as_touch_dataset
    from env_assets.published.environments import make
    from env_assets.source import AssetSource
    from env_assets.wrench.generation import write_wrench
    from env_assets.wrench.solid import wrench_mesh
    from env_assets.wrench.spec import WrenchSpec
    from tactile_toolkit.mesh.height_map import HeightMap, top_surface

__all__ = [
    "AssetProvider",
    "AssetSource",
    "HeightMap",
    "SolidDataset",
    "WrenchDataset",
    "WrenchRecord",
    "WrenchSpec",
    "as_mesh_dataset",
    "as_touch_dataset",
    "make",
    "top_surface",
    "wrench_mesh",
    "write_wrench",
]

__version__: str

__getattr__, __dir__ = on_first_use(
    __name__,
    {
        "env_assets.published.environments": ("make",),
        "env_assets.mesh_sets": ("SolidDataset", "WrenchDataset", "WrenchRecord"),
        "env_assets.provider": ("AssetProvider",),
        "env_assets.source": ("AssetSource",),
        "env_assets.published.datasets": ("as_mesh_dataset", "as_touch_dataset"),
        "env_assets.wrench.generation": ("write_wrench",),
        "env_assets.wrench.spec": ("WrenchSpec",),
        "env_assets.wrench.solid": ("wrench_mesh",),
        "tactile_toolkit.mesh.height_map": ("HeightMap", "top_surface"),
    },
)
