"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .opening import (
    loader as loader,
    Name as Name,
    open_place as open_place,
)
from .place import (
    find_repository as find_repository,
    kind_of_published as kind_of_published,
    kind_of_rows as kind_of_rows,
    Place as Place,
    published_set as published_set,
    published_states as published_states,
)
