"""Functions compiled by numba, which takes half a second to import: import kernels where they are called.

Without fastmath each operation is an IEEE one, in the order in which it is written: values do not depend on
the processor. By itself numba checks only the file of a kernel, and misses a change of a kernel in another
file that was compiled into it. The locators here check the files of both. Users who cannot write where an
administrator has compiled copy the code from there.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, overload

import numba
from numba import extending
from numba.core import caching, event, sigutils
from numba.core.compiler_lock import global_compiler_lock

from tactile_toolkit import cache, errors, run, store

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")

# Settings of this package affect the compiled code, its imports do not.
_COMPILER = "tactile_toolkit.kernels"

# nogil: threads may work side by side. numpy's error model: a division by 0 is an infinity, not an exception
# that every loop has to check. No wrapper for C, which would be unused: it takes a tenth of the time.
_SETTINGS = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_TELL_AFTER_S = 1.0
_with_types: dict[str, list[tuple[Any, str]]] = {}  # kernels and their types, by module


@overload
def compiled(function: F) -> F: ...


@overload
def compiled(function: str) -> Callable[[F], F]: ...


def compiled(function: F | str) -> F | Callable[[F], F]:
    """Compile on first use; cache the code next to the file or in the user's cache folder, if writable.

    If several processes need a function, one compiles it and the others load the result. A debugger sees
    plain Python if ``NUMBA_DISABLE_JIT`` is set.

    With types instead of a function, in numba's notation such as ``"(float64[:,::1], int64)"``, the result
    is a decorator of kernels that :func:`prepare` compiles for arguments of these types.
    """
    if not isinstance(function, str):
        return _compiled(function)
    types = function

    def decorate(function: F) -> F:
        kernel: Any = _compiled(function)
        if isinstance(getattr(kernel, "compile", None), _CompileOnce):
            _with_types.setdefault(function.__module__, []).append((kernel, types))
        return kernel  # type: ignore[no-any-return]

    return decorate


def _compiled(function: F) -> F:
    jit: Any = numba.njit
    try:
        with all_files_watched():
            kernel: Any = jit(cache=True, **_SETTINGS)(function)
    except RuntimeError:  # numba finds no folder for its cache
        return jit(**_SETTINGS)(function)  # type: ignore[no-any-return]
    if kernel is function:  # where NUMBA_DISABLE_JIT is set
        return function
    kernel.compile = _CompileOnce(kernel)
    return kernel  # type: ignore[no-any-return]


def part(function: F) -> F:
    """Compile into the kernels that call it; called from Python, it is plain Python."""
    register: Any = extending.register_jitable
    return register(**_SETTINGS, no_cpython_wrapper=True)(function)  # type: ignore[no-any-return]


@lru_cache
def prepare(*modules: str) -> None:
    """Compile or load the kernels of modules with types that another process is not compiling just now.

    Workers that start together thus divide the kernels among them. Later, each loads those of the others.
    """
    parsed: Any = sigutils.normalize_signature
    for module in modules:
        import_module(module)
        for kernel, types in _with_types.get(module, ()):
            with contextlib.suppress(errors.BusyError):
                # The cache knows a kernel by its types, not by how they are written.
                kernel.compile(tuple(parsed(types)[0]), patience_s=0.0)


class _CompileOnce:
    """Replaces a kernel's own ``compile``: only one process compiles it, and only once."""

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self._compile_or_load = kernel.compile
        self._lock = f"{kernel.__module__}.{kernel.__name__}"

    def __call__(self, types: Any, patience_s: float | None = None) -> Any:
        """Return the compiled function for types; BusyError only after a ``patience_s`` that is given."""
        known = self._kernel.overloads.get(types)
        if known is not None:
            return known.entry_point
        # The collector takes an eighth of the time, and finds nothing.
        with global_compiler_lock, cache.held(self._lock, patience_s) as busy, store.without_collecting():
            if isinstance(busy, errors.BusyError) and patience_s is not None:
                raise busy
            with contextlib.suppress(OSError):  # it is compiled again
                _copy_shared(self._kernel)
            return self._compile_or_load(types)


class _Notice(event.Listener):
    """Says on stderr what takes so long, after a second of compiling; numba reports when it compiles."""

    def __init__(self) -> None:
        self._spent_s = self._begun_s = 0.0
        self._depth = 0  # kernels are compiled while those that call them are
        self._timer: threading.Timer | None = None
        self._lock = contextlib.ExitStack()

    def on_start(self, event: Any) -> None:
        """Wait for the rest of the second."""
        self._depth += 1
        is_ours = isinstance(getattr(event.data["dispatcher"], "compile", None), _CompileOnce)
        if self._depth == 1 and is_ours and not os.environ.get(run.QUIET_VARIABLE):
            self._begun_s = time.monotonic()
            self._timer = threading.Timer(max(_TELL_AFTER_S - self._spent_s, 0.0), self._tell)
            self._timer.daemon = True
            self._timer.start()

    def on_end(self, event: Any) -> None:
        """Stop the clock."""
        self._depth -= 1
        if self._depth == 0 and self._timer is not None:
            self._timer.cancel()
            self._spent_s += time.monotonic() - self._begun_s
            self._timer = None

    def _tell(self) -> None:
        # Held until the process ends: other workers, which compile at the same time, are silent.
        if isinstance(self._lock.enter_context(cache.held("notice", 0.0)), errors.BusyError):
            return
        # Over the line of a progress bar, which is drawn again.
        begin, end = ("\r", "\x1b[K\n") if sys.stderr.isatty() else ("", "\n")
        sys.stderr.write(f"{begin}note: functions are compiled; only the first use takes so long{end}")
        os.environ[run.QUIET_VARIABLE] = "1"


_register: Any = event.register
_register("numba:compile", _Notice())


def _copy_shared(kernel: Any) -> None:
    """Copy the code of a kernel that others have compiled to the user's folder, if that has none.

    It lies in the folder that ``NUMBA_CACHE_DIR`` names, or else beside the source. Names of files hold a
    digest of the source, and numba compares its version and the processor.
    """
    source = kernel.py_func.__code__.co_filename
    folder = Path(source).parent / "__pycache__"
    settings: Any = numba.config
    if settings.CACHE_DIR:
        locator: Any = caching.UserProvidedCacheLocator
        folder = Path(settings.CACHE_DIR) / locator.get_suitable_cache_subpath(source)
    index = Path(kernel._cache._cache_file._index_path)
    if not index.exists() and (folder / index.name).exists():
        for file in sorted(folder.glob(f"{index.stem}.*.nbc")):
            shutil.copyfile(file, index.parent / file.name)
        shutil.copyfile(folder / index.name, index)


class _AllFiles:
    """Adds a digest of all files behind a kernel to the names of its files in the cache.

    Numba reads a whole index before it sees that it is out of date, and fails at classes that are gone.
    """

    files_digest = ""

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> Any:
        """Return a locator, or None if it cannot write."""
        locator: Any = super().from_function(py_func, py_file)  # type: ignore[misc]  # of numba
        if locator is not None:
            locator.files_digest = _files_digest(py_func.__module__)
        return locator

    def get_disambiguator(self) -> str:
        """Return the part of the names that differs if the source does."""
        return f"{super().get_disambiguator()}-{self.files_digest}"  # type: ignore[misc]  # of numba


class ChosenFolder(_AllFiles, caching.UserProvidedCacheLocator):
    """The folder that ``NUMBA_CACHE_DIR`` names."""


class BesideTheCode(_AllFiles, caching.InTreeCacheLocator):
    """``__pycache__`` beside the file, where it can be written."""


class UsersFolder(_AllFiles, caching.UserWideCacheLocator):
    """The user's cache folder."""


_LOCATORS = ",".join(
    f"{__name__}.{locator.__name__}" for locator in (ChosenFolder, BesideTheCode, UsersFolder)
)


@contextlib.contextmanager
def all_files_watched() -> Iterator[None]:
    """Let numba use the locators of this file for functions that are declared meanwhile."""
    settings: Any = numba.config
    before = settings.CACHE_LOCATOR_CLASSES
    settings.CACHE_LOCATOR_CLASSES = before or _LOCATORS
    try:
        yield
    finally:
        settings.CACHE_LOCATOR_CLASSES = before


@lru_cache
def _files_digest(module: str) -> str:
    """Return the digest of the modules whose functions may be compiled into the kernels of a module.

    Called for the first kernel of a module: it has imported by then what its kernels call.
    """
    visited = {_COMPILER}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name in visited:
            continue
        visited.add(name)
        owners = {_owner(value) for value in vars(sys.modules[name]).values()}
        if _COMPILER in owners or any(owner.startswith("numba") for owner in owners):
            packages = (name.partition(".")[0], _COMPILER.partition(".")[0])
            waiting += [owner for owner in owners if owner.partition(".")[0] in packages]
    digest = hashlib.sha256()
    for name in sorted(visited):
        file = getattr(sys.modules.get(name), "__file__", None)
        with contextlib.suppress(OSError):  # a module in an archive
            digest.update(name.encode() + b"\n" + Path(file or "").read_bytes())
    return digest.hexdigest()[:16]


def _owner(value: object) -> str:
    """Return the module that a value is, or that defines it."""
    if isinstance(value, ModuleType):
        return value.__name__
    return str(getattr(value, "__module__", ""))
