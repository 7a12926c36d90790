"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .provider import (
    AssetProvider as AssetProvider,
)
from .mesh_view import (
    HeightMap as HeightMap,
    MeshView as MeshView,
    top_surface as top_surface,
)
from .wrench.dataset import (
    wrench_mesh as wrench_mesh,
    WrenchDataset as WrenchDataset,
    WrenchRecord as WrenchRecord,
    write_wrench as write_wrench,
)
from .wrench.kind import WrenchSpec as WrenchSpec

__version__: str
