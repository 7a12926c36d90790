"""The public names: type checkers read this list, and the package imports each on first use."""

from tactile_toolkit.run.processes import (
    Check as Check,
    Finish as Finish,
    InlineRunner as InlineRunner,
    Part as Part,
    ProcessRunner as ProcessRunner,
    Runner as Runner,
)
from tactile_toolkit.run.ray import RayRunner as RayRunner
