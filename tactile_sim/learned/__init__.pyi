"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .inference import DepthEstimator as DepthEstimator
