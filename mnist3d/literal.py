"""Algorithm 1 as it is printed: the oracle that the fast way of :mod:`mnist3d.solid` is held to.

Binary layers at full resolution, marching cubes on the binary stack, smoothing, and only then a decimation to
the vertex budget. Slow and plain on purpose.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mnist3d.ink import count_bodies_and_holes, refuse
from mnist3d.lattice import erosion_radius_px, stack
from mnist3d.spec import SolidSpec
from mnist3d.surface import Surface, bodies_and_holes, decimate, isosurface, scale, smooth
from tactile_toolkit.array_types import AnyArray, Bool, Float64
from tactile_toolkit.mesh import Mesh


def literal_solid(ink: Bool, spec: SolidSpec, *, decimated: bool = True) -> Mesh:
    """Build the solid of clean ink; left as fine as its pixels with ``decimated=False``.

    Raises ItemError ``topology`` where the surface has not the bodies and holes of the ink,
    ``vertex-budget`` as :func:`mnist3d.surface.decimate`.
    """
    layers = [erode(ink, radius_px) for radius_px in erosion_radii_px(spec)]
    # A margin of empty voxels closes the surface; the corner undoes the shift by one pixel.
    surface = Surface(*isosurface(np.pad(mirror(stack(layers)), 1), 0.5), corner_px=(-1, -1, -1))
    counts = count_bodies_and_holes(ink)
    found = bodies_and_holes(len(surface.vertices_px), surface.faces)
    if found != counts:
        refuse("topology", *found, *counts, sentence="layers")
    smoothed = smooth(surface, spec.literal_smoothing_iterations, spec.smoothing_factor)
    mesh = scale(smoothed, (ink.shape[0], ink.shape[1]), spec)
    return decimate(mesh, spec.target_vertices) if decimated else mesh


def erosion_radii_px(spec: SolidSpec) -> Float64:
    """List the erosion radius of each layer above the mid-plane, in increasing order.

    Layer k is one pixel thick and its middle lies k + 0.5 px up.
    """
    heights = np.arange(round(spec.half_thickness_px)) + 0.5
    return np.asarray(erosion_radius_px(heights, spec), dtype=np.float64)


def erode(ink: Bool, radius_px: float) -> Bool:
    """Let the ink draw in from its outline by a radius; beyond the image is paper.

    The outline lies half a pixel outside the outermost centres, so this is binary erosion with a disc of the
    offsets shorter than ``radius_px + 0.5``. The usual disc, of offsets up to the radius, leaves half a pixel
    more: ``SolidSpec.erosion`` chooses between them by the radii of :func:`erosion_radii_px`.
    """
    from scipy import ndimage

    # One transform serves any radius; repeated small erosions would draw polygons.
    distance: Any = ndimage.distance_transform_edt(np.pad(ink, 1))
    return np.asarray(ink & (distance[1:-1, 1:-1] >= radius_px + 0.5))


def mirror(volume: AnyArray) -> AnyArray:
    """Add the lower half to the layers above the mid-plane."""
    return np.concatenate([volume[:, :, ::-1], volume], axis=2)
