"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .digit_records import (
    DigitDataset as DigitDataset,
    DigitRecord as DigitRecord,
    load as load,
)
from .digit_generation import (
    DigitGenerator as DigitGenerator,
    DigitSetSpec as DigitSetSpec,
    generate as generate,
)
from .picture_prints import (
    PrintSpec as PrintSpec,
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
from .solid.algorithm import solidify as solidify
from .digit_options import (
    SolidSpec as SolidSpec,
    SplitSpec as SplitSpec,
)

__version__: str
