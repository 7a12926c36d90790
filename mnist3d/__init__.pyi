"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .loader import (
    MeshDataset as MeshDataset,
    MeshRecord as MeshRecord,
    MeshStream as MeshStream,
    load as load,
)
from .make import GenerateSpec as GenerateSpec, generate as generate
from .solid import solidify as solidify
from .sources import DigitCatalog as DigitCatalog, DigitImage as DigitImage, DigitSource as DigitSource
from .spec import SPLITS as SPLITS, SolidSpec as SolidSpec, SplitSpec as SplitSpec
from .splits import plan_splits as plan_splits
from .printable import (
    Mesh as Mesh,
    PrintProfile as PrintProfile,
    PrintReport as PrintReport,
    inspect as inspect,
    read_mesh as read_mesh,
    write_mesh as write_mesh,
)

__version__: str
