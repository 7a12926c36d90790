"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .copies import (
    divide as divide,
    merge_sets as merge_sets,
    plan_parts as plan_parts,
    plan_tables as plan_tables,
    select_rows as select_rows,
    write_part as write_part,
)
from .download import (
    DownloadPlan as DownloadPlan,
    plan_download as plan_download,
    run_download as run_download,
)
from .upload import (
    prepare_files as prepare_files,
    prepare_upload as prepare_upload,
    PreparedUpload as PreparedUpload,
    run_upload as run_upload,
    UploadOptions as UploadOptions,
    UploadResult as UploadResult,
)
