"""The public names: type checkers read this list, and the package imports each on first use."""

from tactile_toolkit.run.parts import Check as Check, Finish as Finish, Part as Part
from tactile_toolkit.run.processes import (
    InlineRunner as InlineRunner,
    ProcessRunner as ProcessRunner,
    Runner as Runner,
)
from tactile_toolkit.run.ray import RayRunner as RayRunner
