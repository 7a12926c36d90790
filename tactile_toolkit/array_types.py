"""Array types by element, for annotations; docstrings state shape, unit and frame."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Bool: TypeAlias = NDArray[np.bool_]
UInt8: TypeAlias = NDArray[np.uint8]
Int32: TypeAlias = NDArray[np.int32]
Int64: TypeAlias = NDArray[np.int64]
Integers: TypeAlias = NDArray[np.integer[Any]]
"""Integers of any width."""

Float32: TypeAlias = NDArray[np.float32]
Float64: TypeAlias = NDArray[np.float64]
Floating: TypeAlias = NDArray[np.floating[Any]]
"""Floating-point numbers of single or double precision."""

AnyDtype: TypeAlias = np.dtype[Any]
AnyArray: TypeAlias = NDArray[Any]
"""Elements of any type."""
