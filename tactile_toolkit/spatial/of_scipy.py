"""Names of ``scipy.spatial`` that the toolkit uses."""

from __future__ import annotations

from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation

__all__ = ["ConvexHull", "Rotation", "cKDTree"]
