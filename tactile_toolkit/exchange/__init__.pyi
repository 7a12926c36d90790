"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .copies import (
    plan_parts as plan_parts,
    plan_tables as plan_tables,
    select_rows as select_rows,
)
from .merging import (
    merge_sets as merge_sets,
)
from .download import (
    DownloadPlan as DownloadPlan,
)
from .upload import (
    Upload as Upload,
)
from .upload_options import (
    UploadOptions as UploadOptions,
)
