"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .provider import (
    AssetProvider as AssetProvider,
    KINDS as KINDS,
    meshes_at as meshes_at,
    SolidDataset as SolidDataset,
    THIRD_PARTY_ASSETS as THIRD_PARTY_ASSETS,
)
from .mesh_view import (
    HeightMap as HeightMap,
    MeshView as MeshView,
    require_fitting_meshes as require_fitting_meshes,
    top_surface as top_surface,
)
from .wrench.dataset import (
    wrench_facts as wrench_facts,
    wrench_mesh as wrench_mesh,
    WrenchDataset as WrenchDataset,
    WrenchRecord as WrenchRecord,
    write_wrench as write_wrench,
)
from .wrench.kind import WrenchSpec as WrenchSpec

__version__: str
