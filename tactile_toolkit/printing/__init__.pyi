"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .calibration_plate import (
    export_calibration_plate as export_calibration_plate,
    make_plate as make_plate,
)
from .file_export import (
    choose as choose,
    FailedExport as FailedExport,
    FileExport as FileExport,
    Made as Made,
    place_on_plate as place_on_plate,
    PrintObject as PrintObject,
    Product as Product,
    require_same_solid as require_same_solid,
    write_products as write_products,
)
from .plate_layouts import (
    arrange as arrange,
)
from .print_options import (
    MODELS as MODELS,
    Physics as Physics,
    PlateSpec as PlateSpec,
)
from .exports import (
    export_files as export_files,
    write_plates as write_plates,
)
