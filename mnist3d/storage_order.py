"""The order of faces in which a mesh packs best."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["in_storage_order"]


def in_storage_order(faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """Begin each triangle at its lowest vertex and sort the triangles.

    Neighbouring rows then hold nearly equal numbers, which halves what zstd makes of them.

    Parameters
    ----------
    faces : ndarray of int32, shape (F, 3)
        Triangles of a closed or open surface.

    Returns
    -------
    ndarray of int32, shape (F, 3)
        The same triangles with the same winding.
    """
    if not len(faces):
        return faces
    turns = (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3
    begun = np.take_along_axis(faces, turns, axis=1)
    # On a surface no two triangles leave the same vertex by the same edge, so two numbers settle the order.
    edge = begun[:, 0].astype(np.int64) * (int(faces.max()) + 1) + begun[:, 1]
    return np.asarray(begun[np.argsort(edge, kind="stable")])
