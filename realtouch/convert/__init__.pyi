"""The names that other packages use; type checkers read this list, and each name is imported on first use."""

from .conversion import (
    checksums as checksums,
    Choices as Choices,
    Conversion as Conversion,
    files_of as files_of,
    first_rows as first_rows,
    JobOptions as JobOptions,
    Made as Made,
    marked_repetitions as marked_repetitions,
    parts_of as parts_of,
    RowChoice as RowChoice,
    schema_of as schema_of,
    Source as Source,
    table_of_columns as table_of_columns,
    with_files as with_files,
    write_changed as write_changed,
    write_conversion as write_conversion,
    WriteFiles as WriteFiles,
)
from .picture_files import (
    columns_of_touches as columns_of_touches,
    files_of_tar as files_of_tar,
    id_of_stem as id_of_stem,
    plain_extras as plain_extras,
    shown_touches as shown_touches,
    stem_of_id as stem_of_id,
)
