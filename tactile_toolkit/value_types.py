"""Types of arrays by element, and of JSON values, for annotations; docstrings state shape, unit and frame.

NumPy is imported for type checkers only: command lines need these names, and no array, to print their help.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Bool: TypeAlias = "NDArray[np.bool_]"
UInt8: TypeAlias = "NDArray[np.uint8]"
Int32: TypeAlias = "NDArray[np.int32]"
Int64: TypeAlias = "NDArray[np.int64]"
Integers: TypeAlias = "NDArray[np.integer[Any]]"
"""Integers of any width."""

Float32: TypeAlias = "NDArray[np.float32]"
Float64: TypeAlias = "NDArray[np.float64]"
Floating: TypeAlias = "NDArray[np.floating[Any]]"
"""Floating-point numbers of single or double precision."""

AnyDtype: TypeAlias = "np.dtype[Any]"
AnyArray: TypeAlias = "NDArray[Any]"
"""Elements of any type."""

JsonObject: TypeAlias = Mapping[str, Any]
"""A JSON object that nothing changes."""

JsonValue: TypeAlias = Any
"""A JSON value of a file, which may have any type."""

JsonDict: TypeAlias = dict[str, Any]
"""A JSON object that is being made, or changed."""
