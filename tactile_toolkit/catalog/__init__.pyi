"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .ids import (
    IdChoice as IdChoice,
    id_range as id_range,
    id_text as id_text,
)
from .row_checks import (
    check_rows as check_rows,
    shards_to_check as shards_to_check,
)
from .row_choice import (
    choose_rows as choose_rows,
    open_splits as open_splits,
)
from .row_filter import (
    CONFIG as CONFIG,
    IDS as IDS,
    INCOMPLETE as INCOMPLETE,
    LABELS as LABELS,
    LIMIT as LIMIT,
    NO_FILTER as NO_FILTER,
    ONE_SPLIT as ONE_SPLIT,
    PER_CLASS as PER_CLASS,
    PreviewSpec as PreviewSpec,
    REVISION as REVISION,
    RowFilter as RowFilter,
    SPLIT as SPLIT,
)
from .source_files import (
    manifest_beside as manifest_beside,
    refuse_source as refuse_source,
    short_name as short_name,
    specification_read as specification_read,
)
