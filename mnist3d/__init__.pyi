"""The public names: type checkers read this list, and the package imports each on first use."""

from mnist3d.loader import (
    MeshDataset as MeshDataset,
    MeshRecord as MeshRecord,
    MeshStream as MeshStream,
    load as load,
)
from mnist3d.make import GenerateSpec as GenerateSpec, generate as generate
from mnist3d.solid import solidify as solidify
from mnist3d.sources import DigitCatalog as DigitCatalog, DigitImage as DigitImage, DigitSource as DigitSource
from mnist3d.spec import SPLITS as SPLITS, SolidSpec as SolidSpec, SplitSpec as SplitSpec
from mnist3d.splits import plan_splits as plan_splits
from tactile_toolkit.mesh.files import read_mesh as read_mesh, write_mesh as write_mesh
from tactile_toolkit.mesh.mesh import Mesh as Mesh
from tactile_toolkit.mesh.printability import (
    PrintProfile as PrintProfile,
    PrintReport as PrintReport,
    inspect as inspect,
)

__version__: str
