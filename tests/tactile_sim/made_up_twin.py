"""A twin with random colours and an untrained reader, for tests of everything around it."""

from __future__ import annotations

import numpy as np

from tactile_sim.sensor_models import SensorModel
from tactile_sim.twin import gel_kernels, reader
from tactile_sim.twin.calibration import model_of
from tactile_sim.twin.twin import Twin

HALF_M = np.array([0.00944, 0.00708])
SHAPE = np.array([0.0, 0.0, 0.02, 0.00425, 9e-4, 6e-5, 0.6, 1e-4])


def made_up_twin(seed: int = 0) -> Twin:
    """Return a twin of images of 64 x 48 pixels."""
    rng = np.random.default_rng(seed)
    coefficients = rng.normal(0, 30, (gel_kernels.ENTRIES, gel_kernels.PLACES, 3)).astype(np.float32)
    background = rng.uniform(90, 130, (48, 64, 3)).astype(np.float32)
    weights = {name: np.zeros(shape, np.float32) for name, shape in reader.reader_shapes().items()}
    report = {"mm_per_px": 0.295, "noise_levels": 1.0, "image_error_levels": 1.0, "residual_levels": 1.0}
    return Twin(SHAPE, HALF_M, coefficients, background, weights, {**report, "touches": []})


def made_up_sensor(seed: int = 0) -> SensorModel:
    """Return a sensor with this twin."""
    return model_of(made_up_twin(seed), "mine")
