"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .opening import (
    folder_place as folder_place,
    loader as loader,
    MeshLoader as MeshLoader,
    Name as Name,
    open_place as open_place,
    repository_place as repository_place,
)
from .place import (
    hub_states as hub_states,
    kind_of_published as kind_of_published,
    kind_of_rows as kind_of_rows,
    Place as Place,
    published_set as published_set,
    repository_named as repository_named,
    require_kind as require_kind,
)
from .other_files import (
    is_parquet_file as is_parquet_file,
)
from .split_files import (
    splits_by_name as splits_by_name,
    unknown_split as unknown_split,
)
