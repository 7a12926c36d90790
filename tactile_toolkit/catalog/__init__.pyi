"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .row_options import (
    id_range as id_range,
    IdChoice as IdChoice,
    LIMIT as LIMIT,
    PER_CLASS as PER_CLASS,
    PreviewSpec as PreviewSpec,
    RowFilter as RowFilter,
    SPLIT as SPLIT,
)
from .rows import (
    check_rows as check_rows,
    choose_rows as choose_rows,
    manifest_beside as manifest_beside,
    open_splits as open_splits,
    shards_to_check as shards_to_check,
    specification_read as specification_read,
)
