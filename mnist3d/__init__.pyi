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
from .make import DigitMaking as DigitMaking, chosen_source as chosen_source
from .previews import is_picture_or_mesh as is_picture_or_mesh
from .columns import SUMMED_UP as SUMMED_UP
from .card import summarise as summarise

__version__: str
