"""The last steps of Algorithm 1: a half surface is mirrored, pixels become metres, and the size is exact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mnist3d.solid.solid_size import SolidSize
from mnist3d.solid.surface import Surface
from mnist3d.solid_spec import SolidSpec
from tactile_toolkit.mesh import MM_PER_M, Mesh


def mirror(upper: Surface) -> Surface:
    """Add the mirror image of the upper half of a surface, and join both at the rim.

    The paper mirrors the stack of layers. Marching cubes and smoothing treat both halves alike, so mirroring
    after them gives the same surface in half the time, and its halves agree to the last bit.

    The mirrored vertices follow those of the upper half, in the same order; those of the rim are not doubled.
    """
    count = len(upper.vertices_px)
    off_plane = np.delete(np.arange(count), upper.rim)
    image = np.arange(count, dtype=np.int32)
    image[off_plane] = count + np.arange(len(off_plane), dtype=np.int32)
    below = upper.vertices_px.take(off_plane, 0) * np.array([1, 1, -1], np.float32)
    faces = np.concatenate([upper.faces, image.take(upper.faces[:, [0, 2, 1]])])
    return replace(upper, vertices_px=np.concatenate([upper.vertices_px, below]), faces=faces)


def scale(surface: Surface, shape: tuple[int, ...], spec: SolidSpec) -> Mesh:
    """Convert a surface from pixels of an image of the given shape to metres, and set it on the plate.

    The centre of the image becomes the origin, the lowest point lies at z = 0. Vertices end on the grid on
    which they are stored.
    """
    corner_px = np.array(surface.corner_px, dtype=np.float32)
    row, column, height = (surface.vertices_px + corner_px).astype(np.float64).T
    centred = np.stack([column - (shape[1] - 1) / 2, (shape[0] - 1) / 2 - row, height], axis=1)
    vertices_mm = centred * spec.pixel_pitch_mm
    if spec.vertex_quantum_mm > 0:
        # Rounded about the mid-plane, where up and down round alike, and only then set on the plate.
        vertices_mm = np.round(vertices_mm / spec.vertex_quantum_mm) * spec.vertex_quantum_mm
    vertices_mm[:, 2] -= vertices_mm[:, 2].min()
    return Mesh((vertices_mm / MM_PER_M).astype(np.float32), surface.faces)


def fit_to_size(solid: Mesh, size: SolidSize) -> Mesh:
    """Scale a solid along x and y to a given height or width; the thickness stays.

    The size of the pixels does not determine it: the outline lies between pixels, cleaning moves it, and the
    lattice cuts off tips, which adds up to more than half a millimetre. The middle of the solid becomes the
    origin of x and y.
    """
    asked = next(((axis, mm) for axis, mm in enumerate((size.width_mm, size.height_mm)) if mm), None)
    if asked is None:
        return solid
    axis, asked_mm = asked
    vertices_m = solid.vertices_m.astype(np.float64)
    low, high = vertices_m[:, :2].min(axis=0), vertices_m[:, :2].max(axis=0)
    vertices_m[:, :2] -= (low + high) / 2
    vertices_m[:, :2] *= asked_mm / MM_PER_M / float(high[axis] - low[axis])
    return Mesh(vertices_m.astype(np.float32), solid.faces)
