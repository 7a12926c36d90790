"""What becomes of a task in a worker, and of its answer where it was given: the same for all runners."""

from __future__ import annotations

import contextlib
import pickle
import traceback
from collections.abc import Callable
from functools import cache
from typing import Any

from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.run.limits import prepare_batch_process

__all__ = ["carry_out", "given_up", "outcome"]


def carry_out(function: bytes, task: bytes, dumps: Callable[[Any], bytes] = pickle.dumps) -> bytes:
    """Call a pickled function with a pickled task; return what it returned or raised, for :func:`outcome`."""
    try:
        _prepare_worker()
        return dumps((pickle.loads(function)(pickle.loads(task)), None))
    except Exception as error:
        where = traceback.format_exc()
        for kept in (error, ToolkitError(f"{type(error).__name__}: {error}")):
            with contextlib.suppress(Exception):  # one that cannot travel
                kept.add_note(where)
                pickle.loads(packed := dumps((None, kept)))
                return packed
        raise


def outcome(packed: bytes, *notes: str) -> Any:
    """Return what the function returned, or raise what it raised, with notes."""
    value, error = pickle.loads(packed)
    if error is not None:
        for note in notes:
            error.add_note(note)
        raise error
    return value


@cache
def _prepare_worker() -> None:
    """Keep a worker to its one core; once, since it carries out many tasks."""
    from threadpoolctl import threadpool_limits

    prepare_batch_process()
    threadpool_limits(limits=1, user_api="blas")  # in Ray numpy is there before the variables are set


def given_up(task: object, attempts: int, worker: str, again: str) -> ToolkitError:
    """Return the error of a task whose workers always died."""
    message = (
        f"the {worker} died {attempts} times while it made {task}; out of memory is the usual cause; next: "
        f"run the same command {again} (finished shards are kept)"
    )
    return ToolkitError(message)
