"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .algorithm import (
    literal_solid as literal_solid,
    solid_of_ink as solid_of_ink,
    solid_of_sheet as solid_of_sheet,
    solidify as solidify,
)
from .picture_ink import (
    SizedInk as SizedInk,
    THRESHOLDS as THRESHOLDS,
    sized_ink as sized_ink,
)
