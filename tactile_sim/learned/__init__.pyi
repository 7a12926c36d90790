"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .generators import DepthEstimator as DepthEstimator
