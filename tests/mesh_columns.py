"""Columns of meshes, packed for tests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.read import RaggedColumn
from tactile_toolkit.read.record import ragged_array


def list_array(rows: Sequence[NDArray[Any]], value_type: Any) -> Any:
    """Pack arrays of shape (n_i, 3) into an Arrow ``list<value_type[3]>``."""
    offsets = np.cumsum([0, *map(len, rows)])
    return ragged_array(RaggedColumn(np.concatenate([np.zeros((0, 3), np.int8), *rows]), offsets), value_type)
