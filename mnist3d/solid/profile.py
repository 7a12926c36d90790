"""The profile of a solid: how far its outline moves inwards with height, and how deep points lie in it."""

from __future__ import annotations

import numpy as np

from mnist3d.solid_spec import SolidSpec
from tactile_toolkit.array_types import Floating

_DISC_OFFSETS_PX = {"outline": 0.0, "disc": 0.5}


def erosion_radius_px(z_px: Floating, spec: SolidSpec) -> Floating:
    """Return how far the outline moves inwards at heights from 0 to the half thickness, pixels."""
    half_px = spec.half_thickness_px
    if spec.profile == "flat":
        return np.zeros_like(z_px)
    radius = z_px
    if spec.profile == "round":
        radius = np.asarray(half_px - np.sqrt(np.maximum(half_px**2 - z_px**2, 0)))
    return np.asarray(np.maximum(radius - disc_offset_px(spec), 0))


def disc_offset_px(spec: SolidSpec) -> np.float32:
    """Return by how much an erosion is less than its radius: a disc keeps the pixels that it touches."""
    return np.float32(_DISC_OFFSETS_PX[spec.erosion])


def half_height_px(s_px: Floating, spec: SolidSpec) -> Floating:
    """Return the height of the solid above the mid-plane, pixels; 0 outside the ink."""
    half_px = spec.half_thickness_px
    depth = np.where(s_px > 0, np.clip(s_px + disc_offset_px(spec), 0, half_px), 0)
    if spec.profile == "round":
        # The same quarter circle as in `erosion_radius_px`, solved for the height.
        return np.asarray(np.sqrt(depth * (2 * half_px - depth)))
    if spec.profile == "linear":
        return depth
    return np.where(s_px > 0, np.float32(half_px), np.float32(0))


def depth_px(s_px: Floating, z_px: Floating, spec: SolidSpec) -> Floating:
    """Return the depth of points in the solid, pixels, positive inside; the two shapes broadcast.

    Values are true distances wherever one side of the solid is nearest, so their zero between two nodes is
    exact. A stack of binary layers would place it half-way.
    """
    half_px = spec.half_thickness_px
    if spec.profile == "flat":
        return np.asarray(np.minimum(s_px, half_px - z_px))
    kept_px = s_px + disc_offset_px(spec)
    if spec.profile == "round":
        depth = np.asarray(half_px - np.sqrt(np.maximum(half_px - kept_px, 0) ** 2 + z_px**2))
    else:
        # The side of a linear profile is a plane at 45 degrees.
        depth = np.asarray(np.minimum((kept_px - z_px) * np.float32(0.5**0.5), half_px - z_px))
    if spec.erosion == "disc":
        depth = np.minimum(depth, s_px)
    return depth
