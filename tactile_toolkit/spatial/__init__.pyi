"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .of_scipy import (
    ConvexHull as ConvexHull,
    Rotation as Rotation,
    cKDTree as cKDTree,
)
