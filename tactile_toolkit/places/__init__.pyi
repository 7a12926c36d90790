"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .opening import (
    loader as loader,
    Name as Name,
    open_place as open_place,
)
from .place import (
    Place as Place,
    published_sets as published_sets,
)
