"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .card import (
    Card as Card,
    markdown_table as markdown_table,
    render_card as render_card,
    rewrite_card as rewrite_card,
)
from .yaml_head import (
    check_card as check_card,
    FolderSummary as FolderSummary,
)
from .owner import (
    OwnerWords as OwnerWords,
)
