"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .processes import (
    Check as Check,
    Finish as Finish,
    InlineRunner as InlineRunner,
    Part as Part,
    ProcessRunner as ProcessRunner,
    Runner as Runner,
    part_of as part_of,
    runner_for as runner_for,
)
from .ray import (
    RayRunner as RayRunner,
)
from .threads import (
    in_threads as in_threads,
    limit_threads as limit_threads,
    prepare_batch_process as prepare_batch_process,
    skip_pandas as skip_pandas,
)
