"""The own process: part of an array of jobs, threads, memory, cores, working folder, and progress on stderr.

Separate from the runners, because every command imports it and needs no :mod:`multiprocessing`. Progress is a
bar on a terminal, and a line every few seconds elsewhere.
"""

from __future__ import annotations

import math
import os
import re
import shutil
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.abc import MetaPathFinder
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from tactile_toolkit import wording
from tactile_toolkit.errors import InputError

QUIET_VARIABLE = "TACTILE_TOOLKIT_QUIET"
"""If set, this process and its workers print no notes; set by ``--quiet``."""

T = TypeVar("T")
R = TypeVar("R")
_PART = re.compile(r"(?:(?P<index>\d{1,9})|auto)(?:/(?P<count>\d{1,9}))?")
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
# Without a terminal, each line is kept: a job of one day writes about 17,000 of them, 1 MB of log.
_LINE_INTERVAL_S = 5.0
_SILENT_S = 60.0  # a step may take minutes, and a log without a line looks like a hang
_FIRST_S = 1.0
_BAR_INTERVAL_S = 0.1
_BAR = 24


@dataclass(frozen=True)
class Part:
    """Every ``count``-th shard from number ``index`` on.

    Any number of parts may run at once, on any machines that share the folder; two runs of the same part
    write the same files. When all parts have ended, a run with ``finish`` completes the data set.

    Parameters
    ----------
    index : int
        Which part, from 0; ``count`` means 0 again, so numbers from 1 work too.
    count : int
        Number of parts; other parts of the same data set may have another count.

    Raises
    ------
    InputError
        The part does not exist.
    """

    index: int
    count: int

    def __post_init__(self) -> None:
        if self.count and 0 <= self.index <= self.count:
            return
        expected = "at least 1 part"
        if self.count:
            expected = f"0 to {self.count - 1} (or 1 to {self.count})"
        raise InputError(
            f"{self.index}/{self.count}: there is no part {self.index} of {self.count}; expected "
            f"{expected}; nothing was made",
            next="number the jobs of the array in this range",
            field="part",
        )

    def of(self, tasks: Sequence[T]) -> Sequence[T]:
        """Return the tasks of this part."""
        return tasks[self.index % self.count :: self.count]

    @classmethod
    def parse(cls, text: str, environment: Mapping[str, str] = os.environ) -> Part:
        """Read ``--part``: ``K/N``, or ``auto`` for the number that Slurm or Kubernetes give to this process.

        ``auto`` takes N from an array that was submitted whole; for a part of an array, give ``auto/N``.
        Raises InputError for anything else.
        """
        match = _PART.fullmatch(text.strip())
        if match is None or (match["index"] and not match["count"]):
            raise InputError(
                f"is {text!r}; expected K/N, such as 17/500, with K from 0, or auto, or auto/N", field="part"
            )
        index, count = (None if match[name] is None else int(match[name]) for name in ("index", "count"))
        if index is None:
            index, length = _place_in_array(environment)
            if count is None:
                count = length
        if count is None:
            problem = "neither a whole Slurm array from 0 or 1 on nor JOB_COMPLETION_COUNT"
            raise InputError(
                f"auto: the number of parts is unknown, {problem}", next="give --part auto/N", field="part"
            )
        return cls(index, count)


def _place_in_array(environment: Mapping[str, str]) -> tuple[int, int | None]:
    """Return the number of this process in its array, and the length of an array that was submitted whole."""
    names = ("ID", "COUNT", "MIN", "MAX")
    index, count, first, last = (_number(environment, f"SLURM_ARRAY_TASK_{name}") for name in names)
    if index is not None:
        is_whole = count is not None and first in (0, 1) and last == first + count - 1
        return index, count if is_whole else None
    index = _number(environment, "JOB_COMPLETION_INDEX")
    if index is None:
        raise InputError(
            "auto: neither SLURM_ARRAY_TASK_ID nor JOB_COMPLETION_INDEX is a number in the environment",
            next="run it in an array of Slurm or an indexed job of Kubernetes, or give K/N",
            field="part",
        )
    return index, _number(environment, "JOB_COMPLETION_COUNT")


def _number(environment: Mapping[str, str], name: str) -> int | None:
    text = environment.get(name, "")
    return int(text) if re.fullmatch("[0-9]{1,9}", text) else None


def in_threads(function: Callable[[T], R], items: Iterable[T], workers: int) -> Iterator[R]:
    """Yield the result of a function for each item, in order; one worker is the calling thread itself.

    Items are taken as needed, in the calling thread. An exception ends the work.
    """
    if workers == 1:
        yield from map(function, items)
        return
    waiting: deque[Future[R]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        try:
            for item in items:
                waiting.append(pool.submit(function, item))
                if len(waiting) > 2 * workers:  # so that results do not pile up
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def prepare_batch_process() -> None:
    """Set up a process that runs tasks and then ends: one thread of work, a quick start."""
    limit_threads()
    keep_memory()
    skip_pandas()


def limit_threads() -> None:
    """Limit this process, and those that it starts, to one thread of work.

    Work is spread over processes, in which further threads only wait for one another. On two cores, checking
    a mesh takes 13.4 ms of processor time with one thread and 17.8 ms with those of manifold3d.
    """
    for name in _THREAD_VARIABLES:
        os.environ.setdefault(name, "1")
    # oneTBB, which manifold3d uses, has no setting for this: when it first works, it counts the processors
    # that the process may use. Linux lets a process choose them, if Python was built with the call.
    if sys.platform == "linux" and hasattr(os, "sched_setaffinity"):
        processors = os.sched_getaffinity(0)
        os.sched_setaffinity(0, {min(processors)})
        try:
            import manifold3d

            manifold3d.Manifold.cube((1.0, 1.0, 1.0)).status()
        finally:
            os.sched_setaffinity(0, processors)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit linear algebra to one thread: on small matrices, threads mostly wait for one another.

    A context manager, and by ``@one_blas_thread()`` a decorator.
    """
    with _thread_pools(len(sys.modules)).limit(limits=1, user_api="blas"):
        yield


@lru_cache(1)
def _thread_pools(_modules: int) -> Any:
    """Find the libraries that start threads; again only after modules were imported, which may bring more."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def keep_memory() -> None:
    """Keep freed memory of up to 64 MB in this process, where the C library is glibc.

    Otherwise the pages of arrays return to the system after each item and are cleared again for the next:
    500 of them take 4 % of the time of a digit. The peak of memory use stays the same.
    """
    import ctypes  # not for every command line

    set_option = getattr(ctypes.CDLL(None), "mallopt", None) if os.name == "posix" else None
    if set_option is not None:
        trim_threshold, mmap_threshold = -1, -3  # malloc.h
        set_option(trim_threshold, 64 << 20)
        set_option(mmap_threshold, 32 << 20)


def prepare_command(*, quiet: bool) -> None:
    """Set up a process that runs one command; with ``quiet``, it and its workers print no notes."""
    if quiet:
        os.environ[QUIET_VARIABLE] = "1"
    skip_pandas()


def skip_pandas() -> None:
    """Keep pyarrow from importing pandas, which it does at its first array to recognise a Series.

    The import takes 0.9 s and 60 MB in every process. Only for processes that end with their work: afterwards
    pyarrow does not see pandas, unless it was imported before.
    """
    if "pandas" in sys.modules:
        return
    import pyarrow as pa

    # pyarrow looks once, and has no setting for it: it finds nothing here.
    finder = _NoPandas()
    sys.meta_path.insert(0, finder)
    try:
        pa.array([0])
    finally:
        sys.meta_path.remove(finder)


class _NoPandas(MetaPathFinder):
    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> None:
        if name == "pandas":
            raise ModuleNotFoundError("pandas is hidden in this process", name=name)


def usable_cores() -> int:
    """Return the number of processor cores that this process may use.

    A scheduler, a container or `taskset` may allow fewer cores than the machine has.
    """
    count = os.cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        return min(count, len(os.sched_getaffinity(0)))
    return count


def working_folder() -> Path:
    """Return the working folder; InputError if it was deleted."""
    try:
        return Path.cwd()
    except FileNotFoundError as error:
        raise InputError("the working folder was deleted", next="change to a folder that exists") from error


@contextmanager
def shown_progress(what: str, unit: str, quiet_s: float = 0.0) -> Iterator[Callable[[int, int], None]]:
    """Show the progress of some work, and nothing if it ends within ``quiet_s`` seconds.

    While no item is finished, a line a minute says that it is at work; at a terminal, each second until the
    first item.

    Yields
    ------
    callable
        Takes the number of finished items and the total number.
    """
    start_s = time.monotonic()
    last_s = None
    is_bar = sys.stderr.isatty()
    interval_s = _BAR_INTERVAL_S if is_bar else _LINE_INTERVAL_S

    written_s = start_s

    def show(state: str, bar: str = "") -> None:
        nonlocal written_s
        written_s = time.monotonic()
        if is_bar:
            columns = shutil.get_terminal_size().columns
            sys.stderr.write(f"\r{f'{bar}{state}'[: columns - 1]}\x1b[K")
        else:
            sys.stderr.write(f"{state}\n")
        sys.stderr.flush()

    def update(done: int, total: int) -> None:
        nonlocal last_s
        now_s = time.monotonic()
        is_due = now_s - (last_s or start_s) >= interval_s
        # The last update is always shown: a log that ends at 80 % looks like interrupted work.
        if not done or (done < total and not is_due) or now_s - start_s < quiet_s:
            return
        last_s = now_s
        state = wording.printable(f"{what}: {_state(done, total, unit, now_s - start_s)}")
        show(state, f"{'━' * (_BAR * done // total):<{_BAR}} ")

    def report_life() -> None:
        while not ended.wait(_FIRST_S):
            silent_s = max(_FIRST_S, quiet_s) if is_bar and last_s is None else _SILENT_S
            if time.monotonic() - written_s >= silent_s:
                show(f"{what}: at work for {wording.duration_text(time.monotonic() - start_s)}")

    ended = threading.Event()
    reporter = threading.Thread(target=report_life, daemon=True)
    if quiet_s < math.inf:
        reporter.start()
    try:
        yield update
    finally:
        ended.set()
        if is_bar and written_s > start_s:
            sys.stderr.write("\n")


def _state(done: int, total: int, unit: str, elapsed_s: float) -> str:
    """Return the progress as text: counts, the mean rate, and the time left."""
    # Shards come in bursts: the rate of the last seconds would jump.
    amount: Callable[[int], str] = "{:,}".format
    if unit == wording.BYTES:
        amount = wording.bytes_text
    left = wording.duration_text(elapsed_s / done * (total - done))
    return f"{amount(done)} of {amount(total)}, {wording.rate_text(done, elapsed_s, unit)}, {left} left"
