"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .hub_place import (
    repository_place as repository_place,
)
from .kinds_of_rows import (
    kind_of_rows as kind_of_rows,
    require_kind as require_kind,
)
from .loading import (
    MeshLoader as MeshLoader,
    loader as loader,
)
from .opening import (
    Name as Name,
    folder_place as folder_place,
    open_place as open_place,
)
from .other_files import (
    is_parquet_file as is_parquet_file,
)
from .place import (
    Place as Place,
)
from .published import (
    hub_states as hub_states,
    kind_of_published as kind_of_published,
    published_set as published_set,
    repository_named as repository_named,
)
from .split_files import (
    splits_by_name as splits_by_name,
    unknown_split as unknown_split,
)
