"""What the toolkit takes from ``scipy.spatial``."""

from __future__ import annotations

from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation

__all__ = ["ConvexHull", "Rotation", "cKDTree"]
