"""Runners: tasks in one process, in several, or (:mod:`tactile_toolkit.run.ray`) on many machines.

A task is a small picklable value; running it anywhere, any number of times, writes the same bytes. A
:class:`Runner` therefore only decides where tasks run and repeats those whose worker died.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import islice
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from queue import SimpleQueue
from typing import Any, Protocol, TypeVar

from tactile_toolkit.errors import InputError, ToolkitError
from tactile_toolkit.run.this_process import prepare_batch_process, usable_cores, working_folder

# Each takes about 300 MB of memory.
_MAX_FREE_WORKERS = 16

# Windows waits for at most 63 handles at a time, of which Python needs some.
_MAX_WAITED_FOR = {"win32": 61}

if sys.platform == "win32":
    from multiprocessing.connection import PipeConnection as Connection
else:
    from multiprocessing.connection import Connection
T = TypeVar("T")
R = TypeVar("R")


class Runner(Protocol):
    """Maps a function over tasks.

    A function may have an attribute ``libraries``, the distributions whose versions decide what it returns;
    runners that leave this machine compare them.
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
        for task in tasks:
            # As in a worker: for small matrix products, threads cost more than they save.
            with _thread_pools(len(sys.modules)).limit(limits=1, user_api="blas"):
                result = function(task)
            yield result


@lru_cache(1)
def _thread_pools(_modules: int) -> Any:
    """Find the libraries that start threads; again only after modules were imported, which may bring more."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


# Alternatives (2 cores, Linux): concurrent.futures needs shared memory, loses all workers if one dies, and
# has no public way to stop them; loky 3.7 takes 1.7 s to start two workers.
@dataclass(frozen=True)
class ProcessRunner:
    """Runs tasks in local worker processes.

    If the worker of a task dies (for example, because the system runs out of memory), the task is tried
    again, ``attempts`` times in all. An exception raised by the task itself is not retried.

    Raises
    ------
    InputError
        There are no workers.
    """

    workers: int
    attempts: int = 3

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise InputError(f"the number of workers is {self.workers}; expected at least 1")

    def run(self, function: Callable[[T], R], tasks: Iterable[T]) -> Iterator[R]:
        """Yield results as they finish; ToolkitError when one task's worker died ``attempts`` times."""
        waiting = deque((task, 1) for task in tasks)
        called = pickle.dumps(function)
        is_main_needless = b"__main__" not in called + pickle.dumps(list(islice(waiting, 1)))
        workers: dict[Connection, BaseProcess] = {}  # by our end of the pipe
        held: dict[Connection, tuple[T, int]] = {}  # the task of each worker, and which attempt it is
        answers: list[bytes] = []
        most = _most_workers(self.workers)
        try:
            while True:
                while len(workers) < min(most, len(waiting) + len(held)):
                    pipe, process = _start_worker(called, is_main_needless)
                    workers[pipe] = process
                for pipe in list(islice(workers.keys() - held.keys(), len(waiting))):
                    held[pipe] = waiting.popleft()
                    with contextlib.suppress(OSError):  # it has died; the end of its pipe shows it
                        pipe.send_bytes(pickle.dumps(held[pipe][0]))
                yield from map(unpack_result, answers)  # only now, so that no worker waits for the caller
                if not held:
                    return
                answers = []
                ready: list[Any] = wait(held)
                for pipe in ready:
                    task, attempt = held.pop(pipe)
                    try:
                        answers.append(pipe.recv_bytes())
                    except (EOFError, OSError):
                        workers.pop(pipe).join()
                        if attempt >= self.attempts:
                            raise worker_died(
                                task, attempt, "worker process", "with fewer --workers"
                            ) from None
                        waiting.appendleft((task, attempt + 1))
        finally:
            for process in workers.values():
                process.kill()
            for process in workers.values():
                process.join()


def runner_for(workers: int | Runner) -> Runner:
    """Return a runner as it is, or a runner for a number of workers; 1 means the calling process."""
    if not isinstance(workers, int):
        return workers
    if workers == 1:
        return InlineRunner()
    return ProcessRunner(workers)


def free_workers() -> int:
    """Return the default number of worker processes: one for each core.

    In a worker of another program, which may start none, the number is 1: this process.
    """
    if multiprocessing.current_process().daemon:
        return 1
    return min(usable_cores(), _MAX_FREE_WORKERS)


def _most_workers(workers: int) -> int:
    """Return the number of workers that the system can wait for at a time."""
    return min(workers, _MAX_WAITED_FOR.get(sys.platform, workers))


def _start_worker(function: bytes, is_main_needless: bool) -> tuple[Connection, BaseProcess]:
    """Start a process, and return our end of its pipe, which also closes when either side dies."""
    # spawn: workers inherit no threads or file handles of the caller.
    if multiprocessing.current_process().daemon:
        raise InputError(
            "this process is a worker of another program (daemonic), which may start no processes",
            next="use one worker here (--workers 1), or run it outside of that worker",
        )
    working_folder()  # processes are started in it
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs, function), daemon=True)
    with _without_main_module() if is_main_needless else contextlib.nullcontext():
        process.start()
    theirs.close()  # so that it closes with the worker
    return ours, process


@contextlib.contextmanager
def _without_main_module() -> Iterator[None]:
    """Start workers without running the caller's script again.

    Spawned processes import the main script. Without an ``if __name__ == "__main__"`` guard, or typed into an
    interpreter, it would fail or start the work again in each worker. No task needs the script.
    """
    main = sys.modules["__main__"].__dict__
    hidden: dict[str, object] = {name: main[name] for name in ("__spec__", "__file__") if name in main}
    main.update(dict.fromkeys(hidden))
    try:
        yield
    finally:
        main.update(hidden)


def _work(pipe: Connection, function: bytes) -> None:
    """Run tasks until the parent ends this process."""
    # Ctrl-C reaches the whole process group; only the parent decides what happens to the work.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    inbox: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_listen, args=(pipe, inbox), daemon=True).start()
    with contextlib.suppress(OSError):  # the parent has died
        while True:
            pipe.send_bytes(run_pickled(function, inbox.get()))


def _listen(pipe: Connection, inbox: SimpleQueue[bytes]) -> None:
    # Also during a task: no worker may write into the folder of a parent that was killed.
    with contextlib.suppress(EOFError, OSError):
        while True:
            inbox.put(pipe.recv_bytes())
    os._exit(1)


def run_pickled(function: bytes, task: bytes, dumps: Callable[[Any], bytes] = pickle.dumps) -> bytes:
    """Call a pickled function with a pickled task; return its result or error, packed."""
    try:
        _prepare_worker()
        return dumps((pickle.loads(function)(pickle.loads(task)), None))
    except Exception as error:
        trace = traceback.format_exc()
        for kept in (error, ToolkitError(f"{type(error).__name__}: {error}")):
            with contextlib.suppress(Exception):  # it cannot be pickled
                kept.add_note(trace)
                pickle.loads(packed := dumps((None, kept)))
                return packed
        raise


@cache
def _prepare_worker() -> None:
    """Limit a worker to one core, once for all its tasks."""
    prepare_batch_process()
    # Under Ray, numpy is imported before the variables are set.
    _thread_pools(len(sys.modules)).limit(limits=1, user_api="blas")


def unpack_result(packed: bytes, *notes: str) -> Any:
    """Return the result of the function, or raise its exception, with notes."""
    value, error = pickle.loads(packed)
    if error is None:
        return value
    for note in notes:
        error.add_note(note)
    raise error


def worker_died(task: object, attempts: int, worker: str, again: str) -> ToolkitError:
    """Return the error of a task whose workers always died."""
    return ToolkitError(
        f"the {worker} died {attempts} times while it made {task}; out of memory is the usual cause",
        next=f"run the same command {again} (finished shards are kept)",
    )
