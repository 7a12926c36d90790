"""The side view of the solid: how far the outline has drawn in at each height.

All lengths are in pixels. ``s`` is the distance of a point from the outline of the ink, positive inside; ``z`` is
its height above the mid-plane; ``R`` is the half thickness. "round" lets the outline draw in along a quarter circle
of radius R, which gives the round shoulders of the published meshes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["erosion_radius", "half_height", "occupancy"]

Floats = "NDArray[np.floating[Any]]"


def erosion_radius(z: NDArray[np.floating[Any]], R: float, profile: str) -> NDArray[np.floating[Any]]:  # noqa: N803
    """Say how far the ink is eroded at a height.

    Parameters
    ----------
    z : ndarray
        Heights from 0 to ``R`` in pixels.
    R : float
        Half thickness in pixels.
    profile : {"round", "linear", "flat"}
        Shape of the side.

    Returns
    -------
    ndarray
        Radii in pixels, growing with the height.
    """
    if profile == "round":
        return np.asarray(R - np.sqrt(np.maximum(R**2 - z**2, 0)))
    return z if profile == "linear" else np.zeros_like(z)


def half_height(s: NDArray[np.floating[Any]], R: float, profile: str) -> NDArray[np.floating[Any]]:  # noqa: N803
    """Say how high the solid stands above the mid-plane.

    Parameters
    ----------
    s : ndarray
        Distances from the outline in pixels, positive inside the ink.
    R, profile
        As in :func:`erosion_radius`.

    Returns
    -------
    ndarray
        Heights in pixels, 0 outside the ink.
    """
    depth = np.clip(s, 0, R)
    if profile == "round":
        return np.asarray(np.sqrt(depth * (2 * R - depth)))
    return depth if profile == "linear" else np.where(s > 0, np.float32(R), np.float32(0))


def occupancy(
    s: NDArray[np.floating[Any]],
    z: NDArray[np.floating[Any]],
    R: float,  # noqa: N803
    profile: str,
) -> NDArray[np.floating[Any]]:
    """Say how deep points lie in the solid.

    The values are true distances wherever one side of the solid is nearest, so that their zero is found exactly
    between two nodes of a lattice; a row of binary layers would place it half way instead.

    Parameters
    ----------
    s, z : ndarray
        Distance from the outline and height above the mid-plane in pixels, of shapes that broadcast.
    R, profile
        As in :func:`erosion_radius`.

    Returns
    -------
    ndarray
        Depth under the surface in pixels, positive inside the solid.
    """
    if profile == "round":
        return R - np.sqrt(np.maximum(R - s, 0) ** 2 + z**2)
    side = (s - z) * np.float32(0.5**0.5) if profile == "linear" else s
    return np.minimum(side, R - z)
