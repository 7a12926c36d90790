"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .card import (
    Card as Card,
    markdown_table as markdown_table,
    rewrite_card as rewrite_card,
)
from .licences import (
    inherited_options as inherited_options,
    licence_of as licence_of,
    LICENCE as LICENCE,
    source_column as source_column,
    SOURCE_ID as SOURCE_ID,
    SOURCE_NAMES as SOURCE_NAMES,
)
from .yaml_head import (
    FolderSummary as FolderSummary,
    verify as verify,
)
from .owner import (
    OwnerWords as OwnerWords,
)
