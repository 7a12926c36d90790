"""A twin with random colours and an untrained reader, for tests of everything around it."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from tactile_sim.press.sensors import SensorModel
from tactile_sim.twin import gel, gel_kernels, reader
from tactile_sim.twin.calibration import model_of
from tactile_sim.twin.gel import Fitted
from tactile_sim.twin.twin import Twin

HALF_M = np.array([0.00944, 0.00708])
SHAPE = np.array([0.0, 0.02, 0.00425, 9e-4, 6e-5, 0.6, 1e-4, 0.0, 0.2, 0.0, 1.28, 0.4, 0.3, 0.1])


def made_up_twin(seed: int = 0) -> Twin:
    """Return a twin of images of 64 x 48 pixels."""
    rng = np.random.default_rng(seed)
    coefficients = rng.normal(0, 30, (gel_kernels.COEFFICIENTS, 3)).astype(np.float32)
    background = rng.uniform(90, 130, (48, 64, 3)).astype(np.float32)
    weights = {name: np.zeros(shape, np.float32) for name, shape in reader.reader_shapes().items()}
    report = {"mm_per_px": 0.295, "noise_levels": 1.0, "image_error_levels": 1.0, "residual_levels": 1.0}
    return Twin(SHAPE, HALF_M, coefficients, background, weights, {**report, "touches": []})


def made_up_sensor(seed: int = 0) -> SensorModel:
    """Return a sensor with this twin."""
    return model_of(made_up_twin(seed), "mine")


def hills() -> np.ndarray:
    """How far two balls reach into the gel, metres, (48, 64)."""
    y, x = np.mgrid[-1:1:48j, -1:1:64j] * HALF_M[::-1, None, None]
    first = 0.0015 - ((x + 0.004) ** 2 + y**2) / 0.012
    second = 0.001 - ((x - 0.004) ** 2 + (y - 0.002) ** 2) / 0.006
    return np.maximum(np.maximum(first, second), 0)


def terms_of(at_rest: np.ndarray, width: int) -> np.ndarray:
    """The terms of pixels, (H W, TERMS), by numpy and scipy; ``width`` is that of the whole image."""
    y, x = ((np.arange(side) + 0.5) / side * 2 - 1 for side in at_rest.shape[:2])
    x, y = np.meshgrid(x, -y)
    sigmas = (0.02 * width, 0.02 * width, 0)
    smooth = ndimage.gaussian_filter(at_rest.astype(float), sigmas, mode="mirror", truncate=3)
    colours = smooth / at_rest.mean(axis=(0, 1))
    return np.dstack([np.ones_like(x), x, y, x * x, x * y, y * y, colours]).reshape(-1, 9)


def response_of(seen: gel.Features, coefficients: np.ndarray, terms: np.ndarray) -> np.ndarray:
    """The response (H W, 3) as the sum over the entries of each pixel, without blur, in plain numpy."""
    entries, shares = seen
    at = np.minimum(entries[..., None] + np.arange(gel_kernels.TERMS), gel_kernels.COEFFICIENTS - 1)
    known = coefficients[at].astype(float)
    known[entries >= gel_kernels.SLOPES * gel_kernels.TERMS, 1:] = 0.0  # the light of a lamp has one term
    return np.einsum("pk,pkts,pt->ps", shares, known, terms)


def without(shape: np.ndarray, *fitted: Fitted) -> np.ndarray:
    """A geometry without a lens, or without blur."""
    return np.where(np.isin(np.arange(len(shape)), fitted), 0.0, shape)
