"""The order of vertices and faces in which a mesh packs best."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["storage_order"]


def storage_order(
    vertices: NDArray[np.floating[Any]], faces: NDArray[np.int32]
) -> tuple[NDArray[np.floating[Any]], NDArray[np.int32]]:
    return vertices, faces
