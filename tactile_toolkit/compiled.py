"""Functions compiled by numba, which takes half a second to import: import kernels where they are called.

Without fastmath each operation is an IEEE one, in the order in which it is written: values do not depend on
the processor.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.core.compiler_lock import global_compiler_lock

from tactile_toolkit import cache, store
from tactile_toolkit.errors import ToolkitError

F = TypeVar("F", bound=Callable[..., Any])

# nogil: threads may work side by side. numpy's error model: a division by 0 is an infinity, not an exception
# that every loop has to look for. No wrapper for C, which nothing calls: it takes a tenth of the time.
_SETTINGS = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


def compiled(function: F) -> F:
    """Compile on first use; kept next to the file or in the user's cache folder, where one can be written.

    Of several processes, one compiles a function, and the others take what it has kept. A debugger sees plain
    Python where ``NUMBA_DISABLE_JIT`` is set.
    """
    jit: Any = numba.njit
    try:
        kernel: Any = jit(cache=True, **_SETTINGS)(function)
    except RuntimeError:  # numba finds no folder for its cache
        return jit(**_SETTINGS)(function)  # type: ignore[no-any-return]
    if kernel is function:  # where NUMBA_DISABLE_JIT is set
        return function
    compile_or_load = kernel.compile

    def compile_once(signature: Any) -> Any:
        with global_compiler_lock, contextlib.ExitStack() as stack:
            # Without a lock, two processes may do the same work.
            with contextlib.suppress(OSError, ToolkitError):
                folder = cache.cache_folder() / cache.LOCKS
                folder.mkdir(parents=True, exist_ok=True)
                stack.enter_context(store.locked(folder / f"{function.__module__}.{function.__name__}"))
            return compile_or_load(signature)

    kernel.compile = compile_once
    return kernel  # type: ignore[no-any-return]
