"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .binarisation import (
    INKS as INKS,
    binarise as binarise,
    cleaned_ink as cleaned_ink,
    ink_levels as ink_levels,
    ink_of_levels as ink_of_levels,
    require_large as require_large,
)
from .cleaning import (
    clean as clean,
    count_bodies_and_holes as count_bodies_and_holes,
)
from .grey_levels import (
    as_levels as as_levels,
    dark_on_light as dark_on_light,
)
from .photographs import (
    even_out as even_out,
    is_clean as is_clean,
)
from .refusals import refuse as refuse
from .sheet import (
    SIDE_PX as SIDE_PX,
    enlarge as enlarge,
    fit as fit,
)
