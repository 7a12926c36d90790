"""Functions compiled by numba, which takes half a second to import: import kernels where they are called.

Without fastmath each operation is an IEEE one, in the order in which it is written: values do not depend on
the processor.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any, TypeVar

import numba
import numba.extending
from numba.core import sigutils
from numba.core.compiler_lock import global_compiler_lock

from tactile_toolkit import kernel_cache, store
from tactile_toolkit.cache import LOCKS, cache_folder
from tactile_toolkit.errors import BusyError, ToolkitError

F = TypeVar("F", bound=Callable[..., Any])

# nogil: threads may work side by side. numpy's error model: a division by 0 is an infinity, not an exception
# that every loop has to check. No wrapper for C, which would be unused: it takes a tenth of the time.
_SETTINGS = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}

_planned: dict[str, list[tuple[Any, str]]] = {}  # kernels and their types, by module


def compiled(function: F) -> F:
    """Compile on first use; cache the code next to the file or in the user's cache folder, if writable.

    If several processes need a function, one compiles it and the others load the result. A debugger sees
    plain Python if ``NUMBA_DISABLE_JIT`` is set.
    """
    jit: Any = numba.njit
    try:
        with kernel_cache.all_files_watched():
            kernel: Any = jit(cache=True, **_SETTINGS)(function)
    except RuntimeError:  # numba finds no folder for its cache
        return jit(**_SETTINGS)(function)  # type: ignore[no-any-return]
    if kernel is function:  # where NUMBA_DISABLE_JIT is set
        return function
    kernel.compile = _CompileOnce(kernel)
    return kernel  # type: ignore[no-any-return]


def part(function: F) -> F:
    """Compile into the kernels that call it; called from Python, it is plain Python."""
    register: Any = numba.extending.register_jitable
    return register(**_SETTINGS, no_cpython_wrapper=True)(function)  # type: ignore[no-any-return]


def planned(types: str) -> Callable[[F], F]:
    """Return :func:`compiled` for a kernel that :func:`prepare` compiles, for arguments of these types.

    ``types`` is a tuple in numba's notation, such as ``"(float64[:,::1], int64)"``.
    """

    def decorate(function: F) -> F:
        kernel: Any = compiled(function)
        if isinstance(getattr(kernel, "compile", None), _CompileOnce):
            _planned.setdefault(function.__module__, []).append((kernel, types))
        return kernel  # type: ignore[no-any-return]

    return decorate


@cache
def prepare(*modules: str) -> None:
    """Compile or load the planned kernels of modules that another process is not compiling just now.

    Workers that start together thus divide the kernels among them. Later, each loads those of the others.
    """
    parsed: Any = sigutils.normalize_signature
    for module in modules:
        import_module(module)
        for kernel, types in _planned.get(module, ()):
            with contextlib.suppress(BusyError):
                # The cache knows a kernel by its types, not by how they are written.
                kernel.compile(tuple(parsed(types)[0]), patience_s=0.0)


class _CompileOnce:
    """Replaces a kernel's own ``compile``: only one process compiles it, and only once."""

    def __init__(self, kernel: Any) -> None:
        self._kernel, self._compile_or_load = kernel, kernel.compile
        self._lock = f"{kernel.__module__}.{kernel.__name__}"

    def __call__(self, types: Any, patience_s: float | None = None) -> Any:
        """Return the compiled function for types; BusyError only after a ``patience_s`` that is given."""
        known = self._kernel.overloads.get(types)
        if known is not None:
            return known.entry_point
        with global_compiler_lock, contextlib.ExitStack() as stack:
            try:
                folder = cache_folder() / LOCKS
                folder.mkdir(parents=True, exist_ok=True)
                stack.enter_context(store.locked(folder / self._lock, patience_s=patience_s))
            except BusyError:
                if patience_s is not None:
                    raise
            except (OSError, ToolkitError):  # no lock: two processes may do the same work
                pass
            # The collector takes an eighth of the time, and finds nothing.
            stack.enter_context(store.without_collecting())
            return self._compile_or_load(types)
