"""Threads for work that waits for disks and networks; and the setup of processes that use a single thread.

Separate from the runners, because every command imports it and needs no :mod:`multiprocessing`.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from importlib.abc import MetaPathFinder
from types import ModuleType
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


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
    # that the process may use. On macOS it counts all, which nothing can change.
    if sys.platform in ("linux", "win32"):
        with _on_one_processor():
            import manifold3d

            manifold3d.Manifold.cube((1.0, 1.0, 1.0)).status()


@contextlib.contextmanager
def _on_one_processor() -> Iterator[None]:
    """Let this process use the first of its processors only, meanwhile."""
    if sys.platform == "win32":
        import ctypes  # not for every command line

        system = ctypes.WinDLL("kernel32")
        process, allowed, installed = ctypes.c_void_p(-1), ctypes.c_size_t(), ctypes.c_size_t()
        system.GetProcessAffinityMask(process, ctypes.byref(allowed), ctypes.byref(installed))
        bits = allowed.value  # 0 for a process on more than 64 processors
        if bits:
            system.SetProcessAffinityMask(process, ctypes.c_size_t(bits & -bits))
        try:
            yield
        finally:
            if bits:
                system.SetProcessAffinityMask(process, ctypes.c_size_t(bits))
    elif sys.platform == "linux" and hasattr(os, "sched_setaffinity"):
        processors = os.sched_getaffinity(0)
        os.sched_setaffinity(0, {min(processors)})
        try:
            yield
        finally:
            os.sched_setaffinity(0, processors)
    else:
        yield


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
