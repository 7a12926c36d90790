"""The names that other packages use; type checkers read this list, and each name is imported on first use."""

from .cuts import (
    RECORDING_COLUMNS as RECORDING_COLUMNS,
)
from .fields import (
    shown as shown,
)
from .source_touches import (
    FoundTouches as FoundTouches,
    PicturePlace as PicturePlace,
    Recording as Recording,
    TIME_S as TIME_S,
)
from .source_files import (
    FILE_OF_TABLE as FILE_OF_TABLE,
    IMAGE_ENDINGS as IMAGE_ENDINGS,
    NUMBERED as NUMBERED,
    ReadContents as ReadContents,
    SourceTable as SourceTable,
    chosen_pictures as chosen_pictures,
    files_to_read as files_to_read,
    image_files as image_files,
    natural_order as natural_order,
    path_of as path_of,
    pictures_by_file as pictures_by_file,
    problems_of_names as problems_of_names,
    read_table as read_table,
    duplicates_of as duplicates_of,
    require_columns as require_columns,
    source_of as source_of,
    visible_files as visible_files,
)
