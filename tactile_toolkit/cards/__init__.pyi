"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .card import (
    Card as Card,
    PREVIEW_FOLDER as PREVIEW_FOLDER,
    bibtex as bibtex,
    card_words as card_words,
    render_card as render_card,
    draw_solids as draw_solids,
    rows_to_draw as rows_to_draw,
    with_repo_name as with_repo_name,
)
from .card_check import (
    check_card as check_card,
)
from .owner_options import (
    LICENCES as LICENCES,
    OwnerWords as OwnerWords,
)
from .owner_words import (
    state_owner as state_owner,
)
from .table_card import write_table_card as write_table_card
from .yaml_head import (
    CARD_FILE as CARD_FILE,
    card_head as card_head,
    configs as configs,
    with_head as with_head,
)
from .card_tables import (
    ColumnWords as ColumnWords,
    between as between,
    markdown_table as markdown_table,
)
from .folder_facts import (
    FolderSummary as FolderSummary,
    folder_summary as folder_summary,
    viewer_files as viewer_files,
)
from .split_summary import (
    SplitSummary as SplitSummary,
    facts_table as facts_table,
    summarise_columns as summarise_columns,
)
