"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .binarisation import (
    binarise as binarise,
    clean as clean,
    cleaned_ink as cleaned_ink,
    count_bodies_and_holes as count_bodies_and_holes,
    ink_levels as ink_levels,
    ink_of_levels as ink_of_levels,
    INKS as INKS,
    require_large as require_large,
)
from .grey_levels import (
    as_levels as as_levels,
    dark_on_light as dark_on_light,
    enlarge as enlarge,
    fit as fit,
    refuse as refuse,
    SIDE_PX as SIDE_PX,
)
from .photographs import (
    even_out as even_out,
    is_clean as is_clean,
)
