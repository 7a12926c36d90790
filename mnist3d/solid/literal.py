"""Algorithm 1 as it is printed: the reference for the fast method.

Binary layers at full resolution, marching cubes on the binary stack, smoothing, then decimation to the vertex
budget. Slow and plain on purpose.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from mnist3d.ink import cleaning, refusals
from mnist3d.solid.decimation import decimate
from mnist3d.solid.erosion_and_stacking import stack
from mnist3d.solid.marching_cubes import isosurface
from mnist3d.solid.mirroring_and_scaling import scale
from mnist3d.solid.profile import erosion_radius_px
from mnist3d.solid.smoothing import smooth
from mnist3d.solid.surface import Surface, bodies_and_holes
from mnist3d.solid_spec import SolidSpec
from tactile_toolkit.array_types import Bool, Float64
from tactile_toolkit.mesh import Mesh


def literal_solid(ink: Bool, spec: SolidSpec, *, decimated: bool = True) -> Mesh:
    """Build the solid of clean ink; ``decimated=False`` leaves it as fine as its pixels.

    Raises ItemError ``topology`` if the surface has other numbers of bodies or holes than the ink, and
    ``vertex-budget`` as :func:`mnist3d.solid.decimation.decimate` does.
    """
    upper_half = stack([eroded_by_disc(ink, radius_px) for radius_px in erosion_radii_px(spec)])
    volume = np.concatenate([upper_half[:, :, ::-1], upper_half], axis=2)
    # A margin of empty voxels closes the surface; the corner undoes the shift by one pixel.
    surface = Surface(*isosurface(np.pad(volume, 1), 0.5), corner_px=(-1, -1, -1))
    counts = cleaning.count_bodies_and_holes(ink)
    found = bodies_and_holes(len(surface.vertices_px), surface.faces)
    if found != counts:
        refusals.refuse("topology", *found, *counts, sentence="layers")
    smoothed = smooth(surface, spec.literal_smoothing_iterations, spec.smoothing_factor)
    mesh = scale(smoothed, ink.shape, spec)
    if decimated:
        mesh = decimate(mesh, spec.target_vertices)
    return mesh


def erosion_radii_px(spec: SolidSpec) -> Float64:
    """List the erosion radius of each layer above the mid-plane, in increasing order.

    Layer k is one pixel thick and its middle lies k + 0.5 px up.
    """
    heights = np.arange(round(spec.half_thickness_px)) + 0.5
    return np.asarray(erosion_radius_px(heights, spec), dtype=np.float64)


def eroded_by_disc(ink: Bool, radius_px: float) -> Bool:
    """Erode ink by a radius, measured from its outline; outside the image is paper.

    The outline lies half a pixel outside the outermost centres, so this is binary erosion with a disc of all
    offsets shorter than ``radius_px + 0.5``. The usual disc, of offsets up to the radius, leaves half a pixel
    more. ``SolidSpec.erosion`` chooses between them through the radii of :func:`erosion_radii_px`.
    """
    # One transform serves any radius; repeated small erosions would draw polygons.
    distance = np.asarray(ndimage.distance_transform_edt(np.pad(ink, 1)))
    return np.asarray(ink & (distance[1:-1, 1:-1] >= radius_px + 0.5))
