"""The side view of the solid: how far the outline has drawn in at each height.

All lengths are in pixels. ``s`` is the distance of a point from the outline of the ink, positive inside;
``z`` is its height above the mid-plane. In the round profile the outline draws in along a quarter circle
whose radius is the half thickness, which gives the round shoulders of the published meshes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["erosion_radius", "half_height", "occupancy"]


def erosion_radius(
    z: NDArray[np.floating[Any]], half_thickness: float, profile: str
) -> NDArray[np.floating[Any]]:
    """Say how far the ink is eroded at a height.

    Parameters
    ----------
    z : ndarray
        Heights from 0 to ``half_thickness`` in pixels.
    half_thickness : float
        Greatest height in pixels.
    profile : {"round", "linear", "flat"}
        Shape of the side.

    Returns
    -------
    ndarray
        Radii in pixels, growing with the height.
    """
    if profile == "round":
        return np.asarray(half_thickness - np.sqrt(np.maximum(half_thickness**2 - z**2, 0)))
    return z if profile == "linear" else np.zeros_like(z)


def half_height(
    s: NDArray[np.floating[Any]], half_thickness: float, profile: str
) -> NDArray[np.floating[Any]]:
    """Say how high the solid stands above the mid-plane.

    Parameters
    ----------
    s : ndarray
        Distances from the outline in pixels, positive inside the ink.
    half_thickness, profile
        As in :func:`erosion_radius`.

    Returns
    -------
    ndarray
        Heights in pixels, 0 outside the ink.
    """
    depth = np.clip(s, 0, half_thickness)
    if profile == "round":
        return np.asarray(np.sqrt(depth * (2 * half_thickness - depth)))
    return depth if profile == "linear" else np.where(s > 0, np.float32(half_thickness), np.float32(0))


def occupancy(
    s: NDArray[np.floating[Any]], z: NDArray[np.floating[Any]], half_thickness: float, profile: str
) -> NDArray[np.floating[Any]]:
    """Say how deep points lie in the solid.

    The values are true distances wherever one side of the solid is nearest, so that their zero is found
    exactly between two nodes of a lattice; a stack of binary layers would place it half way instead.

    Parameters
    ----------
    s, z : ndarray
        Distance from the outline and height above the mid-plane in pixels, of shapes that broadcast.
    half_thickness, profile
        As in :func:`erosion_radius`.

    Returns
    -------
    ndarray
        Depth under the surface in pixels, positive inside the solid.
    """
    if profile == "round":
        return np.asarray(half_thickness - np.sqrt(np.maximum(half_thickness - s, 0) ** 2 + z**2))
    side = (s - z) * np.float32(0.5**0.5) if profile == "linear" else s
    return np.asarray(np.minimum(side, half_thickness - z))
