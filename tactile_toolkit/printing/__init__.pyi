"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .file_export import (
    FileExport as FileExport,
    Made as Made,
    Product as Product,
)
from .print_options import (
    ExportOptions as ExportOptions,
)
from .exports import (
    export as export,
    ExportReport as ExportReport,
    FileJob as FileJob,
    ShowProgress as ShowProgress,
)
