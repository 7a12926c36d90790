"""Normals of triangles for shading."""

from __future__ import annotations

import numpy as np

from tactile_toolkit.array_types import Float64, Integers


def face_normals(points: Float64, faces: Integers) -> Float64:
    """Return normals of triangles, (F, 3), with twice their areas as lengths."""
    corners = points[faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def unit_vectors(vectors: Float64) -> Float64:
    """Scale vectors, shape (..., 3), to length 1; vectors of length 0 stay."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(lengths > 0, lengths, 1.0))
