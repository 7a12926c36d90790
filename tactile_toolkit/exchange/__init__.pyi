"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .copies import (
    divide as divide,
    merge_sets as merge_sets,
    select_rows as select_rows,
    write_part as write_part,
)
from .download import (
    DownloadPlan as DownloadPlan,
    plan_download as plan_download,
    run_download as run_download,
)
from .flat_tables import (
    Choices as Choices,
    plan_tables as plan_tables,
)
from .upload_options import (
    MAIN_BRANCH as MAIN_BRANCH,
    UploadOptions as UploadOptions,
)
from .upload import (
    PreparedUpload as PreparedUpload,
    UploadResult as UploadResult,
    check_folder as check_folder,
    prepare_files as prepare_files,
    prepare_upload as prepare_upload,
    run_upload as run_upload,
)
