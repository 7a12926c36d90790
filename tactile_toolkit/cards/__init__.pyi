"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .card import (
    CARD_FILE as CARD_FILE,
    Card as Card,
    Column as Column,
    PREVIEW_FOLDER as PREVIEW_FOLDER,
    between as between,
    bibtex as bibtex,
    card_words as card_words,
    check_card as check_card,
    markdown_table as markdown_table,
    pictures_in as pictures_in,
    rows_to_draw as rows_to_draw,
    tiles_png as tiles_png,
    with_repo_name as with_repo_name,
    write_table_card as write_table_card,
)
from .facts import (
    FolderFacts as FolderFacts,
    card_head as card_head,
    configs as configs,
    folder_facts as folder_facts,
    viewer_files as viewer_files,
    with_head as with_head,
)
from .summary import (
    SplitSummary as SplitSummary,
    facts_table as facts_table,
    summarise_columns as summarise_columns,
)
