"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .calibration_plate import (
    export_calibration_plate as export_calibration_plate,
    make_plate as make_plate,
)
from .file_export import (
    choose as choose,
    FileExport as FileExport,
    Made as Made,
    PrintObject as PrintObject,
    Product as Product,
)
from .plate_layouts import (
    arrange as arrange,
)
from .print_options import (
    Physics as Physics,
    ExportOptions as ExportOptions,
    PlateSpec as PlateSpec,
)
from .exports import (
    ExportReport as ExportReport,
    export as export,
    export_files as export_files,
    write_plates as write_plates,
)
