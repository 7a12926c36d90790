"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .digit_card import summarise as summarise
from .digit_records import (
    DigitDataset as DigitDataset,
    DigitRecord as DigitRecord,
    DigitStream as DigitStream,
    load as load,
    SUMMED_UP as SUMMED_UP,
)
from .digit_generation import (
    chosen_source as chosen_source,
    DigitGenerator as DigitGenerator,
    DigitSetSpec as DigitSetSpec,
    generate as generate,
)
from .digit_previews import is_picture_or_mesh as is_picture_or_mesh
from .picture_prints import (
    PrintSpec as PrintSpec,
    PrintedPicture as PrintedPicture,
    print_pictures as print_pictures,
)
from .digit_checks import (
    Mesh as Mesh,
    PrintProfile as PrintProfile,
    PrintReport as PrintReport,
    inspect as inspect,
    read_mesh as read_mesh,
    write_mesh as write_mesh,
)
from .sources.digit_source import plan_splits as plan_splits
from .solid import solidify as solidify
from .digit_options import (
    SPLITS as SPLITS,
    SolidSpec as SolidSpec,
    SplitSpec as SplitSpec,
)
from .sources import (
    DigitCatalog as DigitCatalog,
    DigitImage as DigitImage,
    DigitSource as DigitSource,
)

__version__: str
