"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .objects import (
    Failure as Failure,
    PrintObject as PrintObject,
    choose as choose,
    export_files as export_files,
)
from .packing import (
    arrange as arrange,
    measure as measure,
)
from .plates import (
    TABLE_FILE as TABLE_FILE,
    write_plates as write_plates,
)
from .spec import (
    MODELS as MODELS,
    Physics as Physics,
    PlateSpec as PlateSpec,
)
