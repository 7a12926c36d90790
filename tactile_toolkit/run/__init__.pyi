"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .runners import (
    Runner as Runner,
    runner_for as runner_for,
)
from .this_process import (
    in_threads as in_threads,
    one_blas_thread as one_blas_thread,
    Part as Part,
    prepare_batch_process as prepare_batch_process,
    prepare_command as prepare_command,
    QUIET_VARIABLE as QUIET_VARIABLE,
    shown_progress as shown_progress,
    skip_pandas as skip_pandas,
    usable_cores as usable_cores,
)
from .runners import (
    RayRunner as RayRunner,
)
