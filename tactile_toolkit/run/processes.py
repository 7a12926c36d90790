"""Who does the work: one process, several, or (:mod:`tactile_toolkit.run.ray`) many machines.

A task is a small picklable value; running it anywhere, any number of times, writes the same bytes. A
:class:`Runner` therefore only decides where tasks run and repeats those whose worker died.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Protocol, TypeVar

from tactile_toolkit.errors import InputError, ToolkitError
from tactile_toolkit.run.limits import prepare_batch_process
from tactile_toolkit.run.system import ignore_interrupts

__all__ = ["InlineRunner", "ProcessRunner", "Runner", "runner_for"]

T = TypeVar("T")
R = TypeVar("R")


class Runner(Protocol):
    """Maps a function over tasks.

    Of a function, runners that leave this machine use two attributes, where it has them: ``libraries``, the
    distributions whose versions decide what it returns, and ``confirm(result, machine)``, called in this
    process with the first result of each machine, which raises where that machine's work does not arrive.
    """

    def run(self, function: Callable[[T], R], tasks: Iterable[T]) -> Iterator[R]:
        """Yield one result per task, in the order in which they finish.

        Closing the iterator early stops the work that is still under way.
        """
        ...


@dataclass(frozen=True)
class InlineRunner:
    """Runs tasks one after another in the calling process."""

    def run(self, function: Callable[[T], R], tasks: Iterable[T]) -> Iterator[R]:
        """Yield the result of each task in order."""
        from threadpoolctl import threadpool_limits

        for task in tasks:
            # As in a worker: small matrix products lose more to threads that wait than they gain.
            with threadpool_limits(limits=1, user_api="blas"):
                result = function(task)
            yield result


# Tried instead (2 cores, Linux): the executor alone runs a caller's script again in each worker and fails
# where it has no `if __name__ == "__main__"`; loky 3.7 does not, but takes 1.7 s to start two workers, where
# these take 0.65 s. With both, workers outlive a parent that was killed and go on writing into its folder,
# and a task whose worker died is lost.
@dataclass(frozen=True)
class ProcessRunner:
    """Runs tasks in local worker processes.

    A task is tried ``attempts`` times when its worker dies (killed by the system for want of memory, say)
    before the run gives up. An exception raised by the task itself is never retried.
    """

    workers: int
    attempts: int = 3

    def run(self, function: Callable[[T], R], tasks: Iterable[T]) -> Iterator[R]:
        """Yield results as they finish; ToolkitError when one task's worker died ``attempts`` times."""
        waiting = deque((task, 1) for task in tasks)
        while waiting:
            yield from self._run_pool(function, waiting)

    def _run_pool(self, function: Callable[[T], R], waiting: deque[tuple[T, int]]) -> Iterator[R]:
        """Work in one pool until nothing waits or a worker died; then the lost tasks wait again."""
        # spawn: workers start clean whatever threads and file handles the caller's notebook holds.
        context = multiprocessing.get_context("spawn")
        try:
            pool = ProcessPoolExecutor(
                min(self.workers, len(waiting)), mp_context=context, initializer=_prepare_worker
            )
        except OSError as error:
            message = (
                f"worker processes need shared memory (on Linux in /dev/shm), which is refused: {error}; "
                "next: make it writable, or run the same command with --workers 1"
            )
            raise InputError(message) from error
        needs_main = b"__main__" in pickle.dumps((function, waiting[0][0]))
        start_context = contextlib.nullcontext if needs_main else _main_hidden
        running: dict[Future[R], tuple[T, int]] = {}
        finished = False
        try:
            while waiting or running:
                # Only what the workers hold is submitted, so that a dead worker costs few attempts.
                while waiting and len(running) < self.workers:
                    # Waits until it is submitted: a pool that broke in the meantime takes no task.
                    with start_context():
                        running[pool.submit(function, waiting[0][0])] = waiting[0]
                    waiting.popleft()
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    result = future.result()
                    del running[future]
                    yield result
            finished = True
        except BrokenProcessPool:
            # All workers of a pool go with the one that died: nobody knows whose task it was.
            for task, attempt in running.values():
                if attempt >= self.attempts:
                    message = (
                        f"the worker process died {attempt} times while it made {task}; out of memory is the "
                        "usual cause; next: run the same command with fewer --workers (finished shards are "
                        "kept)"
                    )
                    raise ToolkitError(message) from None
                waiting.appendleft((task, attempt + 1))
        finally:
            processes = [] if finished else list((pool._processes or {}).values())
            pool.shutdown(wait=finished, cancel_futures=True)
            for process in processes:
                process.kill()
            for process in processes:
                process.join()


def runner_for(workers: int | Runner) -> Runner:
    """Return a runner as it is, or that for a number of workers; one means the calling process itself."""
    if not isinstance(workers, int):
        return workers
    return InlineRunner() if workers == 1 else ProcessRunner(workers)


@contextlib.contextmanager
def _main_hidden() -> Iterator[None]:
    """Start workers without running the caller's script again.

    Spawned processes import the main script; one without an ``if __name__ == "__main__"`` guard, or typed
    into an interpreter, would fail or start the work anew in each of them. Nothing of ours lives there.
    """
    main = sys.modules["__main__"]
    hidden = {name: vars(main)[name] for name in ("__spec__", "__file__") if name in vars(main)}
    for name in hidden:
        setattr(main, name, None)
    try:
        yield
    finally:
        for name, value in hidden.items():
            setattr(main, name, value)


def _prepare_worker() -> None:
    # Ctrl-C goes to the whole process group: the parent alone decides what happens to the work.
    ignore_interrupts()
    prepare_batch_process()
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_exit_with, args=(parent,), daemon=True).start()


def _exit_with(parent: multiprocessing.process.BaseProcess) -> None:
    # A parent killed with SIGKILL cannot tell its workers; they must not go on writing into its folder.
    parent.join()
    os._exit(1)
