"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .card import (
    Card as Card,
    markdown_table as markdown_table,
    PREVIEW_FOLDER as PREVIEW_FOLDER,
    render_card as render_card,
    rewrite_card as rewrite_card,
    with_repo_name as with_repo_name,
)
from .yaml_head import (
    card_head as card_head,
    check_card as check_card,
    configs as configs,
    FolderSummary as FolderSummary,
    viewer_files as viewer_files,
    with_head as with_head,
)
from .owner import (
    LICENCES as LICENCES,
    OwnerWords as OwnerWords,
)
