"""Functions compiled by numba, which takes half a second to import: import kernels where they are called.

Without fastmath each operation is an IEEE one, in the order in which it is written: values do not depend on
the processor.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile on first use; kept next to the file or in the user's cache folder, where one can be written."""
    jit: Any = numba.njit
    result: F
    try:
        # nogil: threads may work side by side. numpy's error model: a division by 0 is an infinity, not an
        # exception that every loop has to look for.
        result = jit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # numba finds no folder for its cache
        result = jit(nogil=True, error_model="numpy")(function)
    return result
