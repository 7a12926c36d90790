"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .choose import (
    check_rows as check_rows,
    choose_rows as choose_rows,
    open_splits as open_splits,
    shards_to_check as shards_to_check,
    short_name as short_name,
)
from .locate import (
    manifest_beside as manifest_beside,
    refuse_source as refuse_source,
    specification_read as specification_read,
)
from .spec import (
    NO_FILTER as NO_FILTER,
    CONFIG as CONFIG,
    RowFilter as RowFilter,
    IDS as IDS,
    INCOMPLETE as INCOMPLETE,
    IdChoice as IdChoice,
    LABELS as LABELS,
    LIMIT as LIMIT,
    ONE_SPLIT as ONE_SPLIT,
    PER_CLASS as PER_CLASS,
    PreviewSpec as PreviewSpec,
    REVISION as REVISION,
    SPLIT as SPLIT,
    id_range as id_range,
    id_text as id_text,
)
