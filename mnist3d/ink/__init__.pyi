"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .binarisation import binarise as binarise
from .cleaning import (
    clean as clean,
    count_bodies_and_holes as count_bodies_and_holes,
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
