"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .background import (
    start_background as start_background,
)
from .parts import (
    Part as Part,
    parse_part as parse_part,
)
from .processes import (
    InlineRunner as InlineRunner,
    ProcessRunner as ProcessRunner,
    Runner as Runner,
    free_workers as free_workers,
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
