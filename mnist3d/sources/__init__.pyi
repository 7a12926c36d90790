"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .digit_source import (
    DigitCatalog as DigitCatalog,
    DigitImage as DigitImage,
    DigitSource as DigitSource,
)
from .digit_arrays import (
    HwdPlusSource as HwdPlusSource,
    MnistSource as MnistSource,
)
from .digit_tables import TableSource as TableSource
from .picture_folder import FolderSource as FolderSource
from .synthetic import SyntheticSource as SyntheticSource
