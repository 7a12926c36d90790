"""Where tasks run: in one process, in several, or (:mod:`tactile_toolkit.run.ray`) on many machines.

A task is a small picklable value; running it anywhere, any number of times, writes the same bytes. A
:class:`Runner` therefore only decides where tasks run and repeats those whose worker died. :class:`Part`,
:class:`Finish` and :class:`Check` stand where a runner stands, so that every function that makes data takes
them; they decide which shards are made and whether the set is finished.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import re
import signal
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import islice
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from queue import SimpleQueue
from typing import Any, Protocol, TypeVar

from tactile_toolkit.errors import InputError, ToolkitError
from tactile_toolkit.run.threads import prepare_batch_process
from tactile_toolkit.system import working_folder

T = TypeVar("T")
R = TypeVar("R")

_PART = re.compile(r"(?:(?P<index>\d{1,9})|auto)(?:/(?P<count>\d{1,9}))?")


class Runner(Protocol):
    """Maps a function over tasks.

    Of a function, runners that leave this machine use an attribute, where it has it: ``libraries``, the
    distributions whose versions decide what it returns.
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
            # As in a worker: small matrix products lose more to threads that wait than they gain.
            with _thread_pools(len(sys.modules)).limit(limits=1, user_api="blas"):
                result = function(task)
            yield result


@lru_cache(1)
def _thread_pools(_modules: int) -> Any:
    """Find the libraries that start threads; again only after further modules brought further libraries."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


# Tried instead (2 cores, Linux): concurrent.futures needs shared memory, loses all workers with the one that
# died, and has no public way to stop them; loky 3.7 takes 1.7 s to start two workers.
@dataclass(frozen=True)
class ProcessRunner:
    """Runs tasks in local worker processes.

    A task is tried ``attempts`` times when its worker dies (killed by the system for want of memory, say)
    before the run gives up. An exception raised by the task itself is never retried.

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
        hide_main = b"__main__" not in called + pickle.dumps(list(islice(waiting, 1)))
        workers: dict[Any, BaseProcess] = {}  # by our ends of their pipes
        held: dict[Any, tuple[T, int]] = {}  # what each of them works on
        answers: list[bytes] = []
        try:
            while True:
                while len(workers) < min(self.workers, len(waiting) + len(held)):
                    pipe, process = _start_worker(called, hide_main)
                    workers[pipe] = process
                for pipe in list(islice(workers.keys() - held.keys(), len(waiting))):
                    held[pipe] = waiting.popleft()
                    with contextlib.suppress(OSError):  # it has died, as the end of its pipe shows
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
    """Return a runner as it is, or that for a number of workers; one means the calling process itself."""
    if not isinstance(workers, int):
        return workers
    return InlineRunner() if workers == 1 else ProcessRunner(workers)


@dataclass(frozen=True)
class Part:
    """Makes every ``count``-th shard from number ``index`` on, and finishes nothing.

    Any number of parts may work at once, on any machines that see the folder; two equal ones make the same.
    When all have ended, :class:`Finish` puts the set together.

    Parameters
    ----------
    index : int
        Which part, from 0; ``count`` means 0 again, so that numbers from 1 do as well.
    count : int
        How many parts there are; parts of other numbers may work at the same set.
    workers : int or Runner
        What makes the shards of this part.

    Raises
    ------
    InputError
        The part does not exist.
    """

    index: int
    count: int
    workers: int | Runner = 1

    def __post_init__(self) -> None:
        if not self.count or not 0 <= self.index <= self.count:
            expected = f"0 to {self.count - 1} (or 1 to {self.count})" if self.count else "at least 1 part"
            raise InputError(
                f"--part {self.index}/{self.count}: there is no part {self.index} of {self.count}; expected "
                f"{expected}; nothing was made",
                next="number the jobs of the array so",
            )

    def of(self, tasks: Sequence[T]) -> Sequence[T]:
        """Return those of all tasks that are of this part."""
        return tasks[self.index % self.count :: self.count]

    def run(self, function: Callable[[T], R], tasks: Iterable[T]) -> Iterator[R]:
        """Yield the results of tasks that were chosen for this part, as its workers finish them."""
        return runner_for(self.workers).run(function, tasks)


@dataclass(frozen=True)
class Finish:
    """Makes nothing: puts together what parts have made, or says what is missing."""

    def run(self, function: Callable[[T], R], tasks: Iterable[T]) -> Iterator[R]:
        """Yield nothing."""
        return iter(())


@dataclass(frozen=True)
class Check:
    """Reads all that is finished again before it continues, and makes again what is damaged.

    Without it runs trust sizes and records.

    Parameters
    ----------
    workers : int or Runner
        What makes the shards: a number of local processes, or a runner, :class:`Part` and :class:`Finish`
        too, which then counts damaged shards among those that are missing.
    """

    workers: int | Runner = 1

    def run(self, function: Callable[[T], R], tasks: Iterable[T]) -> Iterator[R]:
        """Yield the results of tasks as the workers finish them."""
        return runner_for(self.workers).run(function, tasks)


def part_of(text: str, workers: int | Runner = 1, environment: Mapping[str, str] = os.environ) -> Part:
    """Return the part that ``--part`` means: ``K/N``, or what Slurm or Kubernetes call this process.

    ``auto`` takes N from an array that is given whole; for some numbers of one it is to be said, ``auto/N``.
    InputError for anything else.
    """
    match = _PART.fullmatch(text.strip())
    if match is None or (match["index"] and not match["count"]):
        raise InputError(
            f"--part is {text!r}; expected K/N, such as 17/500, with K from 0, or auto, or auto/N"
        )
    index, count = (None if match[name] is None else int(match[name]) for name in ("index", "count"))
    if index is None:
        index, length = _place_in_array(environment)
        count = length if count is None else count
    if count is None:
        found = "neither a whole Slurm array from 0 or 1 on nor JOB_COMPLETION_COUNT"
        raise InputError(f"--part auto: the number of parts is unknown, {found}", next="give --part auto/N")
    return Part(index, count, workers)


def _place_in_array(environment: Mapping[str, str]) -> tuple[int, int | None]:
    """Return the number of this process in its array, and the length of one that was given whole."""
    names = ("ID", "COUNT", "MIN", "MAX")
    index, count, first, last = (_number(environment, f"SLURM_ARRAY_TASK_{name}") for name in names)
    if index is not None:
        is_integer = count is not None and first in (0, 1) and last == first + count - 1
        return index, count if is_integer else None
    index = _number(environment, "JOB_COMPLETION_INDEX")
    if index is None:
        raise InputError(
            "--part auto: neither SLURM_ARRAY_TASK_ID nor JOB_COMPLETION_INDEX is a number in the "
            "environment",
            next="run it in an array of Slurm or an indexed job of Kubernetes, or give K/N",
        )
    return index, _number(environment, "JOB_COMPLETION_COUNT")


def _number(environment: Mapping[str, str], name: str) -> int | None:
    text = environment.get(name, "")
    return int(text) if re.fullmatch("[0-9]{1,9}", text) else None


def _start_worker(function: bytes, hide_main: bool) -> tuple[Any, BaseProcess]:
    """Start a process, and return our end of the pipe that carries its tasks, its answers and its life."""
    # spawn: workers start clean whatever threads and file handles the caller's notebook holds.
    if multiprocessing.current_process().daemon:
        raise InputError(
            "this process is a worker of another program (daemonic), which may start no processes",
            next="use one worker here (--workers 1), or run it outside of that worker",
        )
    working_folder()  # processes are started in it
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs, function), daemon=True)
    with _main_hidden() if hide_main else contextlib.nullcontext():
        process.start()
    theirs.close()  # it ends with the worker only where no other process has it open
    return ours, process


@contextlib.contextmanager
def _main_hidden() -> Iterator[None]:
    """Start workers without running the caller's script again.

    Spawned processes import the main script; one without an ``if __name__ == "__main__"`` guard, or typed
    into an interpreter, would fail or start the work again in each of them. No task needs the script.
    """
    main = sys.modules["__main__"].__dict__
    hidden: dict[str, Any] = {name: main[name] for name in ("__spec__", "__file__") if name in main}
    main.update(dict.fromkeys(hidden))
    try:
        yield
    finally:
        main.update(hidden)


def _work(pipe: Any, function: bytes) -> None:
    """Carry out tasks until the parent ends this process."""
    # Ctrl-C goes to the whole process group: the parent alone decides what happens to the work.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    inbox: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_listen, args=(pipe, inbox), daemon=True).start()
    with contextlib.suppress(OSError):  # a parent that has died takes no answer
        while True:
            pipe.send_bytes(run_pickled(function, inbox.get()))


def _listen(pipe: Any, inbox: SimpleQueue[bytes]) -> None:
    # Also in the middle of a task: no worker may write into the folder of a parent that was killed.
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
        where = traceback.format_exc()
        for kept in (error, ToolkitError(f"{type(error).__name__}: {error}")):
            with contextlib.suppress(Exception):  # one that cannot travel
                kept.add_note(where)
                pickle.loads(packed := dumps((None, kept)))
                return packed
        raise


@cache
def _prepare_worker() -> None:
    """Keep a worker to its one core; once, since it carries out many tasks."""
    prepare_batch_process()
    # In Ray numpy is there before the variables are set.
    _thread_pools(len(sys.modules)).limit(limits=1, user_api="blas")


def unpack_result(packed: bytes, *notes: str) -> Any:
    """Return what the function returned, or raise what it raised, with notes."""
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
