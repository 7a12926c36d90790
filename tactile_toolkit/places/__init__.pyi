"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .layout import (
    splits_by_name as splits_by_name,
    unknown_split as unknown_split,
)
from .other_files import (
    is_parquet_file as is_parquet_file,
)
from .place import (
    Name as Name,
    Place as Place,
    folder_place as folder_place,
    kind_of_rows as kind_of_rows,
    open_place as open_place,
    repository_place as repository_place,
    require_kind as require_kind,
)
from .published import (
    hub_states as hub_states,
    kind_of_published as kind_of_published,
    published_set as published_set,
    repository_named as repository_named,
)
