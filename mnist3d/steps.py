"""The published steps from ink to mesh, one function each (Tactile MNIST paper, algorithm on MNIST 3D).

Arrays of pixels are (rows, columns), stacks of layers (rows, columns, height). Surfaces are pairs of
vertices and faces; their coordinates are (row, column, height above the mid-plane) in pixels until
:func:`scale`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mnist3d.profile import erosion_radius
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mnist3d.spec import SolidSpec

__all__ = ["erode", "erosion_radii_px", "marching_cubes", "mirror", "scale", "smooth", "stack"]

TAUBIN_RATIO = -1.06
"""Step outward over step inward that lets smoothing keep the volume (Taubin 1995: slightly above one)."""


def erosion_radii_px(spec: SolidSpec) -> NDArray[np.float64]:
    """List the erosion radius of each layer above the mid-plane.

    Parameters
    ----------
    spec : SolidSpec
        Half thickness, pixel pitch and profile.

    Returns
    -------
    ndarray of float64, shape (L,)
        Pixels, in increasing order: layer k is one pixel thick and its middle lies k + 0.5 px up.
    """
    layers = round(spec.half_thickness_px)
    heights = np.arange(layers) + 0.5
    return np.asarray(erosion_radius(heights, spec.half_thickness_px, spec.profile), dtype=np.float64)


def erode(mask: NDArray[np.bool_], radius_px: float) -> NDArray[np.bool_]:
    """Let the ink draw in from its outline, as binary erosion with a disc does.

    The outline lies half a pixel outside the outermost centres, so the disc holds the offsets shorter than
    ``radius_px + 0.5``.

    Parameters
    ----------
    mask : ndarray of bool, shape (H, W)
        True where there is ink; beyond the image there is paper.
    radius_px : float
        How far the outline draws in, in pixels.

    Returns
    -------
    ndarray of bool, shape (H, W)
    """
    from scipy import ndimage

    distance: Any = ndimage.distance_transform_edt(np.pad(mask, 1))
    return np.asarray(mask & (distance[1:-1, 1:-1] >= radius_px + 0.5))


def stack(layers: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Put layers on top of one another.

    Parameters
    ----------
    layers : sequence of ndarray, shape (H, W)
        From the mid-plane up.

    Returns
    -------
    ndarray, shape (H, W, L)
    """
    return np.stack(layers, axis=2)


def mirror(volume: NDArray[Any]) -> NDArray[Any]:
    """Add the lower half of the solid.

    Parameters
    ----------
    volume : ndarray, shape (H, W, L)
        The layers above the mid-plane.

    Returns
    -------
    ndarray, shape (H, W, 2 L)
        The layers from the lowest to the highest.
    """
    return np.concatenate([volume[:, :, ::-1], volume], axis=2)


def marching_cubes(
    volume: NDArray[Any], level: float, spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Extract the surface at which a volume passes a level.

    Parameters
    ----------
    volume : ndarray, shape (A, B, C)
        Larger values inside the solid.
    level : float
        Value on the surface.
    spacing : tuple of float
        Distance of the nodes along each axis.

    Returns
    -------
    vertices : ndarray of float32, shape (V, 3)
        In the order of the axes, 0 at the first node.
    faces : ndarray of int32, shape (F, 3)
        Counter-clockwise seen from outside.
    """
    from skimage import measure

    extract: Any = measure.marching_cubes
    vertices, faces, _, _ = extract(
        np.ascontiguousarray(volume, dtype=np.float32), level, spacing=spacing, gradient_direction="ascent"
    )
    return vertices.astype(np.float32, copy=False), faces.astype(np.int32, copy=False)


def smooth(
    vertices: NDArray[np.floating[Any]],
    faces: NDArray[np.int32],
    iterations: int,
    factor: float,
    held: NDArray[np.bool_] | None = None,
) -> NDArray[np.floating[Any]]:
    """Even out a surface without shrinking it (Taubin 1995).

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
        Positions.
    faces : ndarray of int32, shape (F, 3)
        Triangles.
    iterations : int
        Rounds, each of one step inward and a slightly longer one outward.
    factor : float
        Share of the way to the middle of the neighbours that the step inward goes.
    held : ndarray of bool, shape (V,), optional
        Vertices that keep their last coordinate. With the rim of the upper half of a mirrored surface held,
        the half moves exactly as it would within the whole.

    Returns
    -------
    ndarray, shape (V, 3)
    """
    average = _neighbour_average(faces, len(vertices))
    for _ in range(iterations):
        for share in (factor, factor * TAUBIN_RATIO):
            moved = vertices + np.float32(share) * (average @ vertices - vertices)
            if held is not None:
                moved[held, 2] = vertices[held, 2]
            vertices = moved
    return vertices


def scale(
    vertices: NDArray[np.floating[Any]],
    faces: NDArray[np.int32],
    shape: tuple[int, int],
    spec: SolidSpec,
) -> Mesh:
    """Turn pixels into metres and set the solid on the plate.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
        (row, column, height) in pixels of the whole image.
    faces : ndarray of int32, shape (F, 3)
        Triangles.
    shape : tuple of int
        Rows and columns of the image; its middle becomes the origin.
    spec : SolidSpec
        Pixel pitch and storage grid.

    Returns
    -------
    Mesh
        Lowest point at z = 0, vertices in float32 on the storage grid.
    """
    row, column, height = vertices.astype(np.float64).T
    centred = np.stack([column - (shape[1] - 1) / 2, (shape[0] - 1) / 2 - row, height], axis=1)
    vertices_mm = centred * spec.pixel_pitch_mm
    if spec.vertex_quantum_mm > 0:
        # Rounded about the mid-plane, where up and down round alike, and only then set on the plate.
        vertices_mm = np.round(vertices_mm / spec.vertex_quantum_mm) * spec.vertex_quantum_mm
    vertices_mm[:, 2] -= vertices_mm[:, 2].min()
    return Mesh((vertices_mm / MM_PER_M).astype(np.float32), faces)


def _neighbour_average(faces: NDArray[np.int32], count: int) -> Any:
    from scipy import sparse

    ends = faces[:, [0, 1, 2, 1, 2, 0]].T.reshape(-1)
    others = faces[:, [1, 2, 0, 0, 1, 2]].T.reshape(-1)
    weights = np.ones(len(ends), dtype=np.float32)
    sums = sparse.csr_matrix((weights, (ends, others)), shape=(count, count))
    shares = np.float32(1) / np.maximum(np.asarray(sums.sum(axis=1)).ravel(), 1)
    return sparse.diags(shares.astype(np.float32)) @ sums
