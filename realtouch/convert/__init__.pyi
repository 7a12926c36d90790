"""The names that other packages use; type checkers read this list, and each name is imported on first use."""

from .conversion import (
    Choices as Choices,
    Conversion as Conversion,
    Made as Made,
    RowChoice as RowChoice,
    Source as Source,
    WriteFiles as WriteFiles,
    checksums as checksums,
    files_of as files_of,
    first_rows as first_rows,
    marked_repetitions as marked_repetitions,
    parts_of as parts_of,
    schema_of as schema_of,
    table_of_columns as table_of_columns,
    with_files as with_files,
    write_changed as write_changed,
)
from .shard_tasks import (
    JobOptions as JobOptions,
    write_conversion as write_conversion,
)
from .touch_pictures import (
    columns_of_touches as columns_of_touches,
    plain_extras as plain_extras,
    shown_touches as shown_touches,
)
from .file_stems import id_of_stem as id_of_stem, stem_of_id as stem_of_id
